"""The printed numbers of the source paper beside ours, by its equations as printed and with Wong &
Reece's stress peak.

Source: Hutangkabodee, Zweiri, Seneviratne & Althoefer (2006), IJAC 3:244-251.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache
from itertools import product
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq

from soil_env._io.loading import ParameterError
from soil_env.parameters import lumped_coefficient

from .model import (
    AS_PRINTED,
    MEASURED,
    WONG_REECE,
    Equations,
    P,
    Points,
    Sand,
    forces,
    newton_raphson,
)

SAND = P.table2
POINT = P.working_point

#: The two readings of the paper: equations as printed, and with Wong & Reece's stress peak.
MODELS = (AS_PRINTED, WONG_REECE)
EXACT = tuple(e._replace(simpson=0) for e in MODELS)  # by Gauss-Legendre nodes
#: With the c of 3000 Pa that is held in Table 3 and what follows from it.
FIXED_COHESION = tuple(e._replace(cohesion=P.fixed_cohesion) for e in MODELS)
NAMES = ("friction_angle_deg", "shear_modulus", "sinkage_coefficient")
LABELS = {
    "friction_angle_deg": "phi [deg]",
    "shear_modulus": "K [m]",
    "sinkage_coefficient": "S",
    "cohesion": "c [Pa]",
    "k_c": "k_c",
    "k_phi": "k_phi",
    "sinkage_exponent": "n",
}
# Parameters of Table 3, in the order of `NAMES`: as identified there, and the actual values.
PRINTED_SET = np.array([P.table3[name].identified for name in NAMES])
ACTUAL_SET = np.array([P.table3[name].actual for name in NAMES])
WONG_REECE_LOAD = 8923.0  # [N] of the wheel of Wong & Reece (1967), 2006 lb
WIDE_SLIP = (0.05, 0.6)  # our reading of "a wide range of slip"
WIDE_SLIPS = np.linspace(*WIDE_SLIP, 200)  # over which a mean drawbar pull is taken
RULES = (1, 2, 5, 10)  # m of Simpson's rule in Fig. 2
SLIPS = np.linspace(0.01, 0.95, 48)  # of the torques of Fig. 8
OFF = (0.95, 1.05)  # drawbar pulls of Table 1 over that of the working point
NOISE = 0.05  # standard deviation of the noise of Table 5, relative to each measured value
# A search counts as ended on a root within these distances of it; own choice, far above the error
# of a search and far below the distance of another root.
ROOT_DEGREES = 0.01  # [deg] of phi
ROOT_RELATIVE = 1e-4  # [-] of K and of S


class Row(NamedTuple):
    """A printed number and the recomputed ones, by each of `MODELS`."""

    name: str
    printed: float
    ours: Sequence[float]
    form: str = ".2f"  # format of all these numbers, with the digits of the printed one
    #: "<" or ">" where a recomputed limit is the end of its scan, and no limit was found.
    beyond: Sequence[str] = ("", "")


def as_shown(value: float, form: str) -> float:
    """`value` rounded to the printed digits; the paper takes its errors from rounded values."""
    return float(format(value, form))


def percent_above(value: Any, reference: Any) -> Any:
    """Excess of a value over the reference [% of the reference]; of arrays an array."""
    return 100.0 * (value / reference - 1.0)


def soil_and_equations(
    sand: Sand, e: Equations = AS_PRINTED
) -> tuple[tuple[float, float, float], Equations]:
    """((phi [deg], K [m], S) of the sand, the equations `e` with its c and n).

    The two arguments by which `forces` describes a soil.
    """
    S = lumped_coefficient(sand.k_c, sand.k_phi, e.width)
    e = e._replace(cohesion=sand.cohesion, exponent=sand.sinkage_exponent)
    return (sand.friction_angle_deg, sand.shear_modulus, S), e


def pulls(e: Equations, slip: ArrayLike, **changes: float) -> np.ndarray:
    """DP [N] of the compact sand, with these `changes` of its parameters, at each slip, [M] or a
    number, with the entry angle of the working point.
    """
    soil, e = soil_and_equations(replace(SAND, **changes), e)
    sinkage = e.radius * (1.0 - math.cos(math.radians(POINT.entry_angle_deg)))
    return forces(soil, slip, sinkage, e)[:, 0]


def pull(e: Equations, **changes: float) -> float:
    """DP [N] at the working point; `changes` as in `pulls`."""
    return float(pulls(e, POINT.slip, **changes)[0])


def mean_pull(e: Equations, **changes: float) -> float:
    """Mean DP [N] over `WIDE_SLIPS`; `changes` as in `pulls`."""
    return float(pulls(e, WIDE_SLIPS, **changes).mean())


def alone(e: Equations, name: str, target: float) -> float:
    """The value of one parameter of the sand at which the drawbar pull of the working point is
    `target` [N], all others as in Table 2.

    It is sought between half and twice the value of Table 2, a cohesion from -10 to 100 kPa.
    """
    value = getattr(SAND, name)
    low, high = (-1e4, 1e5) if name == "cohesion" else (0.5 * value, 2.0 * value)
    return float(brentq(lambda v: pull(e, **{name: v}) - target, low, high, xtol=1e-12 * high))


def working_point() -> list[Row]:
    """Rows of Sections 3.1 and 4: the drawbar pull, and what the text says of cohesion."""
    at_1150 = [alone(e, "cohesion", POINT.if_measured_drawbar_pull) for e in MODELS]
    # Not printed: the DP [N] that the printed cohesion, 4322.74 Pa, belongs to.
    at_1200 = [alone(e, "cohesion", 1200.0) for e in MODELS]
    no_cohesion = [pull(e, cohesion=0.0) for e in MODELS]
    # [%] of the mean DP, by the cohesion held in Table 3 in place of that of Table 2.
    changes = [percent_above(mean_pull(e, cohesion=P.fixed_cohesion), mean_pull(e)) for e in MODELS]
    c = POINT.then_identified_cohesion
    limit = POINT.cohesion_may_turn_negative_below
    error = [percent_above(found, SAND.cohesion) for found in at_1200]
    return [
        Row("DP [N]", POINT.drawbar_pull, [pull(e) for e in MODELS]),
        Row("c identified from 1150 N [Pa]", c, at_1150),
        Row("the same from 1200 N", c, at_1200),
        Row("its error [%]", POINT.then_error_percent, error, ".0f"),
        Row("c is negative below a DP of [N]", limit, no_cohesion, ".0f"),
        Row("change of DP by c = 3000 Pa, mean [%]", P.variation_percent, changes, ".1f"),
    ]


def table_1() -> list[Row]:
    """Rows of Table 1: each parameter identified alone from drawbar pulls 5 % off (`OFF`), and its
    error [%], which is taken from the rounded value as in the paper.
    """
    rows = []
    forms = {"shear_modulus": ".4f", "k_c": ".0f", "k_phi": ".0f", "sinkage_exponent": ".4f"}
    for name, line in P.table1.items():
        form = forms.get(name, ".2f")
        for k, factor in enumerate(OFF):
            found = [alone(e, name, factor * pull(e)) for e in MODELS]
            label = f"{LABELS[name]}, DP {100 * (factor - 1):+.0f} %"
            rows.append(Row(label, line.identified[k], found, form))
            errors = [percent_above(as_shown(v, form), getattr(SAND, name)) for v in found]
            rows.append(Row("error [%]", line.error_percent[k], errors))
    return rows


class Rule(NamedTuple):
    """Drawbar pulls by an equation of the resistance and a rule of integration."""

    name: str  # equation and rule
    equations: list[Equations]  # by each of `MODELS`, as what follows
    pulls: list[float]  # DP [N] of the working point
    #: [%] by which the mean DP over `WIDE_SLIPS` is above that by (12), integrated exactly.
    differences: list[float]


def rules() -> list[Rule]:
    """Rules of Fig. 2: (12) by Simpson's rule with each m of `RULES` and exactly, then (11) with
    m = 2 and exactly.
    """
    cases = [(f"(12), m = {m}", m, True) for m in RULES]
    cases += [("(12), exact", 0, True), ("(11), m = 2", 2, False), ("(11), exact", 0, False)]
    found = []
    for name, m, compaction in cases:
        ours = [e._replace(simpson=m, compaction=compaction) for e in MODELS]
        differences = [
            percent_above(mean_pull(e), mean_pull(exact))
            for e, exact in zip(ours, EXACT, strict=True)
        ]
        found.append(Rule(name, ours, [pull(e) for e in ours], differences))
    return found


def on_the_curve(name: str) -> list[tuple[str, float, Row]]:
    """Printed values of one parameter with the DP that is printed for each: (where it is printed,
    value, `Row` of the DP).

    In the paper they lie on the curves of Fig. 3 (cohesion) and Fig. 4 (phi and K).
    """
    below, above = P.table1[name].identified
    printed = [
        ("Table 1, DP -5 %", below, OFF[0] * POINT.drawbar_pull),
        ("Table 2", getattr(SAND, name), POINT.drawbar_pull),
        ("Table 1, DP +5 %", above, OFF[1] * POINT.drawbar_pull),
    ]
    if name == "cohesion":
        printed.append(
            ("Section 3.1", POINT.then_identified_cohesion, POINT.if_measured_drawbar_pull)
        )
    rows = []
    for where, value, target in printed:
        ours = [pull(e, **{name: value}) for e in MODELS]
        rows.append((where, value, Row(f"{LABELS[name]} {value:g} ({where})", target, ours)))
    return rows


@cache
def root(e: Equations) -> np.ndarray:
    """(phi [deg], K [m], S) that solve the equations for the three measured points, by
    Newton-Raphson from `ACTUAL_SET`.
    """
    return newton_raphson(MEASURED, ACTUAL_SET, e)


def table_3() -> list[Row]:
    """Rows of Table 3: the identified parameters, their errors [%] against the actual ones, and the
    measured pulls beside the pulls that the printed parameters predict.
    """
    found = [root(e) for e in FIXED_COHESION]
    rows = []
    for k, (name, form) in enumerate(zip(NAMES, (".2f", ".4f", ".0f"), strict=True)):
        line = P.table3[name]
        # without sign, as the paper prints them
        errors = [abs(percent_above(as_shown(x[k], form), line.actual)) for x in found]
        rows.append(Row(LABELS[name], line.identified, [x[k] for x in found], form))
        rows.append(Row("error [%]", line.error_percent, errors))
    predicted = [prediction(PRINTED_SET, e)[:, 0] for e in FIXED_COHESION]
    for slip, measured, *ours in zip(MEASURED.slip, MEASURED.pull, *predicted, strict=True):
        name = f"DP at {100 * slip:.2f} % slip of the printed set, beside the measured [N]"
        rows.append(Row(name, measured, ours))
    return rows


def reaches(e: Equations, guesses: np.ndarray, backtracking: bool) -> np.ndarray:
    """[G] True if Newton-Raphson from `guesses` [G, 3], (phi [deg], K [m], S), ends on the `root`.

    A phi that is off by a multiple of 180 deg counts as equal (`_turned`).
    """
    found = newton_raphson(MEASURED, guesses, e, backtracking)
    solution = root(e)
    turn = np.abs(_turned(found[:, 0], solution[0]) - solution[0])
    off = np.abs(found[:, 1:] / solution[1:] - 1.0)
    return (turn < ROOT_DEGREES) & np.all(off < ROOT_RELATIVE, axis=1)


def _turned(phi: np.ndarray, near: float) -> np.ndarray:
    """The angles phi [deg] turned by multiples of 180 deg to within 90 deg of `near`: they have the
    same tangent, which is all that the equations use.
    """
    return (phi - near + 90.0) % 180.0 - 90.0 + near


def table_4(backtracking: bool) -> list[Row]:
    """Rows of Table 4: lowest and highest guess of one unknown, the other two at their actual
    values, from which Newton-Raphson reaches the root.

    All guesses between the limit and the actual value reach it too. A scan without a lost guess on
    one side gives its end, marked in `Row.beyond`.
    """
    rows = []
    scans = (  # guesses of phi [deg], K [m] and S, beyond the printed limits
        np.linspace(0.5, 89.5, 891),
        np.linspace(1e-4, 0.2, 1000),
        np.geomspace(1e3, 1e14, 441),
    )
    for k, (name, scan, form) in enumerate(zip(NAMES, scans, (".1f", ".4f", ".2g"), strict=True)):
        lowest = []
        highest = []
        guesses = np.tile(ACTUAL_SET, (scan.size, 1))
        guesses[:, k] = scan
        for e in FIXED_COHESION:
            lost = ~reaches(e, guesses, backtracking)
            below = np.flatnonzero(lost & (scan < ACTUAL_SET[k]))
            above = np.flatnonzero(lost & (scan > ACTUAL_SET[k]))
            lowest.append((scan[below[-1] + 1], "") if below.size else (scan[0], "<"))
            highest.append((scan[above[0] - 1], "") if above.size else (scan[-1], ">"))
        low, high = P.table4[name]
        for label, printed, limits in (("lowest", low, lowest), ("highest", high, highest)):
            ours, beyond = zip(*limits, strict=True)
            rows.append(Row(f"{LABELS[name]}, {label}", printed, ours, form, beyond))
    return rows


class Box(NamedTuple):
    """Guesses in the printed ranges of Table 4, and which of them reach the root."""

    guesses: np.ndarray  # [G, 3]
    #: [G] each: plain and with backtracking by the equations as printed, then the same two with
    #: Wong & Reece's peak; the order of `page.METHODS`.
    reached: list[np.ndarray]


def box(*counts: int) -> Box:
    """`Box` of a grid over the ranges of Table 4, with `counts` values of phi, K and S.

    The values of S have equal ratios. Counts of 2 give the corners of the ranges.
    """
    phi, K, S = (P.table4[name] for name in NAMES)
    sides = (
        np.linspace(phi[0], phi[1], counts[0]),
        np.linspace(K[0], K[1], counts[1]),
        np.geomspace(S[0], S[1], counts[2]),
    )
    guesses = np.array(list(product(*sides)))
    return Box(guesses, [reaches(e, guesses, own) for e in FIXED_COHESION for own in (False, True)])


class Noisy(NamedTuple):
    """Errors [%] of (phi, K, S) identified from noisy points, against the actual values.

    Quantiles and shares are of the draws whose search converged.
    """

    quantiles: np.ndarray  # 5, 50, 95 % of |error|, [3 quantiles, 3 parameters]
    below: np.ndarray  # share of draws with an error below the printed one, [3]
    converged: float  # share of all draws


def table_5(e: Equations, seed: int, draws: int) -> Noisy:
    """`Noisy` of Table 5, by a number of `draws` of white noise (`NOISE`) on slip, sinkage and
    drawbar pull of the three measured points.

    `ParameterError` where every search is lost.
    """
    factors = 1.0 + NOISE * np.random.default_rng([seed, 5]).standard_normal((draws, 3, 3))
    noisy = Points(*np.swapaxes(np.array(MEASURED) * factors, 0, 1))
    found = newton_raphson(noisy, np.tile(ACTUAL_SET, (draws, 1)), e)
    found[:, 0] = _turned(found[:, 0], ACTUAL_SET[0])
    errors = np.abs(percent_above(found, ACTUAL_SET))
    good = np.isfinite(errors).all(axis=1)
    if not good.any():
        raise ParameterError(f"draws = {draws}: all searches of Table 5 are lost: expected more")
    return Noisy(
        np.percentile(errors[good], [5, 50, 95], axis=0),
        (errors[good] < [P.table5[name][1] for name in NAMES]).mean(axis=0),
        good.mean(),
    )


def sets(k: int) -> dict[str, tuple[np.ndarray, Equations]]:
    """{name: ((phi [deg], K [m], S), equations)} of the parameter sets of Figs. 6 to 8, by the
    reading `MODELS`[k].
    """
    e = FIXED_COHESION[k]
    return {
        "Table 2": (ACTUAL_SET, MODELS[k]),
        "Table 3, printed": (PRINTED_SET, e),
        "Table 3, ours": (root(e), e),
    }


def prediction(soil: ArrayLike, e: Equations) -> np.ndarray:
    """DP [N] and T [N m] that a soil (phi [deg], K [m], S) gives at the three measured points,
    [3, 2].
    """
    return forces(soil, *MEASURED[:2], e)[:, [0, 2]]


def pull_misfits() -> list[float]:
    """Root mean square [N], by each of `MODELS`, by which the printed parameters of Table 3 miss
    the three measured drawbar pulls.
    """
    misses = [prediction(PRINTED_SET, e)[:, 0] - MEASURED.pull for e in FIXED_COHESION]
    return [np.sqrt(np.mean(miss**2)) for miss in misses]


def sinkages(soil: ArrayLike, slip: np.ndarray, e: Equations) -> np.ndarray:
    """Sinkages [M] in m, of one radius at most, at which Eq. (1) carries `WONG_REECE_LOAD`, for
    each slip [M]. `soil` is (phi [deg], K [m], S).
    """

    def excess(sinkage: float, i: float) -> float:
        """Load [N] that the soil carries at a slip i, beyond that of the wheel."""
        return forces(soil, i, sinkage, e)[0, 1] - WONG_REECE_LOAD

    return np.array([brentq(excess, 0.0, e.radius, (i,)) for i in slip])


def torque(soil: ArrayLike, e: Equations) -> np.ndarray:
    """Torque required [N m] at each of `SLIPS` by (1) and (3), integrated exactly, on a soil
    (phi [deg], K [m], S).
    """
    e = e._replace(simpson=0)
    return forces(soil, SLIPS, sinkages(soil, SLIPS, e), e)[:, 2]


@dataclass(frozen=True)
class Results:
    """Recomputed tables and figures, as `page` shows them."""

    seed: int  # of the noise of Table 5
    draws: int  # of that noise
    rows: dict[str, list[Row]]  # by table or figure
    corners: Box  # of the ranges of Table 4
    box: Box  # grid over these ranges
    noise: list[Noisy]  # by each of `MODELS`


def compute(seed: int, draws: int) -> Results:
    """Recompute all tables and figures; `seed` and number of `draws` of the noise in Table 5."""
    rows = {
        "point": working_point(),
        "table1": table_1(),
        "table3": table_3(),
        "table4": table_4(False),
        "table4_backtracking": table_4(True),
        "fig3": [row for *_, row in on_the_curve("cohesion")],
        "fig4": [row for name in NAMES[:2] for *_, row in on_the_curve(name)],
    }
    noise = [table_5(e, seed, draws) for e in FIXED_COHESION]
    return Results(seed, draws, rows, box(2, 2, 2), box(7, 7, 5), noise)
