"""Predictions with all effects: remainders, rows that were not made, stated deviations."""

import math

import numpy as np
import pytest

from soil_env._io.loading import ParameterError
from soil_env.discovery.outlook import curves_of
from soil_env.discovery.prediction import (
    FLOW,
    WIDER,
    effects_to_fit,
    fit_prediction,
    independent,
)
from soil_env.discovery.search import candidates
from tests.discovery.files import (
    LOADS,
    NOISE,
    PLANTED,
    SETUP,
    csv_text,
    data_of,
    problem_of,
    table_text,
    with_column,
    world,
)


def truth(effects, slip, load):
    """[N, 3] of sinkage [m], pull [N] and torque [N m] of `world(effects)`, without noise."""
    found = world(effects).predict({"slip": np.array(slip), "load": np.array(load)})
    return np.stack(found[:3], axis=1)


def over_noise(values):
    """Root mean square of [N, 3] values over the noise of their channels."""
    return math.sqrt(float(np.mean((values / list(NOISE.values())) ** 2)))


def test_rows_that_were_not_made_are_predicted_within_the_stated_deviations(
    planted_problem, learnt
):
    slip = [0.08, 0.25, 0.48, 0.16, 0.36]
    load = [100.0, 150.0, 90.0, 200.0, 170.0]
    at = {"slip": np.array(slip), "load": np.array(load)}
    y = truth(PLANTED, slip, load)
    full = learnt.at(at)
    base = fit_prediction(planted_problem, (), with_remainder=False).at(at)
    assert over_noise(full.mean - y) < min(1.0, 0.7 * over_noise(base.mean - y))
    assert np.all(full.sd > 0.9 * np.array(list(NOISE.values())))
    assert np.mean(np.abs(full.mean - y) < 2.0 * full.sd) > 0.9


def test_far_rows_are_less_sure(learnt):
    near, far = (
        learnt.at({"slip": np.array([0.3]), "load": np.array([load])}).sd for load in (120.0, 600.0)
    )
    assert np.all(far > 2.0 * near)


def test_the_deviations_of_a_model_without_remainder_are_those_of_noise_and_soil(tmp_path):
    problem = problem_of(tmp_path, table_text({}, loads=LOADS))
    found = fit_prediction(problem, (), with_remainder=False).at({"slip": [0.25], "load": [120.0]})
    assert found.sd[0] / list(NOISE.values()) == pytest.approx(WIDER, rel=0.25)
    assert np.all(found.sd[0] >= WIDER * np.array(list(NOISE.values())))


def test_a_smooth_remainder_that_no_effect_has_is_predicted(tmp_path):
    """A torque with a hump of ten times the noise amid the slips."""
    slips = np.linspace(0.02, 0.6, 12)

    def hump(slip):
        return 1.0 * np.exp(-0.5 * ((slip - 0.3) / 0.08) ** 2)

    text = with_column(
        table_text({}, loads=LOADS, slips=slips),
        "torque",
        lambda row: row["torque"] + float(hump(row["slip"])),
    )
    problem = problem_of(tmp_path, text)
    at = {"slip": np.array([0.285, 0.32]), "load": np.array([110.0, 140.0])}
    y = truth({}, at["slip"], at["load"])
    y[:, 2] += hump(at["slip"])
    with_it, without = (
        fit_prediction(problem, with_remainder=smooth).at(at).mean for smooth in (True, False)
    )
    off, more = (np.abs(found - y)[:, 2].max() for found in (with_it, without))
    assert off < 0.25 < more


def test_what_follows_from_slip_is_no_condition_of_its_own(tmp_path):
    text = with_column(table_text({}, loads=LOADS), "speed", lambda row: 0.1 * (1.0 - row["slip"]))
    problem = problem_of(tmp_path, text)
    assert list(problem.data.varied) == independent(problem) == ["slip", "load"]
    assert "penetration_rate" in candidates(problem)[1]
    assert not {"penetration_rate", "shear_rate"} & {c.effect for c in effects_to_fit(problem)}
    assert curves_of(problem) is not None


def test_a_grade_by_a_latin_square_of_load_and_speed_is_a_condition_of_its_own(tmp_path):
    speeds = (0.05, 0.1, 0.2)
    grades = (-5.0, 0.0, 5.0)
    text = table_text({}, loads=LOADS, speed=speeds, grade_deg=grades)
    header, *lines = text.splitlines()
    square = {
        (load, speed, grades[(i + j) % 3])
        for i, load in enumerate(LOADS)
        for j, speed in enumerate(speeds)
    }
    chosen = [k for k in lines if tuple(map(float, k.split(",")[:3])) in square]
    assert len(chosen) == len(lines) // 3
    problem = problem_of(tmp_path, "\n".join((header, *chosen)) + "\n")
    assert list(problem.data.varied) == ["slip", "load", "speed", "grade_deg"]
    assert "grade" in candidates(problem)[0]


def test_conditions_of_scattered_runs_are_each_their_own(tmp_path):
    rng = np.random.default_rng(1)
    ends = {"slip": (0.05, 0.5), "load": (80, 180), "speed": (0.05, 0.2), "grade_deg": (-5, 5)}
    values = [rng.integers(1, 4, 60), *(rng.uniform(*both, 60) for both in ends.values())]
    table = csv_text(("pass", *ends, "torque"), np.stack([*values, 1.0 + 3.0 * values[1]], axis=1))
    assert set(data_of(tmp_path, table).varied) == {"pass", *ends}


def test_a_table_of_one_level_of_slip_and_of_load_is_refused_in_a_line(tmp_path):
    with pytest.raises(ParameterError, match="at least two different slips"):
        data_of(tmp_path, table_text({}, loads=(100,), slips=(0.2, 0.202), speed=(0.05, 0.1)))


def test_a_soil_known_to_be_cohesionless_moves_off_its_bound(tmp_path):
    """A prior about 0 is no fixed value: the fit finds the cohesion of the table."""
    setup = """\
wheel: {radius: 0.15, width: 0.12, grouser_height: 0.01}
soil:
  friction_angle_deg: {value: 31, sd: 0.5}
  cohesion: {value: 0, sd: 3000}
  density: 1600
noise: {sinkage: 0.0006, drawbar_pull: 0.8, torque: 0.1}
"""
    problem = problem_of(tmp_path, table_text({}), setup)
    assert fit_prediction(problem, (), with_remainder=False).values["cohesion"] > 1500.0


def test_a_table_of_one_channel_is_predicted(tmp_path):
    problem = problem_of(tmp_path, table_text(PLANTED, loads=LOADS, channels=("drawbar_pull",)))
    found = fit_prediction(problem).at({"slip": np.array([0.25]), "load": np.array([120.0])})
    y = truth(PLANTED, [0.25], [120.0])
    assert abs(found.mean[0, 1] - y[0, 1]) < 2.0
    assert np.all(np.isfinite(found.mean)) and np.all(found.sd > 0.0)


def test_flow_that_the_setup_states_is_known(tmp_path):
    setup = SETUP.replace("soil:\n", "soil:\n  rim_flow: 0.05\n")
    text = table_text({}, loads=LOADS)
    for stated, names in ((SETUP, {"soil_flow"}), (setup, set())):
        problem = problem_of(tmp_path, text, stated)
        assert {c.effect for c in effects_to_fit(problem)} & {"soil_flow"} == names
    unknowns = fit_prediction(problem_of(tmp_path, text)).law.unknowns
    (flow,) = (k for k in unknowns if k.name == "soil_flow_rim_flow")
    assert FLOW["soil_flow_rim_flow"] == {"mean": flow.mean, "sd": flow.sd}


def test_the_base_model_fits_the_pulls_that_it_made_itself(tmp_path):
    """On a soil of little cohesion: a start with far more leads to a minimum ten times as high."""
    pulls = {0.0: 17.2, 0.05: 24.4, 0.1: 30.6, 0.2: 40.9, 0.4: 55.2, 0.6: 64.3, 0.75: 69.0}
    lines = [f"{slip},170,{pull}" for slip, pull in pulls.items()]
    setup = "wheel: {radius: 0.225, width: 0.2}\nnoise: {drawbar_pull: 4}\n"
    problem = problem_of(tmp_path, "\n".join(["slip,load,drawbar_pull", *lines]) + "\n", setup)
    residual = fit_prediction(problem, (), with_remainder=False).residual
    assert residual == pytest.approx(np.zeros(7), abs=0.5)
