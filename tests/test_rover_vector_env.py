"""The rover's vector environment: bit for bit the scalar one, in every autoreset mode, with any number of threads."""

import copy
import pickle

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from soil_env.identification import Status
from soil_env.parameters import ParameterError
from soil_env.rover_env import SoilRoverEnv
from soil_env.rover_vector_env import SoilRoverVectorEnv
from soil_env.simulation.task import REWARD_TERMS, VARIANTS, Cause
from soil_env.vehicle import load_rover, rover_names
from tests.test_checkers import check_vector

ROVERS = 11  # a block of eight and a part of one
ACTIONS = ("torque", "wheel_speed", "rim_acceleration")
QUICK = {"course": {"length": 1.0}, "control": {"time_limit": 5.0}}


def actions(steps, axles, rovers=ROVERS, seed=0):
    """Held random actions [steps, rovers, axles]: full throttle, full reverse and out of range among them."""
    rng = np.random.default_rng(seed)
    wild = rng.uniform(0.1, 1.0, (steps // 6 + 1, rovers, axles))
    wild[rng.random(wild.shape) < 0.15] = 1.7
    wild[rng.random(wild.shape) < 0.08] = -1.0
    return np.repeat(wild, 6, axis=0)[:steps].astype(np.float32)


def same(info, k, scalar):
    assert Cause(info["cause"][k]).name == scalar["cause"] and info["immobilised"][k] == scalar["immobilised"]
    assert info["x"][k] == scalar["state"]["x"]
    assert {name: info[f"reward_{name}"][k] for name in REWARD_TERMS} == scalar["reward_terms"]


def same_groups(info, k, scalar):
    """The parts of a full info: states to the bit, exponentials of estimates to rounding."""
    assert Cause(info["cause"][k]).name == scalar["cause"] and info["immobilised"][k] == scalar["immobilised"]
    assert {key for key in info if not key.startswith(("_", "final_"))} == set(scalar)
    for group in ("reward_terms", "state"):
        assert {name: row[k] for name, row in info[group].items() if name[0] != "_"} == scalar[group]
    for axle in set(scalar) & {"front", "middle", "rear"}:
        found = {group: {n: r[k] for n, r in rows.items() if n[0] != "_"} for group, rows in info[axle].items()
                 if group[0] != "_"}  # fmt: skip
        assert found["state"] == scalar[axle]["state"]
        assert Status(found["estimate"].pop("status")).name == scalar[axle]["estimate"]["status"]
        expected = {n: pytest.approx(v, rel=1e-14) for n, v in scalar[axle]["estimate"].items() if n != "status"}
        assert found["estimate"] == expected


# --- equal to the scalar environment ----------------------------------------------------------------------------------


@pytest.mark.parametrize("action", ACTIONS)
@pytest.mark.parametrize("rover", rover_names())
def test_each_is_the_scalar_env_bit_for_bit(rover, action):
    """Through ends and restarts, with the information of the reward on."""
    variant = VARIANTS[(rover_names().index(rover) + ACTIONS.index(action)) % 3]
    changes = {**QUICK, "observation": variant, "action": action, "reward": {"information": 2.0}}
    many = SoilRoverVectorEnv(ROVERS, rover, threads=2, **changes)
    one = [SoilRoverEnv(rover, **changes) for _ in range(ROVERS)]
    observations, info = many.reset(seed=11)
    for k, env in enumerate(one):
        first, scalar = env.reset(seed=11 + k)
        np.testing.assert_array_equal(observations[k], first)
        same(info, k, scalar)
    done, ends = [False] * ROVERS, 0
    for a in actions(70 if action != "rim_acceleration" else 25, many.scenario.axles):
        observations, rewards, terminated, truncated, info = many.step(a)
        for k, env in enumerate(one):
            if done[k]:  # this step resets, whatever the action
                expected = (*env.reset()[:1], 0.0, False, False, env.infos.one(0))
            else:
                expected = env.step(a[k])
            np.testing.assert_array_equal(observations[k], expected[0])
            assert (rewards[k], terminated[k], truncated[k]) == expected[1:4]
            same(info, k, expected[4])
            done[k] = expected[2]
            ends += done[k]
    assert ends >= ROVERS


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_a_full_info_is_the_scalar_one_in_every_autoreset_mode(mode):
    changes = {"rover": "mars_rover", "action": "wheel_speed", "course": {"length": 1.0, "grade_deg": [-8.0, 0.0]}}
    many = SoilRoverVectorEnv(3, info="full", autoreset_mode=mode, **changes)
    one = [SoilRoverEnv(**changes) for _ in range(3)]
    observations, info = many.reset(seed=2)
    last = [env.reset(seed=2 + k) for k, env in enumerate(one)]
    done, ends, apart = np.zeros(3, dtype=bool), 0, 0
    for a in np.clip(actions(220, 3, 3, seed=4), 0.3, 1.7):
        for k in range(3):
            np.testing.assert_array_equal(observations[k], last[k][0])
            same_groups(info, k, last[k][-1])
        if mode == AutoresetMode.DISABLED and done.any():
            with pytest.raises(gymnasium.error.ResetNeeded, match="reset_mask"):
                many.step(a)
            observations, info = many.reset(options={"reset_mask": done})
            last = [env.reset() if d else x for env, d, x in zip(one, done, last, strict=True)]
            done = np.zeros(3, dtype=bool)
            continue
        observations, _, terminated, _, info = many.step(a)
        last = [env.reset() if d else env.step(u) for env, d, u in zip(one, done, a, strict=True)]
        done = terminated
        if mode == AutoresetMode.SAME_STEP:
            for k in np.flatnonzero(done):
                np.testing.assert_array_equal(info["final_obs"][k], last[k][0])
                same_groups(info["final_info"], k, last[k][-1])
            if done.any():
                np.testing.assert_array_equal(info["_final_obs"], done)
                assert all(np.all(info["final_info"]["state"]["x"][k] == 0.0) for k in np.flatnonzero(~done))
            last = [env.reset() if d else x for env, d, x in zip(one, done, last, strict=True)]
        ends, apart = ends + done.sum(), apart + (0 < done.sum() < 3)
        if mode == AutoresetMode.SAME_STEP:
            done = np.zeros(3, dtype=bool)
    assert ends >= 3 and apart >= 2


@pytest.mark.parametrize("kind", ["numeric", "short", "none"])
def test_flat_infos_are_the_same_numbers(kind):
    """In one rover, in many and in gymnasium's own vector of single rovers."""
    one, many = SoilRoverEnv(info=kind), SoilRoverVectorEnv(2, info=kind)
    sync = gymnasium.make_vec("SoilRover-v0", num_envs=2, vectorization_mode="sync", info=kind)
    infos = [env.reset(seed=8)[1] for env in (one, many, sync)]
    for a in actions(15, 2, 2):
        numbers, arrays, synced = infos
        assert set(numbers) == set(arrays) == {name for name in synced if name[0] != "_"}
        for name, value in numbers.items():
            assert isinstance(value, np.number)
            assert arrays[name][0] == pytest.approx(value, rel=1e-14) and synced[name][0] == value
        infos = [one.step(a[0])[4], many.step(a)[4], sync.step(a)[4]]
    if kind == "numeric":
        assert {"cause", "x", "pitch", "reward_energy", "front_load", "rear_estimate_status"} <= set(infos[0])
        assert not any(name.startswith("middle") for name in infos[0])
    assert (infos[0] == {}) == (kind == "none")


@pytest.mark.parametrize("rover", rover_names())
def test_the_number_of_threads_changes_nothing(rover):
    runs = []
    for threads in (1, 2):
        env = SoilRoverVectorEnv(41, rover, threads=threads, autoreset_mode="SameStep", **QUICK)
        rows = [env.reset(seed=0)[0]]
        for a in actions(14, env.scenario.axles, 41):
            observations, rewards, terminated, _, _ = env.step(a)
            rows.append(np.column_stack([observations, rewards, terminated]))
        runs.append(rows)
    for a, b in zip(*runs, strict=True):
        np.testing.assert_array_equal(a, b)
    assert sum(row[:, -1].sum() for row in runs[0][1:]) > 3


# --- contract ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("rover", rover_names())
@pytest.mark.parametrize("variant", VARIANTS)
def test_contract_of_a_vector_env(rover, variant):
    check_vector(SoilRoverVectorEnv(3, rover, variant, **QUICK))
    if variant == "blind":
        kinds = {"num_envs": 2, "vectorization_mode": "sync", "rover": rover}
        check_vector(gymnasium.make_vec("soil_env:SoilRover-v0", **kinds), 5)


def test_seeds_single_and_listed_and_for_some():
    env = SoilRoverVectorEnv(4, autoreset_mode="Disabled")
    single, _ = env.reset(seed=20)
    np.testing.assert_array_equal(single, SoilRoverVectorEnv(4).reset(seed=[20, 21, 22, 23])[0])
    assert len({tuple(row) for row in single}) == 4 and not np.array_equal(env.reset()[0], single)
    before = env.step(np.full((4, 2), 0.4))[0]
    after, _ = env.reset(seed=[9] * 4, options={"reset_mask": np.array([False, True, False, False])})
    np.testing.assert_array_equal(after[1], SoilRoverEnv().reset(seed=9)[0])
    np.testing.assert_array_equal(after[[0, 2, 3]], before[[0, 2, 3]])


@pytest.mark.parametrize("make", [copy.deepcopy, lambda e: pickle.loads(pickle.dumps(e))], ids=["deepcopy", "pickle"])
def test_a_copy_goes_on_as_the_original(make):
    env = SoilRoverVectorEnv(9, threads=2, info="full", **QUICK)
    env.reset(seed=3)
    env.step(np.full((9, 2), 0.45))
    other = make(env)
    for a in actions(20, 2, 9):
        (x, *_, told), (y, *_, told_by_copy) = env.step(a), other.step(a)
        np.testing.assert_array_equal(x, y)
        np.testing.assert_array_equal(told["rear"]["state"]["load"], told_by_copy["rear"]["state"]["load"])


def test_max_episode_steps_truncates():
    env = SoilRoverVectorEnv(2, max_episode_steps=4, autoreset_mode="SameStep")
    env.reset(seed=0)
    for k in range(1, 9):
        _, _, terminated, truncated, info = env.step(np.full((2, 2), 0.3))
        assert not terminated.any() and np.all(truncated == (k % 4 == 0))
        if k % 4 == 0:
            assert np.all(info["final_info"]["cause"] == Cause.RUNNING)


@pytest.mark.parametrize(("bad", "words"), [
    (np.zeros((2, 1)), r"shape \(2, 2\), got \(2, 1\)"),
    (np.zeros(2), r"shape \(2, 2\), got \(2,\)"),
    (np.array([[0.0, 0.0], [np.nan, 0.0]]), r"actions\[1\] = \[nan, 0.0\]: expected finite"),
])  # fmt: skip
def test_bad_actions_are_named_and_change_nothing(bad, words):
    env, untouched = SoilRoverVectorEnv(2), SoilRoverVectorEnv(2)
    for e in (env, untouched):
        e.reset(seed=0)
    with pytest.raises(ValueError, match=words):
        env.step(bad)
    a = np.full((2, 2), 0.4)
    np.testing.assert_array_equal(env.step(a)[0], untouched.step(a)[0])


def test_completing_courses_changes_no_trajectory():
    """One env draws patches as its rovers come to them, the other all at once."""
    changes = {"course": {"length": 40.0}, "observation": "true_soil"}
    lazy, whole = (SoilRoverVectorEnv(5, **changes) for _ in range(2))
    for env in (lazy, whole):
        env.reset(seed=3)
    for k in range(4):
        whole.simulation.complete(k)
    assert np.all(lazy.simulation.worlds.courses.patches[:4] < whole.simulation.worlds.courses.patches[:4])
    for a in actions(40, 2, 5):
        for x, y in zip(lazy.step(a)[:4], whole.step(a)[:4], strict=True):
            np.testing.assert_array_equal(x, y)
    for k in range(5):
        lazy.simulation.complete(k)
        whole.simulation.complete(k)
    for name in ("edges", "soils", "grades", "patches"):
        np.testing.assert_array_equal(*(getattr(e.simulation.worlds.courses, name) for e in (lazy, whole)), name)


def test_arguments_of_a_vector_env():
    scenario = load_rover("field_rover", {"course": {"length": 4.0}})
    assert SoilRoverVectorEnv(2, scenario).scenario == scenario
    with pytest.raises(ParameterError, match="num_envs = 0"):
        SoilRoverVectorEnv(0)
    with pytest.raises(ParameterError, match="autoreset_mode = 'Sometimes'"):
        SoilRoverVectorEnv(autoreset_mode="Sometimes")
