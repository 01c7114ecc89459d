"""Clones of wheels: stepped alike they give the same, bit for bit; what belongs to the original
stays as it is.
"""

import numpy as np
import pytest

from soil_env._io.loading import ParameterError
from soil_env.envs.wheels import Simulation
from soil_env.parameters import load_scenario
from soil_env.parameters.readings import STEP
from soil_env.simulation.task import Cause
from soil_env_agents.controllers.cloning import clone
from tests.simulation.wheels import started

WHEELS = 5
CLONES = 11


def memory(part, wheel, name="worlds"):
    """{name: bytes} of everything that is kept of one wheel."""
    if part is None:
        return {}
    if isinstance(part, tuple):
        out = {}
        for field in part._fields:
            if field == "samples":  # which every step writes anew
                continue
            out |= memory(getattr(part, field), wheel, f"{name}.{field}")
        return out
    return {name: part[wheel].tobytes()} if len(part) else {}


def driven(scenario, variant, steps=60, seed=4):
    """Five wheels on their way, those that have ended on a new course."""
    sim = started(scenario, variant, [[seed, k] for k in range(WHEELS)])
    rng = np.random.default_rng(seed)
    for _ in range(steps):
        sim.step_all(
            rng.uniform(0.2, 0.6, WHEELS), (sim.worlds.cause != Cause.RUNNING.value).view(np.int8)
        )
    return sim


@pytest.mark.parametrize("variant", ["blind", "identified", "true_soil"])
def test_a_clone_stepped_alike_gives_the_same_bit_for_bit(variant):
    scenario = load_scenario("mixed")
    sim = driven(scenario, variant)
    other = Simulation(CLONES, scenario, variant, threads=1)
    pairs = {0: 3, 7: 1, 10: 3, 2: 4}  # place: wheel
    clone(sim, list(pairs.values()), other, list(pairs))
    for place, wheel in pairs.items():
        assert memory(sim.worlds, wheel) == memory(other.worlds, place)
    rng = np.random.default_rng(1)
    going = np.full(CLONES, -1, dtype=np.int64)
    going[list(pairs)] = list(pairs.values())
    halts = 0
    for _ in range(150):
        commands = rng.uniform(0.1, 0.8, WHEELS)
        sim.step_all(commands, np.full(WHEELS, STEP))
        other.step_all(commands[going], np.where(going >= 0, STEP, 2).astype(np.int8))
        halts += int((sim.worlds.state["halt_left"] > 0.0).sum())
        for place, wheel in pairs.items():
            assert memory(sim.worlds, wheel) == memory(other.worlds, place)
    assert halts > 20  # halts, drawn from the stream, are among what is the same


def test_cloning_leaves_the_original_and_other_places_as_they_are():
    scenario = load_scenario("mixed")
    sim = driven(scenario, "blind")
    other = driven(scenario, "blind", seed=9)
    before = [memory(s.worlds, k) for s in (sim, other) for k in range(WHEELS)]
    clone(sim, [2], other, [3])
    for _ in range(20):
        other.step(3, 0.5)
    after = [memory(s.worlds, k) for s in (sim, other) for k in range(WHEELS)]
    changed = [a != b for a, b in zip(before, after, strict=True)]
    assert changed == [k == WHEELS + 3 for k in range(2 * WHEELS)]


def test_worlds_of_another_scenario_and_lists_that_do_not_match_are_refused():
    scenario = load_scenario("mixed")
    longer = load_scenario("mixed", {"course": {"length": 30.0}})
    sim = started(scenario, "blind")
    for other in (Simulation(2, longer, "blind"), Simulation(2, scenario, "identified")):
        with pytest.raises(ParameterError, match="expected the same scenario"):
            clone(sim, [0], other, [0])
    with pytest.raises(ParameterError, match="one for each"):
        clone(sim, [0, 1], Simulation(2, scenario, "blind"), [0])
