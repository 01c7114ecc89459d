"""The fit of the base model to a table."""

import numpy as np
import pytest

from tests.discovery.files import SETUP, csv_text, data_of, world
from tests.discovery.tables import problem


def test_a_fit_leaves_a_start_on_a_bound(tmp_path):
    """The fit starts at the prior means, and that of the cohesion is its bound."""
    setup = SETUP.replace("{value: 3700, sd: 700}", "{value: 0, sd: 2000}")
    setup = setup.replace("{value: 30, sd: 1.5}", "{value: 25, sd: 5}")
    slip, load = (x.ravel() for x in np.meshgrid((0.05, 0.2, 0.5), (80.0, 150.0)))
    values = world({}).predict({"slip": slip, "load": load})
    names = ("slip", "load", "sinkage", "drawbar_pull", "torque")
    rows = np.column_stack([slip, load, *values[:3]])
    data = data_of(tmp_path, csv_text(names, rows), setup)
    fit = problem(data, np.random.default_rng(0)).fit()
    assert fit.converged
    found = fit.parameters()
    assert found["friction_angle_deg"] == pytest.approx(31.0, abs=1.5)
    assert found["cohesion"] == pytest.approx(3500.0, abs=800.0)
