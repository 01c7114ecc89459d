"""The task: observation, its documented layout and scales, reward, and the numbers that the agent
may not see.
"""

import math
import re
from dataclasses import replace

import numpy as np
import pytest

from soil_env._compiled.cache import kept
from soil_env.envs.rover_env import SoilRoverEnv
from soil_env.envs.wheel_env import SoilWheelEnv, SoilWheelVectorEnv, observation_space
from soil_env.identification import Status
from soil_env.identification.online.memory import PUBLISHED
from soil_env.identification.online.on_board import knowledge, show_estimate
from soil_env.parameters import Belief, SoilState, load_scenario, soils
from soil_env.simulation.rover.task import rover_layout
from soil_env.simulation.task import REWARD_TERMS, VARIANTS, Cause, layout
from soil_env.simulation.task.scaling import Scaling
from soil_env.simulation.wheels import SAMPLE, ThreadRecords, _observe, _sense
from soil_env.simulation.world.camera import Sight
from soil_env.simulation.world.sensors import NO_ERRORS, READING
from soil_env.simulation.world.wheel import World
from soil_env.terramechanics.reaction import BASE
from tests.simulation.wheels import set_soil, started

SENSORS = len(layout("blind"))  # entries that every variant has


def simulation(variant="identified", seed=0, changes=None):
    """A `Simulation` of one wheel after a reset; the action is a torque unless `changes` say
    otherwise.
    """
    return started(
        load_scenario(load_scenario("mixed", {"control": {"action": "torque"}}), changes),
        variant,
        [seed],
    )


def driven(scenario="mixed", wheels=16, steps=240, **options):
    """(environment, observations [steps, wheels, D]) under random actions."""
    env = SoilWheelVectorEnv(wheels, scenario, **options)
    env.reset(seed=0)
    rng = np.random.default_rng(1)
    return env, np.array([env.step(rng.uniform(-0.5, 1.0, (wheels, 1)))[0] for _ in range(steps)])


@pytest.mark.parametrize("variant", VARIANTS)
def test_observation_is_of_order_one_and_neither_constant_nor_aliased(variant):
    rows = np.concatenate(driven(observation=variant, repeat=1, scaled=False)[1])
    entries = layout(variant)
    seen = Scaling(entries)(rows)
    assert np.all(np.isfinite(rows))
    assert np.all(np.abs(seen.mean(axis=0)) < 2.0) and np.all(seen.std(axis=0) < 4.0)
    for i, a in enumerate(entries):
        if a.name == "dig_recovery" and len({s.dig_recovery for s in soils().values()}) == 1:
            continue  # every shipped soil has the same
        assert np.ptp(rows[:, i]) > 1e-3, a.name
        assert a.unit == "0 or 1" or seen[:, i].std() > 0.05, a.name
        assert a.low <= rows[:, i].min() and rows[:, i].max() <= a.high
        # cut to the bounds now and then at most, or information is lost
        if a.unit != "0 or 1" and a.name not in ("slip", "last_action", "rim_command"):
            assert (
                np.mean((rows[:, i] == np.float32(a.low)) | (rows[:, i] == np.float32(a.high)))
                < 0.05
            ), a.name
        for j in range(i):
            assert not np.array_equal(rows[:, i], rows[:, j]), (a.name, entries[j].name)


@pytest.mark.parametrize("variant", VARIANTS[1:])
def test_all_variants_share_the_first_entries(variant):
    """Bit for bit, for the same seed and actions: the variant changes nothing but what is added."""
    blind, other = (
        driven(observation=v, scaled=False, action="torque")[1] for v in ("blind", variant)
    )
    np.testing.assert_array_equal(blind, other[..., : blind.shape[-1]])


@kept
def _write(worlds, sample, setting, out, sensed):
    """Write the observation of the first wheel into `out`; if `sensed`, from new readings."""
    own = setting[0]
    world = World(own.rig[0], BASE, own.nodes[0])
    records = ThreadRecords(
        world, own.task[0], own.sensors[0], NO_ERRORS, own.camera[0], own.normals
    )
    if sensed:
        _sense(worlds.state[0], sample[0], worlds.courses[0], records)
    _observe(worlds.state[0], sample[0], worlds.courses[0], records, Sight(0, 0.0, 0.0), out)


@kept
def _show(known, samples, setting, out):
    show_estimate(known[0], samples[0, 0], setting[0], out)


def written(sim, sample=None):
    """Observation [D] of the present state, with readings of its own, or with those of a `sample`
    (`SAMPLE` [1]).
    """
    kept_state = sim.worlds.state.copy()
    out = np.zeros(sim.numbers.bounds.shape[1], dtype=np.float32)
    own = np.zeros(1, SAMPLE) if sample is None else sample
    _write(sim._world, own, sim._scratch[0], out, sample is None)
    sim.worlds.state[:] = kept_state
    return out


def observed_again(sim, estimate=None):
    """The observation written anew from the present state, the random stream untouched; `estimate`
    is added to all published numbers of the identifier.
    """
    out = written(sim)
    if sim.belief is not None:
        known = sim.worlds.on_board.copy()
        if estimate is not None:
            known["identifier"]["estimate"][..., :PUBLISHED] += estimate
        _show(known, sim._world.samples, sim._on_board.setting, out)
    return out


@pytest.mark.parametrize("variant", VARIANTS)
def test_only_true_soil_shows_the_soil(variant):
    """The observation of the same state where all numbers of the soils are 1.3 times as large."""
    sim = simulation(variant)
    for _ in range(20):
        sim.step(0, 0.3)
    before = observed_again(sim)
    patches = sim.worlds.courses["patches"]
    set_soil(patches, [1.3 * patches[name] for name in SoilState._fields])
    after = observed_again(sim)
    changed = before != after
    expected = np.zeros(len(before), dtype=bool)
    if variant == "true_soil":
        expected[SENSORS:] = True
    np.testing.assert_array_equal(changed, expected)


def test_true_soil_is_the_undisturbed_soil_under_the_wheel():
    sim = simulation("true_soil", changes={"course": {"border": 0.01}})
    second = sim.worlds.courses["patches"][0, 1]
    sim.worlds.state["x"] = 0.5 * (second.start + second.end)
    sim.worlds.courses["cells"]["passes"] = 2.0
    tan_phi, c, k, s, n, gain, recovery = (second[name] for name in SoilState._fields[:7])
    expected = [math.atan(tan_phi), math.log10(k), math.log10(s), c / 1000.0, n, gain, recovery]
    np.testing.assert_allclose(observed_again(sim)[SENSORS:], expected, rtol=1e-6)


def test_estimate_in_the_observation():
    sim = simulation()
    rows = []
    for k in range(200):
        sim.step(0, 0.3 + 0.2 * math.sin(0.5 * k))
        ids = sim.worlds.ids
        seen = sim.worlds.observation[0, SENSORS:]
        x = ids.estimate[0]
        np.testing.assert_allclose(
            seen[:3], [x[0], x[1] / math.log(10), x[2] / math.log(10)], rtol=1e-6
        )
        np.testing.assert_allclose(seen[3:6], ids.sd[0, :3], rtol=1e-6)
        belief = load_scenario("mixed").belief
        np.testing.assert_allclose(
            seen[7:9], [x[3] / 1000.0, belief.dig_gain * math.exp(x[4])], rtol=1e-6
        )
        np.testing.assert_allclose(seen[9:11], [ids.sd[0, 3] / 1000.0, ids.sd[0, 4]], rtol=1e-6)
        np.testing.assert_allclose(seen[11:], [x[5], ids.sd[0, 5]], rtol=1e-6)
        assert seen[6] == (ids.status[0] == Status.CONVERGED)
        rows.append(seen[6])
    assert {0.0, 1.0} == set(rows)
    # phi, K, S, cohesion and digging gain change, their deviations and the best pull do not
    changed = observed_again(sim) != observed_again(sim, estimate=0.01)
    np.testing.assert_array_equal(np.flatnonzero(changed) - SENSORS, [0, 1, 2, 7, 8])


def test_the_observation_follows_from_readings_alone():
    """With the readings held, the observation does not depend on the true state, but for the
    commands (last action, rim command) and the odometer, which sums readings.
    """
    sim = simulation("blind")
    for _ in range(30):
        sim.step(0, 0.3)
    state = sim.worlds.state
    sample = np.zeros(1, SAMPLE)
    for name in READING.names:
        sample[name] = 0.3
    seen = []
    for factor in (1.0, 1.7):
        for name in state.dtype.names:
            shown = name in ("last_action", "rim_command", "halt_left", "odometer")
            if not shown and state.dtype[name].kind == "f":
                state[name] = factor * state[name] + (factor - 1.0)
        seen.append(written(sim, sample))
    np.testing.assert_array_equal(*seen)


def test_reward_is_the_sum_of_its_terms_and_each_follows_its_formula():
    weights = {"progress": 7.0, "energy": 3.0, "immobilisation": 5.0}
    causes = set()
    backwards = 0
    braking = 0
    for seed in range(8):
        sim = simulation("blind", seed, {"reward": weights, "course": {"length": 3.0}})
        rng = np.random.default_rng(seed)
        for _ in range(900):
            x = sim.wheel(0)["x"]
            sim.step(
                0,
                0.9
                if seed % 2
                else 0.1 + 0.3 * rng.random() - (0.5 if rng.random() < 0.1 else 0.0),
            )
            cause = Cause(sim.worlds.cause[0])
            terms = sim.worlds.terms[0]
            w = sim.wheel(0)
            assert terms[0] == pytest.approx(7.0 * (w["x"] - x) / 3.0, abs=1e-12)
            work = max(w["motor_work"], 0.0)
            assert terms[1] == pytest.approx(
                -3.0 * work / (w["mass"] * sim.scenario.gravity * 3.0), abs=1e-12
            )
            assert terms[2] == (0.0 if cause in (Cause.RUNNING, Cause.FINISHED) else -5.0)
            assert terms[3] == 0.0
            assert sim.worlds.reward[0] == terms[0] + terms[1] + terms[2]
            backwards += terms[0] < 0.0
            braking += w["motor_work"] < 0.0
            causes.add(cause)
            if cause != Cause.RUNNING:
                break
    assert backwards and braking and {Cause.FINISHED} < causes
    assert causes & {Cause.ENTRAPPED, Cause.STALLED, Cause.BOGGED}
    assert REWARD_TERMS == ("progress", "energy", "immobilisation", "information")


@pytest.mark.parametrize(
    ("shares", "nats"),
    [
        ([1.0, 1.0, 1.0], 0.0),
        ([0.1, 0.2, 0.5], math.log(100.0)),
        ([7.0, 0.5, 1.0], math.log(2.0)),
        ([0.0, 1.0, 1.0], math.log(1e6)),
        ([math.inf, 1.0, 0.1], math.log(10.0)),
        ([1.0, 1.0, 1.0, 0.5, 0.25], math.log(8.0)),
    ],
)
def test_knowledge_is_the_fall_of_the_entropy_and_bounded(shares, nats):
    sim = simulation()
    sd = sim.worlds.ids.sd[0]
    sd[:] = sim.belief["prior_sd"][0]
    sd[: len(shares)] *= shares
    found = knowledge(sim.worlds.on_board["identifier"][0, 0], sim.belief[0])
    assert found == pytest.approx(nats, abs=1e-12)


ROW = re.compile(r"^\s*\| (\S+) \| (\S+) \| ([\w, ]+) \|$", re.MULTILINE)
ENTRY = re.compile(r"^\s*\| (n\+)?(\d+) \| (\w+) \| .+? \| (\S+) \| (\S+) \|$", re.MULTILINE)
COURSE = load_scenario("two_lines").course


def test_centres_and_scales_are_the_documented_ones():
    rows = [
        (float(c), float(s), names.split(", "))
        for c, s, names in ROW.findall(SoilWheelEnv.__doc__)
        if re.fullmatch(r"-?[\d.]+", c)
    ]
    shown = {name: (c, s) for c, s, names in rows for name in names}
    # a number has one centre and scale in every variant and on both routes
    entries = {
        (e.name.removeprefix("ahead_").removeprefix("beside_"), (e.centre, e.scale))
        for variant in VARIANTS
        for e in layout(variant, COURSE)
    }
    assert set(shown.items()) == {(name, pair) for name, pair in entries if pair != (0.0, 1.0)}


def documented(env):
    """Rows (number, name, low, high) of the tables in the docstring of an environment."""
    return [
        (n + number, name, float(low), float(high))
        for n, number, name, low, high in ENTRY.findall(env.__doc__)
    ]


@pytest.mark.parametrize("variant", VARIANTS)
def test_entries_are_the_documented_ones(variant):
    """Name and bounds of every entry, of lines and axles by the entry that they repeat; numbers
    without a camera.
    """
    rows = documented(SoilWheelEnv)
    bounds = {row[1:] for row in rows}
    numbered = {row[:2] for row in rows}
    named = {name for name, *_ in bounds}
    for e in (*layout(variant, COURSE), *rover_layout(variant, 3)):
        shown = e.name.replace("beside", "ahead")
        shown = shown if shown in named else re.sub("^(ahead|front|middle|rear)_", "", shown)
        assert (shown, e.low, e.high) in bounds or e.name == f"{e.name.partition('_')[0]}_met", e
    assert {(e.name, e.low, e.high) for e in rover_layout("blind", 2)[:14]} == {
        row[1:] for row in documented(SoilRoverEnv)
    }
    assert {(str(number), e.name) for number, e in enumerate(layout(variant))} <= numbered
    env = SoilWheelEnv("mixed", observation=variant, scaled=False)
    assert env.observation_names == tuple(e.name for e in layout(variant))
    np.testing.assert_array_equal(
        env.observation_space.low, np.float32([e.low for e in layout(variant)])
    )
    np.testing.assert_array_equal(
        env.observation_space.high, np.float32([e.high for e in layout(variant)])
    )


@pytest.mark.parametrize("variant", VARIANTS)
def test_scaled_and_physical_are_the_same_drive(variant):
    """Also where S is 1e6 exactly, the centre of its scale and the value of a line whose class was
    never met.
    """
    scenario = replace(load_scenario("two_lines"), belief=Belief(sinkage_coefficient=1e6))
    env, seen = driven(scenario, observation=variant)
    other, values = driven(scenario, observation=variant, scaled=False)
    np.testing.assert_array_equal(env.scaling(values), seen)
    np.testing.assert_allclose(env.physical(seen), values, rtol=1e-5, atol=2e-6)
    np.testing.assert_array_equal(other.physical(values), values)
    assert other.single_observation_space == observation_space(variant, COURSE, scaled=False)
    assert (
        env.single_observation_space
        == observation_space(variant, COURSE)
        != other.single_observation_space
    )
    if variant == "identified":
        assert (
            values[..., env.observation_names.index("ahead_log10_sinkage_coefficient")] == 6.0
        ).any()
