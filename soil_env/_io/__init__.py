"""Strict loading of parameters, atomic file writes, signals."""
