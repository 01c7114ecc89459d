"""Vector environments of wheels and of rovers: bit for bit the single ones, in every autoreset
mode.
"""

from typing import Any, NamedTuple

import gymnasium
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from soil_env.envs.infos import flat
from soil_env.envs.rover_env import SoilRoverEnv, SoilRoverVectorEnv
from soil_env.envs.wheel_env import SoilWheelEnv, SoilWheelVectorEnv
from soil_env.identification import Status
from soil_env.parameters import rover_names
from soil_env.simulation.task import REWARD_TERMS, VARIANTS, Cause
from soil_env.terramechanics.model import WheelSoilModel

MODES = ("torque", "wheel_speed", "rim_acceleration")
VEHICLES = 5


class Kind(NamedTuple):
    """Single and vector environment of one vehicle, and changes for episodes of a few seconds."""

    one: type
    many: type
    name: str
    motors: int
    quick: dict[str, Any]


WHEEL = Kind(
    SoilWheelEnv,
    SoilWheelVectorEnv,
    "SoilWheel-v0",
    1,
    {"course": {"length": 2.0}, "control": {"action": "torque", "time_limit": 4.5}},
)
ROVER = Kind(
    SoilRoverEnv,
    SoilRoverVectorEnv,
    "SoilRover-v0",
    2,
    {"course": {"length": 1.0}, "control": {"time_limit": 5.0}},
)
WORLD = WheelSoilModel.from_content(
    {
        "wheel": {"radius": 0.15, "width": 0.15, "grouser_height": 0.012},
        "effects": {
            "grousers": {"shear_share": 0.5, "blades": 2.0},
            "multipass": {"hardening": 0.3},
        },
        "residual": [{"channel": "drawbar_pull", "coefficient": -0.05, "powers": {"slip": 1}}],
    }
)
TWO_LINES = {"scenario": "two_lines", "action": "wheel_speed", "course": {}, "control": {}}
KINDS = pytest.mark.parametrize("kind", [WHEEL, ROVER], ids=["wheel", "rover"])


def actions(steps, vehicles, motors=1, seed=0):
    """Held random actions [steps, vehicles, motors]: full throttle, full reverse and out of range
    among them.
    """
    rng = np.random.default_rng(seed)
    held = rng.uniform(0.0, 1.0, (steps // 7 + 1, vehicles, motors))
    held[rng.random(held.shape) < 0.15] = 1.7
    held[rng.random(held.shape) < 0.08] = -1.0
    return np.repeat(held, 7, axis=0)[:steps].astype(np.float32)


def same_info(info, k, scalar):
    """Assert that vehicle k of a short info has the numbers of the `scalar` info of a single
    environment.
    """
    assert (
        Cause(info["cause"][k]).name == scalar["cause"]
        and info["immobilised"][k] == scalar["immobilised"]
    )
    assert info["x"][k] == scalar["state"]["x"]
    assert {name: info[f"reward_{name}"][k] for name in REWARD_TERMS} == scalar["reward_terms"]


def same_nested(info, k, scalar):
    """Assert that vehicle k of a full info has the numbers of the `scalar` info of a single
    environment: states to the bit, exponentials of estimates to rounding.
    """
    for name, value in scalar.items():
        found = info[name] if isinstance(value, dict) else info[name][k]
        if isinstance(value, dict):
            same_nested(found, k, value)
        elif name in ("cause", "status"):
            assert (Cause if name == "cause" else Status)(found).name == value
        else:
            assert found == (pytest.approx(value, rel=1e-14) if "status" in scalar else value), name


@pytest.mark.parametrize(
    ("kind", "variant", "changes"),
    [
        (WHEEL, variant, {"action": mode, "reward": {"information": 2.0 * i}, "scenario": "mixed"})
        for i, (variant, mode) in enumerate(zip(VARIANTS, MODES, strict=True))
    ]
    + [
        (WHEEL, "identified", {"action": "torque"}),
        (WHEEL, "true_soil", {"scenario": "mixed", "model": WORLD}),
    ]
    + [(WHEEL, variant, TWO_LINES) for variant in VARIANTS]
    + [
        (ROVER, variant, {"rover": rover, "action": mode, "reward": {"information": 2.0}})
        for rover, variant, mode in zip(rover_names(), VARIANTS, MODES, strict=True)
    ],
)
def test_next_step_is_the_single_env_bit_for_bit(kind, variant, changes):
    """Through ends and restarts; with two lines through the camera, choices at halts and the memory
    of classes.
    """
    lines = changes is TWO_LINES
    changes = {**kind.quick, "control": {"time_limit": 5.0}, "observation": variant, **changes}
    count, steps = (3, 450) if lines else (VEHICLES, 70)
    many = kind.many(count, threads=2, **changes)
    one = [kind.one(**changes) for _ in range(count)]
    observations, info = many.reset(seed=11)
    for k, env in enumerate(one):
        first, scalar = env.reset(seed=11 + k)
        np.testing.assert_array_equal(observations[k], first)
        same_info(info, k, scalar)
    done = [False] * count
    ends = 0
    for a in actions(steps, count, many.single_action_space.shape[0]):
        if lines:  # turns to the second line at halts, and drives slowly on
            halted = observations[:, [many.observation_names.index("halted")]] > 0.5
            a = np.where(halted & (a < 0.5), -1.0, 0.4).astype(np.float32)
        observations, rewards, terminated, truncated, info = many.step(a)
        for k, env in enumerate(one):  # after an end the step resets, whatever the action
            expected = (
                (*env.reset()[:1], 0.0, False, False, env.infos.one(0))
                if done[k]
                else env.step(a[k])
            )
            np.testing.assert_array_equal(observations[k], expected[0])
            assert (rewards[k], terminated[k], truncated[k]) == expected[1:4]
            same_info(info, k, expected[4])
            done[k] = expected[2]
            ends += done[k]
    assert many.simulation.worlds.courses["forks"]["taken"].any() if lines else ends >= VEHICLES


@pytest.mark.parametrize("mode", list(AutoresetMode))
@KINDS
def test_a_full_info_is_the_single_one_in_every_autoreset_mode(kind, mode):
    changes = {"action": "wheel_speed", "course": {"length": 1.0, "grade_deg": [-8.0, 0.0]}}
    many = kind.many(3, info="full", autoreset_mode=mode, **changes)
    one = [kind.one(**changes) for _ in range(3)]
    observations, info = many.reset(seed=2)
    last = [env.reset(seed=2 + k) for k, env in enumerate(one)]
    done = np.zeros(3, dtype=bool)
    ends = 0
    apart = 0
    for a in np.clip(actions(220, 3, kind.motors, 4), 0.3, 1.7):
        for k in range(3):
            np.testing.assert_array_equal(observations[k], last[k][0])
            same_nested(info, k, last[k][-1])
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
        assert ("final_obs" in info) == (mode == AutoresetMode.SAME_STEP and bool(done.any()))
        if mode == AutoresetMode.SAME_STEP and done.any():
            for k in np.flatnonzero(done):
                np.testing.assert_array_equal(info["final_obs"][k], last[k][0])
                same_nested(info["final_info"], k, last[k][-1])
            np.testing.assert_array_equal(info["_final_obs"], done)
            for k in np.flatnonzero(~done):
                assert info["final_obs"][k] is None and not info["final_info"]["_cause"][k]
                assert info["final_info"]["state"]["x"][k] == 0.0
            last = [env.reset() if d else x for env, d, x in zip(one, done, last, strict=True)]
        ends = ends + done.sum()
        apart = apart + (0 < done.sum() < 3)
        if mode == AutoresetMode.SAME_STEP:
            done = np.zeros(3, dtype=bool)
    assert ends >= 3 and apart >= 1


@pytest.mark.parametrize("info", ["numeric", "short", "none"])
@KINDS
def test_flat_infos_are_the_same_numbers(kind, info):
    """In one vehicle, in many and in gymnasium's own vector of single ones."""
    full = kind.one()
    one = kind.one(info=info)
    many = kind.many(2, info=info)
    sync = gymnasium.make_vec(kind.name, num_envs=2, vectorization_mode="sync", info=info)
    infos = [env.reset(seed=8)[1] for env in (full, one, many, sync)]
    for a in actions(15, 2, kind.motors, 5):
        nested, numbers, arrays, synced = infos
        assert set(numbers) == set(arrays) == {name for name in synced if name[0] != "_"}
        expected = flat(nested) if kind is WHEEL else numbers
        for name, value in numbers.items():
            # Numpy's: TorchRL asks for a dtype.
            assert isinstance(value, np.number) and value == expected[name]
            assert synced[name].dtype == value.dtype
            mask = name.endswith(("immobilised", "passable"))  # of many, to index with
            assert arrays[name].dtype == (np.bool_ if mask else value.dtype)
            assert arrays[name][0] == pytest.approx(value, rel=1e-14) and synced[name][0] == value
        infos = [full.step(a[0])[4], one.step(a[0])[4], many.step(a)[4], sync.step(a)[4]]
    some = {
        "cause",
        "x",
        "reward_energy",
        "torque_available" if kind is WHEEL else "rear_estimate_status",
    }
    assert info != "numeric" or some <= set(infos[1])
    assert (infos[1] == {}) == (info == "none")


@KINDS
def test_nothing_is_identified_unless_something_asks(kind):
    """Observation, info or reward; without, the environment drives the same and its infos have no
    estimate.
    """
    for asked in (
        {"observation": "identified"},
        {"info": "full"},
        {"reward": {"information": 1.0}},
    ):
        changes = {"observation": "blind"} | asked
        for env in (kind.one(**changes), kind.many(2, **changes)):
            assert env.simulation.belief is not None
    blind = kind.one(observation="blind")
    full = kind.one(observation="blind", info="full")
    many = kind.many(2, observation="blind", autoreset_mode="SameStep", max_episode_steps=2)
    assert blind.simulation.belief is many.simulation.belief is None
    assert {"state", "reward_terms"} <= set(blind.reset(seed=0)[1]) <= set(full.reset(seed=0)[1])
    assert "estimate" not in repr(blind.infos.one(0)) and "estimate" in repr(full.infos.one(0))
    many.reset(seed=0)
    for _ in range(2):
        a = np.full(kind.motors, 0.4)
        np.testing.assert_array_equal(blind.step(a)[0], full.step(a)[0])
        final = many.step(np.tile(a, (2, 1)))[4]
    assert "estimate" not in final["final_info"] and final["final_info"]["x"][0] > 0.0


@KINDS
def test_seeds_single_and_listed_and_for_some(kind):
    """A seed s gives vehicle k the seed s + k, a list gives each its own, and a mask leaves the
    others as they are.
    """
    env = kind.many(4, autoreset_mode="Disabled")
    single, _ = env.reset(seed=20)
    np.testing.assert_array_equal(single, kind.many(4).reset(seed=[20, 21, 22, 23])[0])
    np.testing.assert_array_equal(env.reset(seed=20)[0], single)
    assert len({tuple(row) for row in single}) == 4 and not np.array_equal(env.reset()[0], single)
    np.testing.assert_array_equal(
        env.reset(seed=[5, None, 7, 8])[0][0], kind.one().reset(seed=5)[0]
    )
    before = env.step(np.full((4, kind.motors), 0.4))[0]
    after, _ = env.reset(
        seed=[9] * 4, options={"reset_mask": np.array([False, True, False, False])}
    )
    np.testing.assert_array_equal(after[1], kind.one().reset(seed=9)[0])
    np.testing.assert_array_equal(after[[0, 2, 3]], before[[0, 2, 3]])
    assert not np.array_equal(kind.many(2).reset()[0], kind.many(2).reset()[0])


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@KINDS
def test_the_number_of_threads_changes_nothing(kind, mode):
    """Observations, rewards and ends of 70 vehicles, through restarts, equal to the bit."""
    runs = []
    for threads in (1, 2, 3):
        env = kind.many(70, threads=threads, autoreset_mode=mode, **kind.quick)
        rows = [env.reset(seed=0)[0]]
        for a in actions(60 if kind is WHEEL else 14, 70, kind.motors, 3):
            observations, rewards, terminated, truncated, _ = env.step(a)
            rows.append(np.column_stack([observations, rewards, terminated, truncated]))
        runs.append(rows)
    assert np.sum([row[:, -2] for row in runs[0][1:]]) > 3
    for other in runs[1:]:
        for a, b in zip(runs[0], other, strict=True):
            np.testing.assert_array_equal(a, b)


@pytest.mark.parametrize("repeat", [1, 3])
@pytest.mark.parametrize("autoreset", ["NextStep", "SameStep"])
def test_max_episode_steps_truncates_and_the_time_limit_terminates(autoreset, repeat):
    for limits, cause in (
        ({"max_episode_steps": 20}, Cause.RUNNING),
        ({"control": {"time_limit": 2.0 * repeat}}, Cause.TIME_LIMIT),
    ):
        env = SoilWheelVectorEnv(3, repeat=repeat, autoreset_mode=autoreset, **limits)
        env.reset(seed=0)
        for k in range(1, 45):
            _, _, terminated, truncated, info = env.step(np.full((3, 1), 0.3))
            over, other = (
                (terminated, truncated) if cause == Cause.TIME_LIMIT else (truncated, terminated)
            )
            assert not other.any()
            # 20 steps of `repeat` periods of 0.1 s; a reset is a step of its own in NextStep
            episode = 20 if autoreset == "SameStep" else 21
            assert np.all(over == (k % episode == 20 % episode))
            if over.all():
                last = info.get("final_info", info)
                assert np.all(last["cause"] == cause)
                assert np.all(
                    last["reward_immobilisation"] == (-10.0 if cause == Cause.TIME_LIMIT else 0.0)
                )


@KINDS
def test_the_last_step_of_a_limit_truncates_where_it_terminates_too(kind):
    """As `gymnasium.wrappers.TimeLimit`, also where the end cuts the periods of an action short."""
    changes = {"repeat": 4, "control": {"time_limit": 1.0}}
    many = kind.many(1, max_episode_steps=3, **changes)
    one = gymnasium.wrappers.TimeLimit(kind.one(**changes), 3)
    action = np.full(kind.motors, 0.3, np.float32)
    many.reset(seed=0)
    one.reset(seed=0)
    for _ in range(3):
        ends = [ended[0] for ended in many.step(action[None])[2:4]]
        assert ends == [*one.step(action)[2:4]]
    assert ends == [True, True]


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"seed": [1, 2]}, "expected 3 seeds, got 2"),
        ({"seed": np.array(3.5)}, "seed = 3.5"),
        ({"seed": b"abc"}, "seed = b'abc'"),
        ({"seed": True}, "seed = True"),
        ({"seed": "a"}, "^seed"),
        ({"seed": [0, 1.5, 2]}, r"seed\[1\] = 1.5.*: expected a whole number >= 0"),
        ({"options": [1]}, "^reset"),
        ({"options": {"reset_mask": [0, 1, 2]}}, r"reset_mask: expected shape \(3,\) of bool"),
        ({"options": {"reset_mask": np.ones(2, dtype=bool)}}, r"got \(2,\)"),
    ],
)
def test_bad_resets_are_named(given, words):
    with pytest.raises(ValueError, match=words):
        SoilWheelVectorEnv(3).reset(**given)


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
    assert env.simulation.worlds.courses["drawn"][1] > 0  # or it was reset by the step


@pytest.mark.parametrize("mode", ["NextStep", "SameStep"])
@KINDS
def test_vehicles_that_the_first_reset_leaves_out_are_seeded_too(kind, mode):
    """The step that restarts them gives each the course of its own seed."""
    env = kind.many(3, observation="blind", autoreset_mode=mode)
    env.reset(seed=7, options={"reset_mask": np.array([True, False, False])})
    restarted = env.step(np.full((3, kind.motors), 0.3))[0]
    np.testing.assert_array_equal(
        restarted[1:], kind.many(3, observation="blind").reset(seed=7)[0][1:]
    )
    assert not np.array_equal(restarted[1], restarted[2])
