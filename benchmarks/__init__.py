"""Benchmarks, run as `python -m benchmarks.NAME`; numbers and tables of their results are in
docs/results.

`identification`: calibration by drive. `discovery`: blind naming of hidden mechanisms.
`rigs`: the model beside measured wheels. `throughput`: speed.
"""
