"""agents.sim2real: what the log becomes, what the workflow makes of it, and the command with tiny budgets."""

import dataclasses
import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from agents.agent import load_agent, read_info
from agents.config import PPOConfig, TrainConfig, load_config
from agents.controllers import make_controller
from agents.evaluate import __main__ as evaluate_command, run_courses
from agents.evaluate.statistics import draws
from agents.evaluate.study import load_study
from agents.sb3 import SoilWheelVecEnv
from agents.sim2real import __main__ as command, carried, drives as driving, report, study, table
from agents.sim2real.drives import Commissioning
from soil_env._io.loading import ParameterError, to_dict
from soil_env.measurement.table import read_setup, read_table
from soil_env.parameters import load_scenario, soils
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel
from soil_env.terramechanics.residual import ResidualTerm
from soil_env.vector_env import SoilWheelVectorEnv

WORLDS = Path(__file__).resolve().parents[2] / "configs" / "worlds"
SCENARIO = load_scenario("mixed", {"course": {"length": 2.0}, "control": {"time_limit": 10.0}})
PLAN = Commissioning(
    grades_deg=(-12.0, -9.0, -6.0, -4.0, -2.0, 0.0, 3.0, 6.0), payloads=(0.0, 8.0), rim_speeds=(0.08, 0.2), hold=10.0
)


@pytest.fixture(scope="module")
def drives():
    """(world, log, points) of a hidden world with bulldozing."""
    world = WheelSoilModel.load(WORLDS / "bulldozing.yaml")
    drives = driving.drive_all(SCENARIO, world, PLAN, 3)
    return world, drives, table.steady_points(drives, SCENARIO, PLAN)


def test_table_and_setup_are_read_back(drives, tmp_path):
    world, _, points = drives
    table.write_table(points, tmp_path / "table.csv")
    table.write_setup(table.setup(SCENARIO, world.wheel, PLAN, points), tmp_path / "setup.yaml")
    setup = read_setup(tmp_path / "setup.yaml")
    read = read_table(tmp_path / "table.csv", setup.wheel)
    assert len(read) == len(points) > 10
    assert read.given == set(table.COLUMNS)
    assert np.allclose(read.slip, [p.mean["slip"] for p in points], rtol=1e-5)
    assert setup.soil.dig_gain.value == soils()[PLAN.soil].dig_gain and setup.soil.dig_gain.known
    assert setup.soil.friction_angle_deg.sd == SCENARIO.belief.friction_sd_deg
    assert len((tmp_path / "table.errors.csv").read_text().splitlines()) == len(points) + 1


def test_points_are_steady_values_of_the_world_on_its_bed(drives):
    """Means of the log agree with the steady prediction of the true model, within the noise that the setup states."""
    world, _, points = drives
    bed = driving.bed_soil(SCENARIO, PLAN, np.random.default_rng([3, 7]))
    at = {name: np.array([p.mean[name] for p in points]) for name in ("slip", "load", "speed")}
    expected = WheelSoilModel(world.wheel, bed, world.effects).predict(at)
    noise = table.repeat_noise(PLAN, points)
    for name in table.CHANNELS:
        e = (np.array([p.mean[name] for p in points]) - getattr(expected, name)) / noise[name]
        assert np.sqrt(np.mean(e**2)) < 1.4, name
        assert abs(e.mean()) < 0.6, name


def _readings(n=40, **drift):
    t = SCENARIO.control.period * np.arange(n)
    flat = {"slip": 0.1, "sinkage": 0.03, "drawbar_pull": 10.0, "load": 150.0, "torque": 5.0, "speed": 0.1}
    readings = {name: value + drift.get(name, 0.0) * t for name, value in flat.items()}
    zero = np.zeros(n, dtype=int)
    return driving.Log(zero, zero, t, np.ones(n, dtype=bool), readings)


@pytest.mark.parametrize("drift", [{"speed": 0.02}, {"sinkage": 0.003}, {"slip": 0.02}])
def test_a_window_that_drifts_is_not_steady(drift):
    rows = np.arange(40)
    assert table.steady(_readings(), rows, SCENARIO, PLAN)
    assert not table.steady(_readings(**drift), rows, SCENARIO, PLAN)


def test_a_window_that_scatters_or_stands_is_not_steady():
    rows, shaken, standing = np.arange(40), _readings(), _readings()
    shaken.readings["slip"][::2] += 0.1
    standing.readings["speed"][:] = 0.0
    assert not table.steady(shaken, rows, SCENARIO, PLAN)
    assert not table.steady(standing, rows, SCENARIO, PLAN)


def test_points_lie_after_the_run_in_and_last_long_enough(drives):
    _, whole, points = drives
    for p in points:
        inside = (whole.run == p.run) & (whole.stretch == p.stretch) & (whole.time >= p.start) & (whole.time <= p.time)
        assert whole.ran_in[inside].all()
        assert inside.sum() * SCENARIO.control.period >= 0.5 * PLAN.hold
        assert np.isclose(whole.readings["torque"][inside].mean(), p.mean["torque"])
    assert len({(p.run, p.stretch) for p in points}) == len(points)


def test_repeat_noise_is_that_of_the_readings_and_of_slip():
    """y = 100 i + noise of 0.5, slip off by 0.004: the noise of y at its slip is hypot(0.5, 0.4)."""
    rng, plan = np.random.default_rng(5), dataclasses.replace(PLAN, repeats=20)
    points = []
    for run in range(len(plan.payloads) * len(plan.grades_deg) * plan.repeats):
        true = 0.1 * (run // plan.repeats % len(plan.grades_deg))
        slip = true + 0.004 * rng.standard_normal()
        mean = {name: 100.0 * true + 0.5 * rng.standard_normal() for name in table.CHANNELS}
        points.append(table.Steady(run, 0, 0.0, 1.0, {"slip": slip, **mean}, {}))
    for value in table.repeat_noise(plan, points).values():
        assert value == pytest.approx(np.hypot(0.5, 0.4), rel=0.15)


def tiny(worlds, **changes):
    """A study that takes seconds."""
    values = {
        "timesteps": 128, "training_seeds": 2, "courses": 5, "tuning_courses": 1, "bootstrap": 10, "logs": 2,
        "commissioning": PLAN, "ppo": PPOConfig(num_envs=8, n_steps=16, batch_size=64, n_epochs=1, layer=8),
    }  # fmt: skip
    return study.Study(SCENARIO, study.read_worlds(worlds, SCENARIO), **(values | changes))


@pytest.mark.slow
@pytest.mark.usefixtures("unrendered")
def test_study_finds_the_planted_effect_reports_and_resumes(tmp_path):
    asked = tiny([WORLDS / "bulldozing.yaml"])
    study.begin(asked, tmp_path)
    study.run(asked, tmp_path, lambda text: None)
    result = report.result(asked, tmp_path)
    assert report.write(asked, result, tmp_path) == list(report.FILES)
    world = json.loads((tmp_path / "sim2real.json").read_text())["worlds"]["bulldozing"]
    assert world["verdict"] == "named" and list(world["found"]) == ["bulldozing"]
    assert world["found"]["bulldozing"]["hegedus"] == pytest.approx(1.0, rel=0.1)
    assert set(world["controllers"]) == set(study.CONTROLLERS)
    for row in world["controllers"].values():
        assert set(row) == {"immobilised", "finished", "return", "gap", "gap_same"}
        for group in row.values():
            for m in group.values():
                assert m["low"] <= m["value"] <= m["high"]
    page = (tmp_path / "sim2real.md").read_text()
    assert "bulldozing (hegedus 1)" in page and "same compiled model" in page
    # the corrected agent was trained in the corrected simulation, and its files say so
    found = WheelSoilModel.load(tmp_path / "worlds/bulldozing/corrected.yaml")
    trained = tmp_path / "worlds/bulldozing/corrected/ppo_0"
    assert read_info(trained / "model.zip").model == found.content()
    assert "bulldozing" in (trained / "config.yaml").read_text()
    assert not read_info(tmp_path / "uncorrected/ppo_0/model.zip").model
    assert load_agent(trained).name == study.PPO
    # again: nothing is done twice, what is missing is done again with the same result
    times = {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*.zip")}
    lost = tmp_path / "worlds/bulldozing/runs/corrected/soft_start.json"
    before = lost.read_bytes()
    lost.unlink()
    study.begin(asked, tmp_path)
    study.run(asked, tmp_path, lambda text: None)
    assert lost.read_bytes() == before
    assert {p: p.stat().st_mtime_ns for p in tmp_path.rglob("*.zip")} == times
    with pytest.raises(ParameterError, match="another study.*timesteps"):
        study.begin(dataclasses.replace(asked, timesteps=256), tmp_path)


def test_nothing_named_is_nothing_corrected(tmp_path):
    """The arm of a world where nothing was found is the uncorrected one."""
    asked = tiny([WORLDS / "bulldozing.yaml"])
    base = study.Arm(asked, tmp_path, None)
    nothing = WheelSoilModel(ModelWheel(0.15, 0.15))
    assert study.corrected_arm(asked, base, tmp_path, nothing) is base


def test_named_effects_are_carried_over_in_part_too_and_a_law_is_not(tmp_path, monkeypatch):
    term = ResidualTerm("drawbar_pull", -0.04, {"slip": 1.0}, {"slip": [0.1, 0.3]})
    model = WheelSoilModel(ModelWheel(0.15, 0.15), soils()["dry_sand"], {"bulldozing": {"rankine": 1.0}}, (term,))
    partly = SimpleNamespace(effects=("bulldozing",), model=model)
    monkeypatch.setattr(study, "find_discrepancy", lambda *_, **__: partly)
    (tmp_path / "setup.yaml").touch()  # the drives are over
    asked = tiny([WORLDS / "bulldozing.yaml"])
    found = study.correct(asked, "bulldozing", tmp_path, lambda text: None, asked.seed)
    assert found.soil is None and found.effects == model.effects and found.residual == ()
    assert WheelSoilModel.load(tmp_path / "corrected.yaml") == found


def test_forces_left_are_those_of_what_acts():
    """A pull of -3 % of the load in the hidden world: that much is left without it, and nothing with it."""
    wheel, w = ModelWheel(0.15, 0.15), SCENARIO.weight
    hidden = WheelSoilModel(wheel, residual=(ResidualTerm("drawbar_pull", -0.03),))
    sensors = WheelSoilModel(wheel, None, {"slip_bias": {"offset": 0.05}, "sinkage_offset": {"offset": 0.01}})
    left = carried.left(SCENARIO, hidden, {"nothing": None, "sensors": sensors, "all": hidden})
    loads = w + np.array(SCENARIO.course.payload) * SCENARIO.gravity
    assert left["nothing"]["drawbar_pull"] == pytest.approx(0.03 * np.sqrt(np.mean(loads**2)), rel=1e-6)
    assert left["nothing"]["torque"] == pytest.approx(0.0, abs=1e-9)
    assert left["sensors"] == left["nothing"]
    assert left["all"] == {"drawbar_pull": 0.0, "torque": 0.0}


def test_gaps_are_those_of_the_scores():
    """gap = own - hidden; its change = after - before."""

    def scores(value):
        return {"return": np.full((1, 4), value), "immobilised": np.zeros((1, 4)), "finished": np.ones((1, 4))}

    own, hidden = (
        {"uncorrected": scores(8.0), "corrected": scores(5.0)},
        {"uncorrected": scores(2.0), "corrected": scores(4.0)},
    )
    row = report._controller("soft_start", own, hidden, scores(3.0), draws(0, 4, 20), True)
    assert [row["gap"][k]["value"] for k in ("before", "after", "change")] == [6.0, 1.0, -5.0]
    assert row["gap_same"]["after"]["value"] == 1.0
    assert row["return"]["difference"]["value"] == 2.0
    assert row["immobilised"]["corrected"]["high"] == pytest.approx(0.4899, abs=1e-3)  # Wilson, 0 of 4


@pytest.mark.parametrize("path", sorted(WORLDS.glob("*.yaml")), ids=lambda p: p.stem)
def test_shipped_worlds_can_be_played(path):
    study.read_worlds([path], load_scenario("mixed"))


@pytest.mark.parametrize(
    ("content", "expected"),
    [
        ("effects: {}", "no effects"),
        ("effects: {bulldosing: {hegedus: 1.0}}", "bulldozing"),

        ("wheel: {radius: 0.3, width: 0.15}\neffects: {bulldozing: {hegedus: 1.0}}", "that of scenario"),
        ("soil: {friction_angle_deg: 30, cohesion: 0, shear_modulus: 0.01, sinkage_exponent: 1, "
         "sinkage_coefficient: 1.0e+6}\neffects: {bulldozing: {hegedus: 1.0}}", "expected no soil"),
    ],
)  # fmt: skip
def test_bad_worlds_are_refused_in_one_line(content, expected, tmp_path, capsys):
    world = tmp_path / "world.yaml"
    world.write_text(("" if "wheel" in content else "wheel: {radius: 0.15, width: 0.15}\n") + content + "\n")
    assert command.main(["--world", str(world), "--out", str(tmp_path / "out")]) == 2
    err = capsys.readouterr().err
    assert err.startswith("agents.sim2real: ") and err.count("\n") == 1 and expected in err
    assert not (tmp_path / "out").exists()


def test_bad_input_is_refused_in_one_line(tmp_path, capsys):
    world, out = str(WORLDS / "bulldozing.yaml"), ["--out", str(tmp_path / "out")]
    (tmp_path / "other").mkdir()
    (tmp_path / "other" / "notes.txt").write_text("mine")
    for arguments, expected in (
        (["--world", "no_such.yaml", *out], "no_such.yaml"),
        (["--world", world, "--timesteps", "0", *out], "timesteps"),
        (["--world", world, world, *out], "second world"),
        (["--world", world, "--out", str(tmp_path / "other")], "not empty"),
    ):
        assert command.main(arguments) == 2
        err = capsys.readouterr().err
        assert err.startswith("agents.sim2real: ") and err.count("\n") == 1 and expected in err
    assert [p.name for p in tmp_path.rglob("*")] == ["other", "notes.txt"]


# --- the model on its way through training and evaluation -------------------------------------------------------------


def test_config_keeps_the_content_of_the_model(tmp_path):
    config = load_config({"model": str(WORLDS / "grousers.yaml")}, "test")
    assert config.world.effects == {"grousers": {"shear_share": 0.7, "slip_at_rim": 1.0}}
    assert load_config(to_dict(config), "again") == config
    assert TrainConfig().world is None
    with pytest.raises(ParameterError, match="no_such.yaml"):
        load_config({"model": str(tmp_path / "no_such.yaml")}, "test")
    with pytest.raises(ParameterError, match="bulldozing"):
        load_config({"model": {"wheel": {"radius": 0.15, "width": 0.15}, "effects": {"bulldosing": {}}}}, "test")


def test_courses_and_training_meet_the_effects_of_the_model():
    """Driving and the env that PPO learns in run as the vector env does with the same model, and not as without."""
    model = WheelSoilModel.load(WORLDS / "bulldozing.yaml")
    learning = SoilWheelVecEnv(4, SCENARIO, model=model)
    learning.seed(11)
    expected = SoilWheelVectorEnv(4, SCENARIO, model=model)
    plain = SoilWheelVectorEnv(4, SCENARIO)
    first = learning.reset()
    assert np.array_equal(first, expected.reset(seed=11)[0])
    plain.reset(seed=11)
    action = np.full((4, 1), 0.3, dtype=np.float32)
    for _ in range(8):
        got, want, other = (env.step(action)[0] for env in (learning, expected, plain))
    assert np.array_equal(got, want)
    assert not np.allclose(got, other, atol=1e-3)
    controller = make_controller("constant_speed", SCENARIO)
    with_model = run_courses(controller, SCENARIO, 5, 3, model=model).returns
    assert not np.allclose(with_model, run_courses(controller, SCENARIO, 5, 3).returns)


def test_evaluation_names_its_model(tmp_path):
    world = str(WORLDS / "bulldozing.yaml")
    arguments = "--controllers constant_speed --courses 3 --resamples 10 --changes.course.length 2".split()
    for name, more in (("with", ["--model", world]), ("without", [])):
        assert evaluate_command.main([*arguments, "--out", str(tmp_path / name), *more]) == 0
    results = [json.loads((tmp_path / n / "evaluation.json").read_text()) for n in ("with", "without")]
    content = WheelSoilModel.load(world).content()
    assert results[0]["model"] == content and "model" not in results[1]
    assert load_study(tmp_path / "with").model == content
    value = [r["controllers"]["constant_speed"]["metrics"]["return"]["value"] for r in results]
    assert value[0] != value[1]
    assert evaluate_command.main([*arguments, "--out", str(tmp_path / "with")]) == 2  # another evaluation
