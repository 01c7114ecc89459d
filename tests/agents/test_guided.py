"""Agents that trim a slip controller: untrained they are that controller, and what is saved is what is loaded."""

import numpy as np
import pytest
import torch

from agents import ppo
from agents.controllers import make_controller
from agents.evaluate import run_courses
from agents.evaluate.models import load_model
from agents.guided import GUIDES, Guide, GuidedVecEnv, make_guide
from agents.ppo import PPOConfig, TrainConfig, build, load_agent, resume, save
from agents.sb3 import SoilWheelVecEnv
from soil_env._io.loading import ParameterError
from soil_env.parameters import load_scenario
from soil_env.task import layout
from tests.agents.saved import edit

TINY = PPOConfig(num_envs=4, n_steps=16, batch_size=32, n_epochs=1, layer=8)
SETTINGS = {"start": 0.2}
BLIND = len(layout("blind"))
VARIANT = {"fixed_slip": "blind", "best_slip_identified": "identified", "best_slip_true": "true_soil"}


@pytest.fixture(scope="module")
def scenario():
    return load_scenario("mixed", {"course": {"length": 2.0}, "control": {"time_limit": 8.0}})


def guide(scenario, name="best_slip_identified", **more):
    return Guide(scenario, **{"controller": name, "settings": SETTINGS, "trim": 1.4, "variant": VARIANT[name], **more})


def silent(model):
    """The same model with a mean action of zero, whatever it sees."""
    with torch.no_grad():
        model.policy.action_net.weight.zero_()
        model.policy.action_net.bias.zero_()
    return model


@pytest.mark.parametrize("action", ["torque", "wheel_speed"])
@pytest.mark.parametrize("name", GUIDES)
def test_an_agent_that_does_nothing_drives_as_its_guide(tmp_path, scenario, name, action):
    scenario = load_scenario(scenario, {"control": {"action": action}})
    save(silent(build(scenario, VARIANT[name], TINY, 0, guide=guide(scenario, name))), tmp_path / "model.zip")
    agent = run_courses(load_model(tmp_path / "model.zip", scenario), scenario, 3, 8)
    alone = run_courses(make_controller(name, scenario, **SETTINGS), scenario, 3, 8)
    for field in ("cause", "distance", "energy", "returns"):
        np.testing.assert_array_equal(getattr(agent, field), getattr(alone, field))


def test_the_trim_multiplies_the_rim_speed(scenario):
    one = guide(scenario, "fixed_slip", trim=0.5)
    observation = np.zeros((3, BLIND))
    observation[:, 5] = 0.3  # travel speed, of the top rim speed
    seen, state = one.observe(observation, None, np.ones(3, dtype=bool))
    start, lead = 0.2, 0.2 * 0.2
    proposed = min(0.3 / (1 - 0.3) + lead, 0.4)  # a slip of 0.3; at least the starting speed, at most 0.4
    np.testing.assert_allclose(seen[:, -2:], [[max(proposed, start), 0.3]] * 3, rtol=1e-6)
    asked = []
    one.controller.command = lambda batch, speed, memory: asked.append(speed) or speed
    one.act(np.array([[-1.0], [0.0], [7.0]]), state)  # beyond 1 is 1
    top = scenario.wheel.radius * scenario.wheel.no_load_speed
    np.testing.assert_allclose(asked[0] / top, proposed * np.exp([-0.5, 0.0, 0.5]), rtol=1e-6)


def test_a_saved_agent_acts_as_before_and_its_checkpoint_goes_on(tmp_path, scenario):
    model = build(scenario, "identified", TINY, 0, guide=guide(scenario))
    model.learn(128)
    save(model, tmp_path / "model.zip")
    agent, other = load_agent(tmp_path), load_model(tmp_path / "model.zip", scenario)
    first, second = (run_courses(a, scenario, 4, 6) for a in (agent, other))
    np.testing.assert_array_equal(first.returns, second.returns)
    assert agent.timesteps == 128 and agent.guide.content() == guide(scenario).content()
    again = resume(tmp_path / "model.zip", scenario, "identified", TINY, 0, None, guide=guide(scenario))
    again.learn(64, reset_num_timesteps=False)
    assert again.num_timesteps == 192
    for wrong in (None, guide(scenario, trim=1.0)):
        with pytest.raises(ParameterError, match="guide"):
            resume(tmp_path / "model.zip", scenario, "identified", TINY, 0, None, guide=wrong)


def test_the_last_observation_of_a_course_has_the_guide_s_entries(scenario):
    """SB3 values a course cut off by the time limit at its last observation."""
    short = load_scenario(scenario, {"control": {"time_limit": 1.0}})
    plain, guided = SoilWheelVecEnv(3, short, "blind"), SoilWheelVecEnv(3, short, "blind")
    one = guide(short, "fixed_slip")
    env = GuidedVecEnv(guided, one)
    plain.seed(9)
    env.seed(9)
    plain.reset()
    seen = env.reset()
    memory = None
    for step in range(10):
        _, memory = one.observe(seen[:, :BLIND], memory, np.full(3, step == 0))
        command = one.act(np.zeros((3, 1)), memory)
        _, _, done, infos = plain.step(command)
        seen, _, _, theirs = env.step(np.zeros((3, 1)))
    assert done.all()
    for k in range(3):
        last = theirs[k]["terminal_observation"]
        np.testing.assert_array_equal(last[:BLIND], infos[k]["terminal_observation"])
        own, _ = one.observe(np.array([infos[k]["terminal_observation"]] * 3), memory, np.zeros(3, dtype=bool))
        np.testing.assert_array_equal(last, own[k])
    assert seen.shape == (3, BLIND + 2)


def test_guides_that_cannot_be(scenario):
    for name, variant in (("full_throttle", "blind"), ("best_slip_true", "identified"), ("nobody", "blind")):
        with pytest.raises(ParameterError, match="guide"):
            Guide(scenario, name, {}, 1.0, variant)
    assert make_guide(TrainConfig(), scenario) is None
    made = make_guide(TrainConfig(guide="fixed_slip", guide_settings={"slip": 0.1}, trim=0.3), scenario)
    assert made.content() == {"controller": "fixed_slip", "settings": {"slip": 0.1}, "trim": 0.3}


def test_the_size_of_the_normalisation_is_checked(tmp_path, scenario):
    save(build(scenario, "blind", TINY, 0, guide=guide(scenario, "fixed_slip")), tmp_path / "model.zip")
    edit(tmp_path / "model.zip", guide=None)
    with pytest.raises(ParameterError, match=f"{BLIND} numbers"):
        ppo.read_meta(tmp_path / "model.zip")
