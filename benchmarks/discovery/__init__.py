"""Blind benchmark of discovery: a generator of cases, entrants and scores."""
