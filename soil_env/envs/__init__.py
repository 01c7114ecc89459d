"""Environments of Gymnasium, and what joins world and identifier in them."""
