"""What compiled functions share: flags, elementary functions, random streams, the cache."""
