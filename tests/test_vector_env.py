"""The vector environment: bit for bit the scalar one, in every autoreset mode and with any number of threads."""

import math
import re

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from soil_env.driving.infos import flat
from soil_env.env import SoilWheelEnv
from soil_env.identification import Status
from soil_env.parameters import ParameterError
from soil_env.simulation.task import REWARD_TERMS, VARIANTS, Cause
from soil_env.vector_env import SoilWheelVectorEnv

WHEELS, STEPS = 5, 260
SHORT = {
    "course": {"length": 2.0},
    "control": {"action": "torque"},
}  # episodes of a few seconds: several ends and resets within STEPS
QUICK = SHORT | {"control": {"action": "torque", "time_limit": 4.5}}


def actions(seed=0, wheels=WHEELS, steps=STEPS):
    """Held random actions [steps, wheels, 1]: full throttle, full reverse and out of range among them."""
    rng = np.random.default_rng(seed)
    held = rng.uniform(0.0, 1.0, (steps // 8 + 1, wheels, 1))
    held[rng.random(held.shape) < 0.15] = 1.0
    held[rng.random(held.shape) < 0.08] = -1.0
    held[rng.random(held.shape) < 0.08] = 1.7
    return np.repeat(held, 8, axis=0)[:steps].astype(np.float32)


def same_info(info, k, scalar):
    assert Cause(info["cause"][k]).name == scalar["cause"]
    assert info["x"][k] == scalar["state"]["x"]
    assert info["immobilised"][k] == scalar["immobilised"]
    assert {name: info[f"reward_{name}"][k] for name in REWARD_TERMS} == scalar["reward_terms"]


def same_groups(info, k, scalar):
    """The parts of a full info: kernels and states to the bit, exponentials to rounding."""
    assert info["immobilised"][k] == scalar["immobilised"]
    for group in ("reward_terms", "state", "traversability"):
        assert {name: row[k] for name, row in info[group].items() if name[0] != "_"} == scalar[group]
    found = {name: row[k] for name, row in info["estimate"].items() if name[0] != "_"}
    assert Status(found.pop("status")).name == scalar["estimate"]["status"]
    assert found == {n: pytest.approx(v, rel=1e-14) for n, v in scalar["estimate"].items() if n != "status"}


# --- equal to the scalar environment ----------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["torque", "wheel_speed", "rim_acceleration"])
@pytest.mark.parametrize("variant", VARIANTS)
def test_next_step_is_the_scalar_env_bit_for_bit(variant, mode):
    changes = {**SHORT, "reward": {"information": 0.0 if mode == "torque" else 2.0}}
    many = SoilWheelVectorEnv(WHEELS, observation=variant, action=mode, **changes)
    one = [SoilWheelEnv(observation=variant, action=mode, **changes) for _ in range(WHEELS)]
    observations, info = many.reset(seed=11)
    for k, env in enumerate(one):
        first, scalar = env.reset(seed=11 + k)
        np.testing.assert_array_equal(observations[k], first)
        same_info(info, k, scalar)
    done, ends = [False] * WHEELS, 0
    for a in actions():
        observations, rewards, terminated, truncated, info = many.step(a)
        for k, env in enumerate(one):
            if done[k]:  # this step resets, whatever the action
                expected = (*env.reset()[:1], 0.0, False, False, env.infos.one(env.simulation.worlds, 0))
            else:
                expected = env.step(a[k])
            np.testing.assert_array_equal(observations[k], expected[0])
            assert (rewards[k], terminated[k], truncated[k]) == expected[1:4]
            same_info(info, k, expected[4])
            done[k] = expected[2] or expected[3]
            ends += done[k]
    assert ends >= 4


@pytest.mark.parametrize("variant", VARIANTS)
def test_two_lines_are_the_scalar_env_bit_for_bit(variant):
    """Camera, choices at halts and the memory of classes too."""
    kinds = {"scenario": "two_lines", "observation": variant, "action": "wheel_speed"}
    many, one = SoilWheelVectorEnv(3, **kinds), [SoilWheelEnv(**kinds) for _ in range(3)]
    observations, _ = many.reset(seed=21)
    for k, env in enumerate(one):
        np.testing.assert_array_equal(observations[k], env.reset(seed=21 + k)[0])
    halted, done = many.observation_names.index("halted"), [False] * 3
    for step in range(450):
        beside = (observations[:, halted] > 0.5) & (step // 40 % 2 == 0)
        a = np.where(beside, -1.0, 0.4)[:, None].astype(np.float32)
        observations, rewards, terminated, truncated, _ = many.step(a)
        for k, env in enumerate(one):
            expected = (*env.reset()[:1], 0.0, False, False) if done[k] else env.step(a[k])
            np.testing.assert_array_equal(observations[k], expected[0])
            assert (rewards[k], terminated[k], truncated[k]) == expected[1:4]
            done[k] = expected[2] or expected[3]
    assert many.simulation.worlds.courses.lines.taken.any()


@pytest.mark.parametrize("variant", VARIANTS)
def test_same_step_resets_within_the_step(variant):
    many = SoilWheelVectorEnv(WHEELS, observation=variant, autoreset_mode="SameStep", **QUICK)
    one = [SoilWheelEnv(observation=variant, **QUICK) for _ in range(WHEELS)]
    many.reset(seed=[3, 1, 4, 1, 5])
    for env, seed in zip(one, (3, 1, 4, 1, 5), strict=True):
        env.reset(seed=seed)
    ends = 0
    for a in actions(1, steps=160):
        observations, rewards, terminated, truncated, info = many.step(a)
        ended = terminated | truncated
        assert ("final_obs" in info) == ended.any()
        for k, env in enumerate(one):
            last, reward, scalar_terminated, scalar_truncated, scalar = env.step(a[k])
            assert (rewards[k], terminated[k], truncated[k]) == (reward, scalar_terminated, scalar_truncated)
            if ended[k]:
                assert info["_final_obs"][k] and info["_final_info"][k]
                np.testing.assert_array_equal(info["final_obs"][k], last)
                same_info(info["final_info"], k, scalar)
                same_groups(info["final_info"], k, scalar)
                first, scalar = env.reset()
                np.testing.assert_array_equal(observations[k], first)
                ends += 1
            else:
                np.testing.assert_array_equal(observations[k], last)
                if ended.any():
                    final = info["final_info"]
                    assert info["final_obs"][k] is None and not info["_final_obs"][k] and not final["_x"][k]
                    assert final["x"][k] == final["state"]["x"][k] == final["estimate"]["cohesion"][k] == 0.0
            same_info(info, k, scalar)  # after the reset, as the observation
    assert ends >= 10


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_a_full_info_is_the_scalar_one(mode):
    many = SoilWheelVectorEnv(WHEELS, info="full", autoreset_mode=mode, **QUICK)
    one = [SoilWheelEnv(**QUICK) for _ in range(WHEELS)]
    _, info = many.reset(seed=2)
    scalars = [env.reset(seed=2 + k)[1] for k, env in enumerate(one)]
    done = np.zeros(WHEELS, dtype=bool)
    for a in actions(4, steps=100):
        for k in range(WHEELS):
            assert Cause(info["cause"][k]).name == scalars[k]["cause"]
            same_groups(info, k, scalars[k])
        if mode == AutoresetMode.DISABLED and done.any():
            _, info = many.reset(options={"reset_mask": done})
            scalars = [env.reset()[1] if d else s for env, d, s in zip(one, done, scalars, strict=True)]
            done[:] = False
            continue
        _, _, terminated, truncated, info = many.step(a)
        resets, done = done, terminated | truncated
        scalars = [env.reset()[1] if d else env.step(u)[4] for env, d, u in zip(one, resets, a, strict=True)]
        if mode == AutoresetMode.SAME_STEP:
            scalars = [env.reset()[1] if d else s for env, d, s in zip(one, done, scalars, strict=True)]
            done = np.zeros(WHEELS, dtype=bool)


@pytest.mark.parametrize("kind", ["numeric", "short"])
def test_flat_infos_are_the_same_numbers(kind):
    """In one wheel, in many and in gymnasium's own vector of single wheels."""
    full, one = SoilWheelEnv(**SHORT), SoilWheelEnv(info=kind, **SHORT)
    many = SoilWheelVectorEnv(2, info=kind, **SHORT)
    sync = gymnasium.make_vec("SoilWheel-v0", num_envs=2, vectorization_mode="sync", info=kind, **SHORT)
    infos = [env.reset(seed=8)[1] for env in (full, one, many, sync)]
    for a in actions(5, 2, 40):
        nested, numbers, arrays, synced = infos
        expected = flat(nested)
        names = (
            set(expected)
            if kind == "numeric"
            else {"cause", "immobilised", "x", *map("reward_{}".format, REWARD_TERMS)}
        )
        assert set(numbers) == names == set(arrays) == {name for name in synced if name[0] != "_"}
        for name, value in numbers.items():
            assert isinstance(value, np.number) and value == expected[name]  # numpy's: TorchRL asks for a dtype
            assert arrays[name][0] == pytest.approx(value, rel=1e-14) and synced[name][0] == value
        *_, infos[0] = full.step(a[0])
        *_, infos[1] = one.step(a[0])
        *_, infos[2] = many.step(a)
        *_, infos[3] = sync.step(a)


def test_no_info():
    many = SoilWheelVectorEnv(3, info="none", autoreset_mode="SameStep", max_episode_steps=2)
    one = SoilWheelEnv(info="none")
    assert one.reset(seed=0)[1] == one.step([0.2])[4] == many.reset(seed=0)[1] == many.step(np.zeros((3, 1)))[4] == {}
    assert set(many.step(np.zeros((3, 1)))[4]) == {"final_obs", "_final_obs"}
    for cls in (SoilWheelEnv, SoilWheelVectorEnv):
        with pytest.raises(
            ParameterError, match="info = 'nothing': expected one of 'full', 'numeric', 'short', 'none'"
        ):
            cls(info="nothing")


def test_disabled_waits_for_a_reset_of_the_ended():
    many = SoilWheelVectorEnv(WHEELS, autoreset_mode=AutoresetMode.DISABLED, **SHORT)
    one = [SoilWheelEnv(**SHORT) for _ in range(WHEELS)]
    many.reset(seed=0)
    for k, env in enumerate(one):
        env.reset(seed=k)
    resets = 0
    for a in actions(2, steps=200):
        observations, _, terminated, truncated, _ = many.step(a)
        expected = [env.step(a[k]) for k, env in enumerate(one)]
        np.testing.assert_array_equal(observations, [e[0] for e in expected])
        ended = terminated | truncated
        np.testing.assert_array_equal(ended, [e[2] or e[3] for e in expected])
        if ended.any():
            with pytest.raises(gymnasium.error.ResetNeeded, match="reset_mask"):
                many.step(a)
            observations, _ = many.reset(options={"reset_mask": ended})
            for k in range(WHEELS):
                np.testing.assert_array_equal(observations[k], one[k].reset()[0] if ended[k] else expected[k][0])
            resets += 1
    assert resets >= 3


def test_a_seed_for_some_wheels_only():
    many = SoilWheelVectorEnv(3, autoreset_mode="Disabled")
    first, _ = many.reset(seed=[5, None, 7])
    np.testing.assert_array_equal(first[0], SoilWheelEnv().reset(seed=5)[0])
    np.testing.assert_array_equal(first[2], SoilWheelEnv().reset(seed=7)[0])
    for _ in range(3):
        before = many.step(np.full((3, 1), 0.4))[0]
    after, _ = many.reset(seed=[9, 9, 9], options={"reset_mask": np.array([False, True, False])})
    np.testing.assert_array_equal(after[1], SoilWheelEnv().reset(seed=9)[0])
    np.testing.assert_array_equal(after[[0, 2]], before[[0, 2]])


def test_seeds_single_and_listed():
    env = SoilWheelVectorEnv(4)
    single, _ = env.reset(seed=20)
    listed, _ = SoilWheelVectorEnv(4).reset(seed=[20, 21, 22, 23])
    np.testing.assert_array_equal(single, listed)
    np.testing.assert_array_equal(env.reset(seed=20)[0], single)
    assert not np.array_equal(env.reset()[0], single)
    assert len({tuple(row) for row in single}) == 4
    fresh = SoilWheelVectorEnv(2), SoilWheelVectorEnv(2)
    assert not np.array_equal(fresh[0].reset()[0], fresh[1].reset()[0])


# --- threads, arrays, limits ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
def test_the_number_of_threads_changes_nothing(mode):
    runs = []
    for threads in (1, 2, 3):
        env = SoilWheelVectorEnv(64, threads=threads, autoreset_mode=mode, **SHORT)
        rows = [env.reset(seed=0)[0]]
        for a in actions(3, 64, 80):
            observations, rewards, terminated, truncated, _ = env.step(a)
            rows.append(np.column_stack([observations, rewards, terminated, truncated]))
        runs.append(rows)
    assert np.sum([row[:, -2] for row in runs[0][1:]]) > 3
    for other in runs[1:]:
        for a, b in zip(runs[0], other, strict=True):
            np.testing.assert_array_equal(a, b)


def leaves(x):
    """All arrays in what reset or step returned."""
    if isinstance(x, (dict, tuple)):
        return [leaf for y in (x.values() if isinstance(x, dict) else x) for leaf in leaves(y)]
    if isinstance(x, np.ndarray) and x.dtype == object:
        return [y for y in x if y is not None]
    return [x]


def test_returned_arrays_are_not_overwritten():
    env = SoilWheelVectorEnv(20, autoreset_mode="SameStep", max_episode_steps=3)
    for k in range(6):
        outputs = env.step(np.full((20, 1), 0.1 * k)) if k else env.reset(seed=0)
        arrays = leaves(outputs)
        kept = [np.copy(a) for a in arrays]
        env.step(np.full((20, 1), 0.7))
        for a, b in zip(arrays, kept, strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("repeat", [1, 3])
@pytest.mark.parametrize("autoreset", ["NextStep", "SameStep"])
def test_max_episode_steps_truncates_and_the_time_limit_terminates(autoreset, repeat):
    for limits, cause in (({"max_episode_steps": 20}, Cause.RUNNING),
                          ({"control": {"time_limit": 2.0 * repeat}}, Cause.TIME_LIMIT)):  # fmt: skip
        env = SoilWheelVectorEnv(3, repeat=repeat, autoreset_mode=autoreset, **limits)
        env.reset(seed=0)
        for k in range(1, 45):
            _, _, terminated, truncated, info = env.step(np.full((3, 1), 0.3))
            over, other = (terminated, truncated) if cause == Cause.TIME_LIMIT else (truncated, terminated)
            assert not other.any()
            episode = 20 if autoreset == "SameStep" else 21
            assert np.all(over == (k % episode == 20 % episode))
            if over.all():
                last = info.get("final_info", info)
                assert np.all(last["cause"] == cause)
                assert np.all(last["reward_immobilisation"] == (-10.0 if cause == Cause.TIME_LIMIT else 0.0))


# --- registration and spaces ------------------------------------------------------------------------------------------


def test_make_vec():
    env = gymnasium.make_vec("soil_env:SoilWheel-v0", num_envs=3, vectorization_mode="vector_entry_point")
    assert isinstance(env.unwrapped, SoilWheelVectorEnv) and env.num_envs == 3
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    observations, _ = env.reset(seed=0)
    assert observations.shape == env.observation_space.shape == (3, 66) and observations.dtype == np.float32
    assert env.observation_space.contains(observations)
    observations, rewards, terminated, truncated, _ = env.step(env.action_space.sample())
    assert rewards.shape == terminated.shape == truncated.shape == (3,)
    assert terminated.dtype == truncated.dtype == np.bool_ and rewards.dtype == np.float64
    env.close()


# --- errors -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("arguments", "words"), [
    ({"num_envs": 0}, "num_envs = 0: expected a whole number >= 1"),
    ({"max_episode_steps": 0}, "max_episode_steps = 0"),
    ({"autoreset_mode": "Sometimes"}, "autoreset_mode = 'Sometimes': expected one of 'NextStep'"),
    ({"render_mode": "rgb_array"}, "render_mode"),
    ({"thread": 1}, "unexpected keyword argument 'thread'; did you mean 'threads'?"),
    ({"threads": -1}, "threads"),
])  # fmt: skip
def test_bad_arguments_are_named(arguments, words):
    with pytest.raises(ParameterError) as raised:
        SoilWheelVectorEnv(**arguments)
    assert words in str(raised.value) and "\n" not in str(raised.value)


@pytest.mark.parametrize(("bad", "words"), [
    (np.zeros((3, 1)), r"shape \(2, 1\), got \(3, 1\)"),
    ("x", r"actions = 'x': expected numbers in \[-1, 1\], shape \(2, 1\)"),
    (np.array([[0.0], [np.nan]]), r"actions\[1\] = \[nan\]: expected finite"),
])  # fmt: skip
def test_bad_actions_are_named_and_change_nothing(bad, words):
    env, untouched = SoilWheelVectorEnv(2), SoilWheelVectorEnv(2)
    for e in (env, untouched):
        e.reset(seed=0)
    with pytest.raises(ValueError, match=words):
        env.step(bad)
    a = np.full((2, 1), 0.4)
    np.testing.assert_array_equal(env.step(a)[0], untouched.step(a)[0])


def test_bad_resets_are_named():
    env = SoilWheelVectorEnv(3)
    with pytest.raises(gymnasium.error.ResetNeeded):
        env.step(np.zeros((3, 1)))
    with pytest.raises(ValueError, match="expected 3 seeds, got 2"):
        env.reset(seed=[1, 2])
    for seed in (1.5, "a", [0, 1]):
        with pytest.raises(ValueError, match=r"^seed"):
            env.reset(seed=seed)
    for seed, named in (
        (True, "seed = True"), (-1, "seed = -1"), ([0, 1.5, 2], "seed[1] = 1.5"), (["1", 2, 3], "seed[0] = '1'"),
        ([0, 1, False], "seed[2] = False"), ([0, -1, 2], "seed[1] = -1"), (np.array([0.0, 1.0, 2.0]), "seed[0] = "),
    ):  # fmt: skip
        with pytest.raises(ParameterError, match=rf"^{re.escape(named)}.*: expected a whole number >= 0"):
            env.reset(seed=seed)
    for options in ([1], "mask", {"reset_mask": [0, 1, 2]}, {"reset_mask": [math.nan] * 3}):
        with pytest.raises(ValueError, match=r"^reset"):
            env.reset(options=options)
    with pytest.raises(ValueError, match=r"reset_mask: expected shape \(3,\) of bool, got \(2,\)"):
        env.reset(options={"reset_mask": np.ones(2, dtype=bool)})
    with pytest.raises(ValueError, match="options.*'x'"):
        env.reset(options={"x": 1})


@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_stepping_wheels_that_were_never_reset_is_refused(mode):
    """A first reset with a mask leaves the others without a course."""
    env = SoilWheelVectorEnv(2, autoreset_mode=mode)
    try:
        env.reset(seed=0, options={"reset_mask": np.array([True, False])})
        observations = env.step(np.full((2, 1), 0.3))[0]
    except (gymnasium.error.ResetNeeded, ValueError):
        return
    assert np.all(np.isfinite(observations))
    assert env.simulation.worlds.courses.patches[1] > 0  # or it was reset by the step


def test_completing_courses_changes_no_trajectory():
    """One env draws patches as its wheels come to them, the other all at once, and some on the way."""
    changes = {"course": {"length": 60.0, "margin": [0.2, 0.25], "grade_deg": [-6.0, 2.0]}}
    lazy, whole = (SoilWheelVectorEnv(6, observation="true_soil", **changes) for _ in range(2))
    for env in (lazy, whole):
        env.reset(seed=11)
    for k in range(3):
        whole.simulation.complete(k)
    started = lazy.simulation.worlds.courses.patches.copy()
    rng = np.random.default_rng(0)
    for step in range(120):
        if step == 40:
            whole.simulation.complete(4)
        actions = rng.uniform(0.2, 0.7, (6, 1))
        for a, b in zip(lazy.step(actions)[:4], whole.step(actions)[:4], strict=True):
            np.testing.assert_array_equal(a, b)
    drawn, all_drawn = (env.simulation.worlds.courses.patches for env in (lazy, whole))
    assert np.any(drawn > started) and np.all(drawn[:3] < all_drawn[:3])
    for k in range(6):
        lazy.simulation.complete(k)
        whole.simulation.complete(k)
    for name in ("edges", "soils", "grades", "margins", "patches", "rut_factors", "rut"):
        np.testing.assert_array_equal(*(getattr(env.simulation.worlds.courses, name) for env in (lazy, whole)), name)
