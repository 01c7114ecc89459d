"""Student of the true-soil rule: what it is taught, what its value network learns, and that it
drives.
"""

import numpy as np
import pytest
import torch
from stable_baselines3.common.callbacks import ConvertCallback

from soil_env.parameters import load_rover, load_scenario
from soil_env_agents import ppo, student
from soil_env_agents.environment import SeveralWorlds, hidden_worlds, normalised
from soil_env_agents.sb3 import SoilRoverVecEnv, SoilWheelVecEnv
from soil_env_agents.teachers import Teacher, Teachers
from tests.agents.learnt import WITH_ROUTES as CONFIG


def test_the_teacher_sees_what_an_environment_with_the_true_soil_observes():
    """Number by number, in two worlds at once. The camera has no error in where a patch begins,
    which is the only difference.
    """
    scenario = load_scenario("two_lines", {"camera": {"border_noise": 0.0}})
    worlds = hidden_worlds(scenario, 2, 0)
    envs = normalised(scenario, "identified", CONFIG, 3, worlds).unwrapped

    options = {"scaled": False, "threads": 1}
    parts = [SoilWheelVecEnv(8, scenario, "true_soil", model=w, **options) for w in worlds]
    plain = SeveralWorlds(parts)
    for env in (envs, plain):
        env.seed(5)
        env.reset()
    rng = np.random.default_rng(0)
    for _ in range(100):
        actions = rng.uniform(-0.2, 0.6, (16, 1)).astype(np.float32)
        envs.step(actions)
        true = np.concatenate([part.true_soil() for part in envs.parts])
        np.testing.assert_array_equal(true, plain.step(actions)[0])


@pytest.mark.parametrize("action", ["rim_acceleration", "wheel_speed", "torque"])
def test_the_ramp_of_a_teacher_begins_at_the_speed_of_the_rim(action):
    """In a steady drive, where the rim turns as commanded but for the droop."""
    exact = {"noise": {"wheel_speed": 0.0}}
    scenario = load_scenario("mixed", exact | {"control": {"action": action}})
    env = SoilWheelVecEnv(8, scenario, "true_soil", scaled=False, threads=1)
    env.seed(3)
    env.reset()
    for k in range(20):
        given = 0.2 if action != "rim_acceleration" or k < 4 else 0.0
        seen = env.step(np.full((8, 1), given, np.float32))[0]
    teacher = Teacher(scenario)
    ramp = teacher.state_for(seen, None, np.ones(8, dtype=bool))["ramp"]
    rim = seen[:, teacher.column["rim_speed"]] * teacher.top_speed
    drives = rim > 0.05  # the others are halted
    assert drives.sum() >= 4
    np.testing.assert_allclose(ramp[drives], rim[drives], rtol=0.03)


def test_returns_are_those_of_courses_that_have_ended():
    kept = student.Lessons(2, 1, 4)
    rewards = np.arange(12.0).reshape(6, 2)
    dones = np.zeros((6, 2), dtype=bool)
    dones[4, 0] = True
    for reward, done in zip(rewards, dones, strict=True):  # the last four are kept, from place 2 on
        kept.add(reward=reward, done=done)
    returns, ended = kept.returns(0.5)
    place = {step: step % 4 for step in range(2, 6)}
    assert sorted(ended) == sorted(2 * place[step] for step in (2, 3, 4))
    assert returns[place[4], 0] == 8.0 and returns[place[3], 0] == 6.0 + 0.5 * 8.0
    assert returns[place[2], 0] == 4.0 + 0.5 * 10.0


def test_a_student_comes_near_its_teacher(monkeypatch):
    """Its accelerations on states of its own, after seconds."""
    monkeypatch.setattr(student, "PASSES", 60)
    model = ppo.build(load_scenario("two_lines"), "true_soil", CONFIG, 0)
    student.teach(model, 20_000, 0)
    assert model.num_timesteps == 20 * student.ROUND * 16
    env = model.get_vec_normalize_env()
    fresh = np.ones(16, bool)
    teachers = Teachers(env.unwrapped)
    seen = env.reset()
    errors = []
    for _ in range(150):
        taught, weight = teachers.lesson(fresh)
        action = model.predict(seen, deterministic=True)[0][:, 0]
        errors.append((action - taught[:, 0])[weight > 0.0])
        seen, _, fresh, _ = env.step(action[:, None])
    assert np.sqrt(np.mean(np.concatenate(errors) ** 2)) < 0.2


def test_a_rover_has_a_student():
    """Its teacher sees what a rover with the true soil observes; the student learns an action for
    each axle.
    """
    rover = load_rover("mars_rover", {"course": {"length": 3.0}, "control": {"time_limit": 20.0}})
    model = ppo.build(rover, "blind", CONFIG, 0)
    env = model.get_env().unwrapped
    plain = SoilRoverVecEnv(16, rover, "true_soil", scaled=False, threads=1)
    for one in (env, plain):
        one.seed(5)
        one.reset()
    for _ in range(20):
        actions = np.full((16, 3), 0.4, dtype=np.float32)
        env.step(actions)
        np.testing.assert_array_equal(env.true_soil(), plain.step(actions)[0])
    actions, weight = Teachers(env).lesson(np.ones(16, dtype=bool))
    assert actions.shape == (16, 3) and weight.max() == 1.0
    student.teach(model, 2 * student.ROUND * 16, 0)
    assert model.predict(model.get_env().reset())[0].shape == (16, 3)


def test_the_same_seed_gives_the_same_student():
    models = [ppo.build(load_scenario("two_lines"), "identified", CONFIG, 0) for _ in range(2)]
    for model in models:
        student.teach(model, 2 * student.ROUND * 16, 0)
    own, other = (model.policy.state_dict() for model in models)
    assert all(torch.equal(x, other[name]) for name, x in own.items())


def test_leaving_the_teacher_costs_the_square_of_the_difference_of_action():
    """Rewards of the same drive, with the penalty and without; courses end on the way, some in
    hidden worlds.
    """
    scenario = load_scenario("two_lines", {"course": {"length": 1.0}})
    rng = np.random.default_rng(0)
    envs = [
        normalised(scenario, "identified", CONFIG, 3, hidden_worlds(scenario, 2, 0))
        for _ in range(2)
    ]
    teachers = Teachers(envs[0].unwrapped)
    fresh = np.ones(16, bool)
    ends = 0
    for env, weight in zip(envs, (0.0, 0.5), strict=True):
        env.reset()
        env.penalise(weight)
    for _ in range(150):
        actions = rng.uniform(-0.2, 0.8, (16, 1)).astype(np.float32)
        taught, counted = teachers.lesson(fresh)
        (_, _, fresh, _), (_, _, again, _) = (env.step(actions) for env in envs)
        paid = envs[0].get_original_reward() - envs[1].get_original_reward()
        np.testing.assert_allclose(paid, 0.5 * counted * (actions - taught)[:, 0] ** 2, atol=1e-5)
        assert (fresh == again).all()
        ends += fresh.sum()
    assert ends > 3


def test_the_penalty_fades_until_half_of_the_training():
    model = ppo.build(load_scenario("two_lines"), "identified", CONFIG, 0)
    env = model.get_vec_normalize_env()
    weights = []
    watch = ConvertCallback(lambda *_: weights.append(env.penalty_weight) or True)
    model.learn(8 * 256, callback=[ppo.Schedules(CONFIG, 0.4), watch])
    assert weights[::16] == pytest.approx([0.4, 0.3, 0.2, 0.1, 0.0, 0.0, 0.0, 0.0])
