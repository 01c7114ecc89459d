"""Everything that depends on numba's internals: eight-wide lanes, elementary functions, compiling, streams, threads."""
