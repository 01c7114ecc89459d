"""All that touches the insides of numba: eight-wide lanes, elementary functions, compiling, random streams, threads."""
