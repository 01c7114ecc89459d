"""Rovers: controllers of all their wheels, drives over held-out courses, and their comparison with trained agents."""
