"""What is left out and predicted."""

import math

import numpy as np
import pytest

from soil_env._io.loading import ParameterError
from soil_env.discovery.corrected import corrected
from soil_env.discovery.outlook import (
    MOST_GROUPS,
    _left_out,
    curves_of,
    outlook,
)
from soil_env.discovery.prediction import fit_prediction
from soil_env.terramechanics.validity import OutsideValidity
from tests.discovery.files import (
    LOADS,
    NOISE,
    PLANTED,
    SAND_SETUP,
    SETUP,
    csv_text,
    on_sand,
    problem_of,
    sand_text,
    table_text,
    with_column,
    world,
)


def test_the_outlook_tells_how_well_each_model_predicts(planted_problem):
    slips, loads = outlook(planted_problem).left_out
    assert slips.what == ("slip",) and loads.what == ("load",)
    for way in (slips, loads):
        over = way.over_noise
        assert over.corrected < 1.5 < over.base
        assert over.corrected < over.curve and over.noise == 1.0
        assert set(way.errors) == set(NOISE)
        assert way.errors["torque"].noise == NOISE["torque"]


def test_what_is_left_out_is_left_out_of_all(planted_problem, tmp_path):
    """It is predicted as by a table that never had these rows."""
    levels = planted_problem.data.varied["slip"].level
    group = levels == levels.max()
    slip, load = planted_problem.data.rows.slip[group], planted_problem.data.rows.load[group]
    lines = table_text(PLANTED, loads=LOADS).splitlines()
    kept = [lines[0], *(line for line, out in zip(lines[1:], group, strict=True) if not out)]
    rest = problem_of(tmp_path, "\n".join(kept))
    alone = fit_prediction(rest).mean_at({"slip": slip, "load": load})
    held = _left_out(planted_problem, group.astype(int))
    assert np.abs(held[1, group] - alone) / list(NOISE.values()) == pytest.approx(0.0, abs=0.02)


def test_many_levels_are_left_out_in_ten_groups(tmp_path, monkeypatch):
    problem = problem_of(tmp_path, table_text({}, slips=np.linspace(0.05, 0.6, 12).round(3)))
    groups = []
    monkeypatch.setattr(
        "soil_env.discovery.outlook._left_out",
        lambda _, of: groups.append(of) or np.tile(problem.data.y, (3, 1, 1)),
    )
    outlook(problem)
    assert [np.unique(of).size for of in groups] == [MOST_GROUPS, 3]
    assert np.ptp(problem.data.varied["slip"].level[groups[0] == 1]) == MOST_GROUPS


def test_no_curve_is_drawn_over_conditions_that_it_does_not_know(tmp_path):
    text = table_text({}, loads=(100.0,), **{"pass": (1, 2, 3)})
    problem = problem_of(tmp_path, text)
    assert curves_of(problem) is None
    passes = outlook(problem).left_out[-1]
    assert passes.what == ("pass",) and math.isnan(passes.over_noise.curve)


def climbing() -> str:
    """A table of a wheel that climbs by itself, by hand: the load is vertical, the pull 0."""
    slip, load = (x.ravel() for x in np.meshgrid((0.1, 0.2, 0.35, 0.5), (80.0, 120.0, 180.0)))
    low = np.zeros(slip.size)
    high = low + 0.7  # [rad]
    for _ in range(40):  # bisection of pull along the slope = weight along it
        grade = 0.5 * (low + high)
        found = world({}).predict({"slip": slip, "load": load * np.cos(grade)})
        climbs = found.drawbar_pull > load * np.sin(grade)
        low = np.where(climbs, grade, low)
        high = np.where(climbs, high, grade)
    rows = np.stack([slip, load, np.degrees(grade), found.sinkage, 0.0 * slip, found.torque])
    return csv_text(("slip", "load", "grade_deg", *NOISE), rows.T)


def test_the_pull_of_a_wheel_that_climbs_by_itself_is_not_0_on_the_level(tmp_path):
    problem = problem_of(tmp_path, climbing(), SETUP + "load: vertical\n")
    assert "grade_deg" not in problem.data.varied  # it follows from slip and load
    model = corrected(fit_prediction(problem))
    rows = model.predict(problem.data.table)
    assert np.max(np.abs(rows.drawbar_pull)) < NOISE["drawbar_pull"]
    level = {"slip": 0.3, "load": 120.0}
    pull = world({}).predict(level).drawbar_pull
    assert model.predict(level).drawbar_pull == pytest.approx(pull, abs=NOISE["drawbar_pull"])
    with pytest.raises(ParameterError, match="0 on every grade, .*: expected load: vertical"):
        problem_of(tmp_path, climbing())


@pytest.mark.parametrize(
    ("slips", "most"),
    [((0.05, 0.1, 0.2, 0.35, 0.5, 0.7), (2.0, 0.3)), ((0.6, 0.7, 0.8, 0.9), (4.0, 0.6))],
)
def test_braked_rows_are_predicted_from_driven_ones_where_soil_flows(tmp_path, slips, most):
    """By the constants of the rigs, also in model.yaml where driven rows hardly show the flow; the
    base model errs by half of the pull.
    """
    setup = SAND_SETUP.replace(
        "soil: {cohesion: 1000, friction_angle_deg: {value: 30, sd: 3}}\n", ""
    )
    problem = problem_of(tmp_path, sand_text(slips), setup)
    slip, load, true = on_sand((-0.4, -0.2), (100.0,))
    at = {"slip": slip, "load": load}
    found = fit_prediction(problem)
    with pytest.warns(OutsideValidity):
        simulated = np.stack(corrected(found).predict(at)[:3], axis=1)
    for mean in (found.mean_at(at), simulated):
        off = np.abs(mean - true)
        assert np.all(off[:, 1:] < most)
    base = np.abs(fit_prediction(problem, (), with_remainder=False).mean_at(at) - true)
    assert np.all(base[:, 1] > 15.0) and np.all(base[:, 2] > 2.0)


def test_few_values_of_a_channel_leave_its_fit_alone(tmp_path):
    """Five torques: where a load is left out there is no curve through the rest."""
    kept = {*((0.05, load) for load in LOADS), (0.2, 120.0), (0.42, 80.0)}
    text = with_column(
        table_text(PLANTED, loads=LOADS),
        "torque",
        lambda row: row["torque"] if (row["slip"], row["load"]) in kept else "",
    )
    problem = problem_of(tmp_path, text)
    assert problem.used[:, 2].sum() == 5
    for way in outlook(problem).left_out:
        assert math.isfinite(way.errors["torque"].corrected)
        assert math.isfinite(way.over_noise.corrected)


def test_no_curve_is_drawn_through_two_slips(tmp_path):
    """Any scale of the slip fits them: what the curve says of a third one is arbitrary."""
    slips = (0.1, 0.3, 0.5)
    problem = problem_of(tmp_path, table_text(PLANTED, loads=LOADS, slips=slips))
    assert all(curve is not None for curve in curves_of(problem))
    rest = problem.without(problem.data.rows.slip == 0.1)
    assert curves_of(rest) == [None, None, None]
