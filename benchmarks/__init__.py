"""Benchmarks, run as `python -m benchmarks.NAME`; numbers and tables of their results are in
docs/results.

`identification`: calibration by drive. `discovery`: blind naming of hidden mechanisms.
`prediction`: rows that were left out. `continuum`: a wheel on a computed continuum, from its table
to a drive on it. `rigs`: the model beside measured wheels. `robustness`: wrong and dead sensors.
`gravity`: slopes and pull on the Moon. `next_runs`: proposed runs beside random ones. `throughput`:
speed. Without a page: `sound_tables` and `scattered_tables`, how often a table is doubted and its
intervals hold, and `tyres`, a figure.
"""
