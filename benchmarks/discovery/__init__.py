"""A benchmark of discrepancy discovery: cases, scorer and entrants; `easy` is the set without law errors."""
