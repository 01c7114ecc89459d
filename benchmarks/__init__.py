"""Benchmarks, run as `python -m benchmarks.NAME`; numbers and tables of their results are in docs/results.

`discovery`: blind naming of hidden mechanisms. `throughput`: speed.
"""
