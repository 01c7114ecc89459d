"""What all compiled functions share: numba's flags, elementary functions, random streams, the cache on disk."""
