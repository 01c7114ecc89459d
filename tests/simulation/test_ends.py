"""The ways an episode ends, and that a stuck wheel cannot evade them."""

import numpy as np
import pytest

from soil_env._compiled.cache import kept
from soil_env.simulation.task import Cause
from soil_env.simulation.task.rules import judge
from tests.simulation.test_task import simulation


@kept
def _judge(state, task, steps, causes):
    """Judge the first wheel as often as there are `causes`, each time `steps` periods later."""
    for i in range(causes.size):
        state[0].steps += steps
        causes[i] = judge(state[0], task[0])


def judged(sim, times=1, steps=1):
    """`Cause`s of `times` judgements; the count of control periods grows by `steps` before each."""
    causes = np.zeros(times, dtype=np.int64)
    _judge(sim.worlds.state, sim.numbers.task, steps, causes)
    return [Cause(cause) for cause in causes]


STUCK = {"speed": 0.0, "wheel_speed": 2.0}
STALLED = {"speed": 0.0, "wheel_speed": 0.0}


@pytest.mark.parametrize(
    ("state", "steps", "cause"),
    [
        (STUCK, 100, "ENTRAPPED"),
        (STALLED, 100, "STALLED"),  # 10 s
        ({"x": -0.49}, 1, "RUNNING"),
        ({"x": -0.51}, 1, "ENTRAPPED"),
        ({"sinkage": 0.799 * 0.15}, 1, "RUNNING"),
        ({"sinkage": 0.801 * 0.15}, 1, "BOGGED"),
        ({"x": 9.999}, 1, "RUNNING"),
        ({"x": 10.0}, 1, "FINISHED"),
        ({"x": 10.1, "sinkage": 0.14}, 1, "FINISHED"),
        ({"x": 10.1, "halt_left": 5.0}, 1, "FINISHED"),
        ({"steps": 898}, 2, "TIME_LIMIT"),
        ({"steps": 898, "halt_left": 5.0}, 2, "TIME_LIMIT"),
        ({"steps": 899, "sinkage": 0.14}, 1, "BOGGED"),
    ],
)
def test_each_end_has_its_threshold(state, steps, cause):
    """In that step, and not in those before."""
    sim = simulation("blind")
    w = sim.worlds.state
    w["speed"] = 0.3
    w["wheel_speed"] = 3.0
    w["last_action"] = 0.3
    for name, value in state.items():
        w[name] = value
    assert judged(sim, steps) == [Cause.RUNNING] * (steps - 1) + [Cause[cause]]
    sim.restart(0)
    assert sim.worlds.state["idle_time"][0] == sim.worlds.state["mark_x"][0] == 0.0


def onward(way, halted=()):
    """Causes of judgements at the places `way` [m] of successive control periods of 0.1 s, while
    the wheel turns; `halted`: indices of those in a halt.
    """
    sim = simulation("blind")
    w = sim.worlds.state
    causes = []
    w["wheel_speed"] = 3.0
    for k, x in enumerate(way):
        w["x"] = x
        w["best_x"] = max(x, w["best_x"][0])
        w["halt_left"] = 1.0 if k in halted else 0.0
        causes += judged(sim, steps=0)
    return causes


def test_slow_is_not_stuck():
    """18 mm/s gets 0.1 m further in 10 s, and 9 mm/s does not, even if the wheel rocks."""
    assert set(onward(0.03 * np.arange(300))) == {Cause.RUNNING}
    slow = 0.0018 * np.arange(1, 500)
    slower = 0.0009 * np.arange(1, 500)
    assert set(onward(slow)) == {Cause.RUNNING}
    assert onward(slower).index(Cause.ENTRAPPED) < 200
    assert onward(slower + 0.2 * np.sin(np.arange(1, 500))).index(Cause.ENTRAPPED) < 400
    back_and_forth = 1.0 + 0.5 * np.sin(0.2 * np.arange(400))  # at full speed
    assert onward(back_and_forth).index(Cause.ENTRAPPED) < 130


def test_halts_do_not_count():
    """A wheel that does not get on is ENTRAPPED after 100 periods (10 s) outside of halts."""
    assert onward(np.zeros(560), range(50, 500)).index(Cause.ENTRAPPED) == 549
    assert set(onward(np.zeros(500), range(500))) == {Cause.RUNNING}


EVASIONS = {  # what a stuck wheel can do, as commands over control periods
    "spin": lambda k: 0.8,
    "rock": lambda k: 0.8 if k // 5 % 2 else -0.8,
    "stand and spin": lambda k: 0.8 if k // 30 % 2 else 0.0,
    "stand and spin, in turn": lambda k: 0.8 if k % 2 else 0.0,
    "creep back": lambda k: -0.25,
    "creep back, then stand": lambda k: -0.3 if k % 50 < 10 else 0.0,
    "go back and forth": lambda k: 0.4 if k // 40 % 2 else -0.4,
}


@pytest.mark.parametrize("evasion", EVASIONS)
def test_a_stuck_wheel_cannot_evade_its_end(evasion):
    """Before a slope that it cannot climb it has dug in; whatever it does then, it is immobilised,
    and that costs.
    """
    for seed in range(4):
        changes = {
            "soils": {"dry_sand": 1},
            "course": {"halt_time": 0.0},
            "limits": {"bogged_sinkage": 1.4},
        }
        sim = simulation("blind", seed, changes)
        sim.complete(0)
        sim.worlds.courses["slopes"]["grade"] = 0.3
        for k in range(sim.scenario.steps):
            sim.step(0, 0.5 if k < 20 else EVASIONS[evasion](k - 20))
            if sim.worlds.cause[0] != Cause.RUNNING:
                break
        assert sim.worlds.cause[0] in (Cause.ENTRAPPED, Cause.STALLED, Cause.BOGGED), seed
        assert sim.worlds.terms[0, 2] < 0.0
