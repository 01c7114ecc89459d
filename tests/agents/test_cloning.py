"""Clones of wheels: stepped alike they give the same, bit for bit; what belongs to the original
stays as it is.
"""

from functools import partial

import numpy as np
import pytest

from soil_env.envs.wheels import Simulation
from soil_env.parameters import load_scenario
from soil_env.parameters.readings import IDLE, STEP
from soil_env.simulation.task import Cause
from soil_env_agents.controllers.cloning import clone
from tests.refusals import refused
from tests.simulation.wheels import started

WHEELS = 5
CLONES = 11


def memory(part, wheel):
    """Bytes of everything that is kept of one wheel, by name."""
    if isinstance(part, tuple):  # every step writes the samples anew
        kept = part._asdict() | {"samples": None}
        return {name: memory(own, wheel) for name, own in kept.items()}
    return None if part is None or not len(part) else part[wheel].tobytes()


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
    places = [0, 7, 10, 2]
    wheels = [3, 1, 3, 4]
    clone(sim, wheels, other, places)
    rng = np.random.default_rng(1)
    going = np.full(CLONES, IDLE)  # places without a clone stand still
    going[places] = STEP
    of = np.zeros(CLONES, dtype=np.int64)
    of[places] = wheels
    halts = 0
    for _ in range(151):
        for place, wheel in zip(places, wheels, strict=True):
            assert memory(sim.worlds, wheel) == memory(other.worlds, place)
        commands = rng.uniform(0.1, 0.8, WHEELS)
        sim.step_all(commands, np.full(WHEELS, STEP))
        other.step_all(commands[of], going)
        halts += int((sim.worlds.state["halt_left"] > 0.0).sum())
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
    for wheels, task, variant, said in (
        ([0], longer, "blind", "expected the same scenario"),
        ([0], scenario, "identified", "expected the same scenario"),
        ([0, 1], scenario, "blind", "one for each"),
    ):
        refused(partial(clone, sim, wheels, Simulation(2, task, variant), [0]), said)
