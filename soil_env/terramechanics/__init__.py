"""Physics of a wheel on soil: contact, named effects, residual law, steady state, `WheelSoilModel`,
traversability.
"""
