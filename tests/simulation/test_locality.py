"""Locality of a step: it reads nothing of the course but what is beside the wheel."""

import numpy as np
import pytest

from soil_env._numba.lanes import COUNT
from soil_env.driving.wheels import Simulation
from soil_env.identification.online.curve import FIELDS
from soil_env.identification.online.curve_fit import FIT_ROWS
from soil_env.parameters import load_scenario


def step_spoilt(sim, k, command):
    """Step while all of course k but the patches and cells beside the wheel is NaN, and unused bins too.

    The last patch drawn stays as well: the next may be drawn in this step, and joins it.
    """
    courses, w = sim.worlds.courses, sim.wheel(k)
    last = courses.patches[k] - 1
    patches, edges, cells = (np.arange(a.shape[1]) for a in (courses.soils, courses.edges, courses.rut_factors))
    far = {
        "soils": (np.abs(patches - w["patch"]) > 1) & (patches < last),
        "grades": (np.abs(patches - w["patch"]) > 1) & (patches < last),
        "margins": patches < last,
        "edges": (edges < w["patch"] - 1) | ((edges > w["patch"] + 2) & (edges < last)),
        "rut_factors": np.abs(cells - w["cell"]) > 3,
        "rut": np.abs(cells - w["cell"]) > 3,
    }
    kept = {name: getattr(courses, name)[k, where].copy() for name, where in far.items()}
    for name, where in far.items():
        getattr(courses, name)[k, where] = np.nan
    banks = sim.worlds.ids.banks
    used = int(banks.point.bins[k])
    banks.bins[k, used * FIELDS :] = banks.fits[k, used * FIT_ROWS * COUNT :] = np.nan
    sim.step(k, command)
    for name, where in far.items():
        getattr(courses, name)[k, where] = kept[name]


@pytest.mark.parametrize("length", [10.0, 200.0])
def test_a_step_reads_only_the_course_beside_the_wheel(length):
    """Its cost then depends neither on the length of the course nor on the distance driven."""
    changes = {
        "course": {"length": length, "margin": [0.2, 0.25], "grade_deg": [-6.0, 2.0]},
        "control": {"action": "torque", "time_limit": 900.0},
    }
    scenario = load_scenario("mixed", changes)
    sims = [Simulation(4, scenario, "true_soil", threads=1, estimates=True) for _ in range(2)]
    rng, far = np.random.default_rng(0), 0.0
    for sim in sims:
        for k in range(4):
            sim.seed(k, np.random.default_rng(k))
            sim.restart(k)
    for _ in range(150):
        commands = rng.uniform(0.2, 0.6, 4)
        for k in range(4):
            sims[0].step(k, commands[k])
            step_spoilt(sims[1], k, commands[k])
            if sims[0].worlds.cause[k]:
                for sim in sims:
                    sim.restart(k)
        assert [sims[0].wheel(k) for k in range(4)] == [sims[1].wheel(k) for k in range(4)]
        for name in ("observation", "reward"):
            np.testing.assert_array_equal(getattr(sims[0].worlds, name), getattr(sims[1].worlds, name), name)
        np.testing.assert_array_equal(sims[0].worlds.ids.estimate, sims[1].worlds.ids.estimate)
        far = max(far, sims[0].worlds.state["x"].max())
    assert far > 4.0
