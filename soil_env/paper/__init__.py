"""The source paper recomputed beside its printed values: `soil-env paper`."""
