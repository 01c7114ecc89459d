"""A wheel, soil and table of conditions for the tests of the blind cases."""

import numpy as np

from benchmarks.blind.easy.forms import FORMS
from benchmarks.blind.easy.limits import Bench
from benchmarks.blind.easy.plan import PRIOR_SD
from benchmarks.blind.easy.unlisted import UNLISTED
from benchmarks.blind.effect import Hidden
from benchmarks.blind.world import Ground, Rows, Wheel

GROUND = Ground(30.0, 1500.0, 0.018, 770000.0, 0.85, 1600.0)
WHEEL = Wheel(0.15, 0.12)
NAMES = ("sinkage", "drawbar_pull", "torque")
ALL_FORMS = FORMS + UNLISTED


def grid() -> Rows:
    """Three loads, speeds, passes, grades and five slips in a fixed order that mixes them."""
    k = np.arange(45)
    slip = np.tile([0.06, 0.2, 0.33, 0.47, 0.6], 9)
    block = k // 5
    load = np.array([45.0, 70.0, 105.0])[block % 3]
    speed = np.array([0.02, 0.06, 0.15])[block // 3]
    grade = np.array([-1.0, 0.0, 1.0])[(block // 3 + block) % 3]
    return Rows(slip, load, speed, 1.0 + (block // 3 + 2 * block) % 3, grade, 100.0 * k)


BENCH = Bench(
    WHEEL,
    GROUND,
    grid(),
    6.0,
    (0.0009, 0.68, 0.097),
    {name: rule(getattr(GROUND, name)) for name, rule in PRIOR_SD.items()},
)


def hidden(name: str, strength: float, **side) -> Hidden:
    form = next(f for f in ALL_FORMS if f.name == name)
    return Hidden(form, strength, form.side(np.random.default_rng(0), BENCH.context) | side)


def table(*effects: Hidden) -> np.ndarray:
    return BENCH.truth(effects)
