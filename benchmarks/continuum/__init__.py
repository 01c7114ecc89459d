"""A wheel on a granular continuum: measurement tables and drives of a world that shares no
equation with `soil_env`.
"""
