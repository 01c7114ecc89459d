"""Blind benchmark of discrepancy discovery: a generator of cases, entrants and scores."""
