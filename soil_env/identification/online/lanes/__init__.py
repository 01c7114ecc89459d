"""Compiled code of the online identifier alone: eight numbers as one value, and the base model of
the contact in them.

All that depends on numba's internals is here: lanes, rows, elementary functions, compiling and its
cache.
"""
