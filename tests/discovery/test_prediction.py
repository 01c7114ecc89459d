"""Predictions with all effects: curves, remainders, held-out rows and stated deviations."""

import dataclasses
import math

import numpy as np
import pytest

from soil_env._io.loading import ParameterError
from soil_env.discovery.calibrate import calibrate
from soil_env.discovery.corrected import corrected
from soil_env.discovery.curve import fit_curve
from soil_env.discovery.prediction import (
    FLOW,
    MOST_OF_CURVE,
    WIDER,
    _left_out,
    at_conditions,
    at_curves,
    curve_weight,
    curves_of,
    effects_to_fit,
    fit_prediction,
    independent,
    outlook,
)
from soil_env.discovery.search import candidates
from soil_env.terramechanics.validity import OutsideValidity
from tests.discovery.files import (
    NOISE,
    PLANTED,
    SAND_SETUP,
    SETUP,
    changed,
    data_of,
    on_sand,
    sand_text,
    table_text,
    with_column,
    world,
)

LOADS = (80.0, 120.0, 180.0)


def problem_of(folder, text, setup=SETUP):
    return calibrate(data_of(folder, text, setup))[0]


def truth(effects, slip, load):
    found = world(effects).predict({"slip": np.array(slip), "load": np.array(load)})
    return np.stack(found[:3], axis=1)


def over_noise(values):
    return math.sqrt(float(np.mean((values / list(NOISE.values())) ** 2)))


def test_a_curve_of_its_own_kind_is_found():
    slip = np.tile(np.linspace(-0.4, 0.6, 11), 3)
    load = np.repeat(LOADS, 11)
    x = load / 120.0
    grown = 1.0 - np.exp(-np.abs(slip) / 0.17)
    y = -3.0 * x**1.2 + x**0.8 * np.where(slip < 0.0, -40.0, 25.0) * grown
    curve = fit_curve(slip, load, y, 0.1)
    assert curve.at(slip, load) == pytest.approx(y, abs=0.15)
    one = fit_curve(slip[:11], load[:11], y[:11], 0.1)
    assert one.powers.tolist() == [1.0, 1.0, 0.0]
    assert one.at(slip[:11], load[:11]) == pytest.approx(y[:11], abs=0.05)


@pytest.fixture(scope="module")
def planted(tmp_path_factory):
    return problem_of(tmp_path_factory.mktemp("planted"), table_text(PLANTED, loads=LOADS))


@pytest.fixture(scope="module")
def learnt(planted):
    return fit_prediction(planted)


def test_rows_that_were_not_made_are_predicted_within_the_stated_deviations(planted, learnt):
    slip = [0.08, 0.25, 0.48, 0.16, 0.36]
    load = [100.0, 150.0, 90.0, 200.0, 170.0]
    at = {"slip": np.array(slip), "load": np.array(load)}
    y = truth(PLANTED, slip, load)
    full = learnt.at(at)
    base = fit_prediction(planted, (), smooth=False).at(at)
    assert over_noise(full.mean - y) < min(1.0, 0.7 * over_noise(base.mean - y))
    assert np.all(full.sd > 0.9 * np.array(list(NOISE.values())))
    assert np.mean(np.abs(full.mean - y) < 2.0 * full.sd) > 0.9


def test_far_rows_are_less_sure(learnt):
    near, far = (
        learnt.at({"slip": np.array([0.3]), "load": np.array([load])}).sd for load in (120.0, 600.0)
    )
    assert np.all(far > 2.0 * near)


def test_a_refit_near_another_is_that_of_its_rows_alone(planted, learnt):
    group = planted.data.varied["slip"].level == 2
    rest = planted.without(group)
    rows = planted.data.rows
    at = {"slip": rows.slip[group], "load": rows.load[group]}
    near, alone = (fit_prediction(rest, near=of).mean_at(at) for of in (learnt, None))
    assert over_noise(near - alone) < 0.5


def test_the_deviations_of_a_model_without_remainder_are_those_of_noise_and_soil(tmp_path):
    problem = problem_of(tmp_path, table_text({}, loads=LOADS))
    found = fit_prediction(problem, (), smooth=False).at({"slip": [0.25], "load": [120.0]})
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
        fit_prediction(problem, smooth=smooth).at(at).mean for smooth in (True, False)
    )
    off, more = (np.abs(found - y)[:, 2].max() for found in (with_it, without))
    assert off < 0.25 < more


def test_the_outlook_tells_how_well_each_model_predicts(planted):
    slips, loads = outlook(planted).left_out
    assert slips.what == ("slip",) and loads.what == ("load",)
    for way in (slips, loads):
        over = way.over_noise
        assert over.corrected < 1.5 < over.base
        assert over.corrected < over.curve and over.noise == 1.0
        assert set(way.errors) == set(NOISE)
        assert way.errors["torque"].noise == NOISE["torque"]


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
    table = (
        ",".join(("pass", *ends, "torque"))
        + "\n"
        + "".join(
            ",".join(f"{x:.4g}" for x in (*row, 1.0 + 3.0 * row[1])) + "\n"
            for row in zip(*values, strict=True)
        )
    )
    assert set(data_of(tmp_path, table).varied) == {"pass", *ends}


def test_a_table_of_one_level_of_slip_and_of_load_is_refused_in_a_line(tmp_path):
    with pytest.raises(ParameterError, match="at least two different slips"):
        data_of(tmp_path, table_text({}, loads=(100,), slips=(0.2, 0.202), speed=(0.05, 0.1)))


def test_no_curve_is_drawn_over_conditions_that_it_does_not_know(tmp_path):
    text = table_text({}, loads=(100.0,), **{"pass": (1, 2, 3)})
    problem = problem_of(tmp_path, text)
    assert curves_of(problem) is None
    found = outlook(problem)
    assert found.model.average is None
    passes = found.left_out[-1]
    assert passes.what == ("pass",) and math.isnan(passes.over_noise.curve)


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
    problem = calibrate(data_of(tmp_path, table_text({}), setup))[0]
    assert fit_prediction(problem, (), smooth=False).values["cohesion"] > 1500.0


def test_a_table_of_one_channel_is_predicted(tmp_path):
    text = table_text(PLANTED, loads=LOADS, channels=("drawbar_pull",))
    problem = problem_of(tmp_path, changed(text, "drawbar_pull", 1.0))
    found = fit_prediction(problem).at({"slip": np.array([0.25]), "load": np.array([120.0])})
    y = truth(PLANTED, [0.25], [120.0])
    assert abs(found.mean[0, 1] - y[0, 1]) < 2.0
    assert np.all(np.isfinite(found.mean)) and np.all(found.sd > 0.0)


def test_the_curve_has_the_weight_with_which_the_average_errs_least(planted):
    y = planted.data.y
    sd = planted.sd
    rng = np.random.default_rng(0)
    off = rng.normal(size=(2, *y.shape)) * sd
    full = y + off[0]
    held = np.stack([y, full, y + 3.0 * off[1]])
    weight = curve_weight(planted, [held])

    def error(at):
        return np.sum(((1.0 - at) * (full - y) + at * (held[2] - y)) ** 2 / sd**2, axis=0)

    assert np.all((0.0 < weight) & (weight < 0.3))
    for other in (weight - 0.02, weight + 0.02):
        assert np.all(error(weight) < error(other))
    curve_right = np.stack([y, full, y])
    assert curve_weight(planted, [curve_right]) == pytest.approx(MOST_OF_CURVE)
    full_right = np.stack([y, y, full])
    assert curve_weight(planted, [full_right]).tolist() == [0.0] * 3
    assert curve_weight(planted, [full_right, curve_right]).tolist() == [0.0] * 3
    unknown = np.stack([y, full, np.full(y.shape, np.nan)])
    assert curve_weight(planted, [unknown]).tolist() == [0.0] * 3


def averaged(problem, weight):
    """The prediction of a problem with a given weight [3] of its curves."""
    model = outlook(problem).model
    assert model.average is not None
    average = model.average._replace(weight=np.array(weight))
    return dataclasses.replace(model, average=average)


def test_an_average_lies_between_fit_and_curve_and_is_less_sure(planted):
    weight = np.array([0.3, 0.1, 0.0])
    model = averaged(planted, weight)
    at = {"slip": np.array([0.08, 0.3, 0.5]), "load": np.array([100.0, 150.0, 240.0])}
    alone = dataclasses.replace(model, average=None).at(at)
    both = model.at(at)
    apart = at_curves(model.average.curves, at_conditions(planted, at).data.rows) - alone.mean
    assert both.mean == pytest.approx(alone.mean + weight * apart)
    assert model.mean_at(at) == pytest.approx(both.mean)
    spread = np.sqrt(weight * (1.0 - weight)) * np.abs(apart)
    assert both.sd == pytest.approx(np.hypot(alone.sd, spread))


def test_an_error_of_the_rig_that_is_left_out_does_not_come_back_by_the_curve(tmp_path):
    """Prediction with and without a tilt differ by its pull, averaged with a curve or not."""
    text = table_text(PLANTED, loads=LOADS)
    problem = problem_of(tmp_path, text, SETUP + "tilt_deg: {value: 0, sd: 1}\n")
    model = averaged(problem, [0.5, 0.5, 0.5])
    at = {"slip": np.array([0.1, 0.4]), "load": np.array([120.0, 200.0])}
    alone = dataclasses.replace(model, average=None)
    level, level_alone = (m.at(at, ["tilt_deg"]).mean for m in (model, alone))
    assert model.at(at).mean - level == pytest.approx(alone.at(at).mean - level_alone)


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
    found = outlook(problem).model
    with pytest.warns(OutsideValidity):
        simulated = np.stack(corrected(found).predict(at)[:3], axis=1)
    for mean in (found.mean_at(at), simulated):
        off = np.abs(mean - true)
        assert np.all(off[:, 1:] < most)
    base = np.abs(fit_prediction(problem, (), smooth=False).mean_at(at) - true)
    assert np.all(base[:, 1] > 15.0) and np.all(base[:, 2] > 2.0)


def test_flow_that_the_setup_states_is_known(tmp_path):
    setup = SETUP.replace("soil:\n", "soil:\n  rim_flow: 0.05\n")
    text = table_text({}, loads=LOADS)
    for stated, names in ((SETUP, {"soil_flow"}), (setup, set())):
        problem = problem_of(tmp_path, text, stated)
        assert {c.effect for c in effects_to_fit(problem)} & {"soil_flow"} == names
    unknowns = fit_prediction(problem_of(tmp_path, text)).law.unknowns
    (flow,) = (k for k in unknowns if k.name == "soil_flow_rim_flow")
    assert (flow.mean, flow.sd) == FLOW["rim_flow"]


def test_an_average_is_of_what_the_curves_know(planted):
    """Not of another wheel, nor of braked slips where no row is braked."""
    model = averaged(planted, [0.5, 0.5, 0.5])
    alone = dataclasses.replace(model, average=None)
    at = {"slip": np.array([-0.3, 0.2, 0.2, 0.2]), "load": np.full(4, 120.0)}
    at |= {"wheel_radius": np.array([0.15, 0.15, 0.2, 0.15]), "pass": np.array([1, 1, 1, 2])}
    same = np.all(model.mean_at(at) == alone.mean_at(at), axis=1)
    assert same.tolist() == [True, False, True, True]


def test_errors_of_the_outlook_are_those_of_the_average(tmp_path):
    """The torque is that of a curve; each level of a condition has the weight of the other rows."""
    text = with_column(
        table_text({}, loads=LOADS),
        "torque",
        lambda row: row["load"] * (0.09 - 0.08 * math.exp(-row["slip"] / 0.3)),
    )
    found = outlook(problem_of(tmp_path, text))
    assert found.model.average is not None and found.model.average.weight[2] > 0.0
    assert all(math.isfinite(way.over_noise.corrected) for way in found.left_out)
    problem = found.model.problem
    (slips, loads) = found.left_out
    for way in (slips, loads):
        name = way.what[0]
        level = problem.data.varied[name].level
        models = (fit_prediction(problem, (), smooth=False), fit_prediction(problem))
        held = {
            n: _left_out(problem, models, problem.data.varied[n].level) for n in ("slip", "load")
        }
        off = np.full(problem.used.shape, np.nan)
        for k in range(level.max() + 1):
            weight = curve_weight(problem, list(held.values()), level != k)
            mean = (1.0 - weight) * held[name][1] + weight * held[name][2]
            off[level == k] = (mean - problem.data.y)[level == k]
        for j, channel in enumerate(NOISE):
            error = np.sqrt(np.mean(off[problem.used[:, j], j] ** 2))
            assert way.errors[channel].corrected == pytest.approx(error)


def test_few_values_of_a_channel_leave_its_fit_alone(tmp_path):
    """Five torques: where a load is left out there is no curve through the rest, though the others
    give it a weight.
    """
    header, *lines = table_text(PLANTED, loads=LOADS).splitlines()
    rows = [dict(zip(header.split(","), line.split(","), strict=True)) for line in lines]
    for row in rows:
        at = (float(row["slip"]), float(row["load"]))
        if at[0] != 0.05 and at not in ((0.2, 120.0), (0.42, 80.0)):
            row["torque"] = ""
    text = "\n".join([header, *(",".join(row.values()) for row in rows)]) + "\n"
    problem = problem_of(tmp_path, text)
    assert problem.used[:, 2].sum() == 5
    for way in outlook(problem).left_out:
        assert math.isfinite(way.errors["torque"].corrected)
        assert math.isfinite(way.over_noise.corrected)


def test_no_curve_is_averaged_in_where_its_loads_cannot_be_judged(tmp_path):
    """Two loads: neither is left out, so the errors are those of the fit alone, though the curve is
    exact for the torque.
    """
    text = with_column(
        table_text({}, loads=(80.0, 180.0)),
        "torque",
        lambda row: row["load"] * (0.09 - 0.08 * math.exp(-row["slip"] / 0.3)),
    )
    problem = problem_of(tmp_path, text)
    found = outlook(problem)
    assert found.model.average is None and [way.split for way in found.left_out] == ["slip"]
    models = (fit_prediction(problem, (), smooth=False), fit_prediction(problem))
    held = _left_out(problem, models, problem.data.varied["slip"].level)
    off = (held[1] - problem.data.y)[problem.used[:, 2], 2]
    assert found.left_out[0].errors["torque"].corrected == pytest.approx(np.sqrt(np.mean(off**2)))
    assert curve_weight(problem, [held])[2] > 0.0
