"""Driving: the world and, where something asks for its estimate, the identifier on board, stepped together."""
