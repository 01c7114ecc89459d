"""Policy that comes with the package: its common layout, its training, its file, and that it drives every ground."""

import json
from dataclasses import replace

import numpy as np
import pytest

from agents import default_policy, generalist, student
from agents.common_layout import ADDED, COMMON, NAMES, CommonScaling
from agents.default_policy import WEIGHTS, DefaultPolicy
from agents.environment import hidden_worlds
from agents.evaluate import run_courses
from agents.evaluate.contestants import parse
from agents.evaluate.loading import check, load
from agents.teachers import Teachers
from soil_env._io.loading import ParameterError
from soil_env.cli import main as soil_env
from soil_env.env import SoilWheelEnv
from soil_env.parameters import load_scenario
from soil_env.vehicle import load_rover

GROUNDS = ("mixed", "two_lines", "loose_slopes", "sticky", "field_vehicle", "unseen")
TINY = {"grounds": {"two_lines": {"wheels": 8}, "field_vehicle": {"wheels": 4}}, "hidden": 2}
TINY["ppo"] = {"num_envs": 12, "batch_size": 64, "layer": 8, "threads": 1}


@pytest.fixture(scope="module")
def trained():
    """A model after a few steps on two grounds."""
    model = generalist.load(generalist.Generalist, TINY, "").build()
    student.teach(model, 1000, 0)
    return model


@pytest.mark.parametrize("name", GROUNDS)
def test_it_drives_every_wheel_scenario(name):
    scenario = load_scenario(name)
    runs = run_courses(DefaultPolicy(scenario), scenario, 5, 12)
    assert runs.metric("finished").mean() >= (0.3 if name in ("sticky", "unseen") else 0.7)


def test_common_layout_is_that_of_two_lines_with_a_flag_and_the_drive():
    for name, camera in (("two_lines", 1.0), ("mixed", 0.0)):
        env = SoilWheelEnv(name, scaled=True)
        seen, _ = env.reset(seed=1)
        common = CommonScaling(env.scenario)(env.physical(seen)[None])[0]
        np.testing.assert_allclose(common[: seen.size], seen, atol=1e-5)
        assert not common[seen.size : -len(ADDED)].any()
        np.testing.assert_allclose(common[-len(ADDED) :], [camera, 0.2, 1.5857, 0.15], rtol=1e-3)
        assert len(common) == len(NAMES) == len(COMMON) + len(ADDED)


@pytest.mark.parametrize(
    "scenario, said",
    [
        (load_scenario("mixed", {"control": {"action": "torque"}}), "expected 'rim_acceleration' of 0.5 s"),
        (load_scenario("two_lines", {"course": {"classes": 2}}), "expected no classes, or 3 with 2 lines"),
        (load_rover("mars_rover"), "a rover; expected one of a wheel"),
    ],
)
def test_other_tasks_are_refused(scenario, said):
    with pytest.raises(ParameterError, match=said):
        DefaultPolicy(scenario)


def test_weights_are_small_arrays_without_pickles(tmp_path):
    assert WEIGHTS.stat().st_size <= 1_000_000
    with np.load(WEIGHTS, allow_pickle=False) as archive:
        made = json.loads(str(archive["made"]))
    held_out = load_scenario("unseen").soils
    grounds = made["config"]["grounds"]
    assert "unseen" not in grounds and "shear_softening" in made["config"]["without"]
    trained_on = [load_scenario(own["scenario"] or name, own["changes"]).soils for name, own in grounds.items()]
    assert not {"mars_simulant_dlr", "mars_slope_soil"} & set().union(*trained_on) and "mars_slope_soil" in held_out
    bad = tmp_path / "bad.npz"
    bad.write_bytes(b"no zip")
    with pytest.raises(ParameterError, match="not the weights of a default policy"):
        DefaultPolicy(load_scenario("mixed"), bad)


def test_the_file_acts_as_the_trained_model(trained, tmp_path):
    model = trained
    np.savez(tmp_path / "weights.npz", **generalist.arrays(model, 7, {}))
    env = model.get_vec_normalize_env()
    seen = env.reset()
    for _ in range(5):
        action = model.predict(seen, deterministic=True)[0]
        policy = DefaultPolicy(load_scenario("two_lines"), tmp_path / "weights.npz")
        np.testing.assert_allclose(np.clip(policy.action(seen), -1, 1), action, atol=1e-5)
        seen = env.step(action)[0]


def test_teachers_of_several_grounds_and_hidden_worlds(trained):
    """Each wheel has the teacher of its ground; no hidden world has an effect that is left out."""
    env = trained.get_vec_normalize_env().unwrapped
    assert [(p.num_envs, p.scenario.name, p.model is None) for p in env.parts] == [
        (4, "two_lines", True), (2, "two_lines", False), (2, "two_lines", False),
        (2, "field_vehicle", True), (1, "field_vehicle", False), (1, "field_vehicle", False),
    ]  # fmt: skip
    teachers = Teachers(env)
    fast, slow = teachers.parts[0][1].settings, teachers.parts[-1][1].settings
    assert fast["speed"] == pytest.approx(0.54 * 0.75) and slow["speed"] == pytest.approx(0.36 * 2.8233, rel=1e-3)
    action, choosing, weight = teachers.lesson(np.ones(12, dtype=bool))
    assert action.shape == (12, 1) and choosing.shape == weight.shape == (12,)
    effects = {name for w in hidden_worlds(load_scenario("mixed"), 30, 0, ("grousers",)) for name in w.effects}
    assert "grousers" not in effects and "shear_softening" in effects


def test_it_is_a_contestant_and_drives_from_the_command(capsys):
    scenario = load_scenario("mixed")
    for text in ("default_policy", "default"):
        (contestant,) = parse(text).values()
        assert contestant.name == default_policy.NAME
        check(contestant, scenario)
    assert load(contestant, replace(scenario)).variant == "identified"
    assert soil_env(["drive", "--policy", "default", "--scenario", "loose_slopes", "--seed", "2"]) == 0
    assert capsys.readouterr().out.startswith("default_policy: ")


def test_it_is_exported_to_onnx(tmp_path):
    pytest.importorskip("onnxruntime", reason="onnx and onnxruntime are in the extra export")
    for name in ("two_lines", "mixed"):
        assert soil_env(["export", "default", "--scenario", name, f"--out={tmp_path / name}", "--steps=60"]) == 0
        scenario = load_scenario(name)
        (exported,) = parse(str(tmp_path / name)).values()
        both = [run_courses(d, scenario, 5, 4) for d in (DefaultPolicy(scenario), load(exported, scenario))]
        np.testing.assert_allclose(both[0].distance, both[1].distance, atol=1e-3)
