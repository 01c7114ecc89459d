"""Compiled functions that Python calls, kept on disk."""

from numba import njit


def kept(function):
    """Compile a function that Python calls; numba keeps it on disk."""
    return njit(cache=True, nogil=True, error_model="numpy")(function)
