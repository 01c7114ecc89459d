"""Mistakes in a table: a unit, sign or convention of a column, the diameter for the radius, a wrong
row.

Each is another reading of the table. Readings are compared by their evidence under the base model
whose laws may err (`form_error`): a mistake is told where another reading explains the table far
better. What only an effect that the base model lacks would explain is no mistake, since every
reading may err by so much. The noise is that of a smooth surface (`noise`), so that a
table that no reading fits is not compared by its misfit.

What a wheel pulls and turns with rises with slip by what soil can bear, and by about the same in
both: a resistance is in their difference, and changes little. This is evidence beside that of the
model, since a large error of its laws could take up a factor of the unit.
"""

import dataclasses
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from scipy.special import expit, logsumexp
from threadpoolctl import threadpool_limits

from soil_env._io.loading import ParameterError
from soil_env.measurement.doubts import load_doubt
from soil_env.measurement.setup import Setup
from soil_env.measurement.table import Table, look_like_radians
from soil_env.terramechanics.model import Rows

from .data import CHANNELS, Data, prepare
from .form_error import finite
from .noise import (
    NoiseEstimate,
    find_noise,
    given_noise,
    with_noise_of_conditions,
)
from .problem import COARSE, TableProblem

GRAVITY = 9.81  # [m/s2]
UNUSUAL = math.log(1e-3)  # log of the prior probability of a mistake of one kind
SURE = 8.5  # log of the evidence for another reading, from which it is told
MAYBE = 4.5  # the same, from which it is mentioned as one that could be meant
#: Times smaller that the mean square above the noise gets under a reading that is told.
BETTER = 1.5
CORRECTIONS = 4  # of slip and load that have noise, and fits in turn
FEWEST_ROWS = 3  # that have to agree against a wrong one
SMALL = 8  # rows of a table, each of which is looked at
SHARED = 0.5  # of its deviation, from which what rows next to it share is no mistake of one row
MOST_WRONG = 0.04  # share of the rows that may be wrong, but one may always be
ALIKE = 1.5  # times the least load of rows, up to which their loads are alike
APART = 5.0  # times these, from which a load stands alone
LONE = 1.0  # ranges of the others, by which a value that is told first leaves them
CLEAR = 3.0  # [noise and law error] within which a row fits with another load or slip
WRONG = 4.0  # [noise and law error] from which a row is wrong
GROSS = 6.0  # the same in a small table whose noise is not known
LAW_ERROR = 0.1  # relative, for the same
NO_VALUE = 1e3  # [noise and law error] residual where the model has no value
ROUGH = 0.05  # of the spread of a channel: its noise where none is known yet
#: Student's t of the logarithms of a rise over the load and of pull over torque/radius: of 2000
#: tables of `benchmarks.sound_tables` (seed 5001).
FREEDOM = np.array([5.0, 1.5])
CENTRE = np.log([0.19, 1.0])
SCALE = np.array([0.385, 0.106])
#: Resistance over the load, as a multiple of the root of sinkage over radius, with its standard
#: deviation; Student's t below and above it. Of 800 tables of `benchmarks.sound_tables` (9001).
HELD = 0.72
HELD_SD = 0.056
LESS_FREEDOM = 8.0
MORE_FREEDOM = 2.0
ALONE = 4.5  # log of the evidence by rises, from which a reading is told whatever the model says
#: The same, from which a reading of enough evidence is told though it misses the table by more
#: noise, which an effect that is missing can do.
WITH = 3.0
UNLIKE = -2.5  # the same, below which it is none
FALLS = 0.8  # share of the groups of rows in which the drawbar pull falls with slip
LOW_SLIP = 0.2  # slip below which a group must begin for a fall to say anything
LEAST_SPAN = 0.15  # of the slips of a group, for the same
#: Share of the load, largest in a table, below which a force is in another unit: rolling takes
#: more.
WEAK = 2e-3
LEVEL = 0.02  # sine of the grade below which the weight neither takes nor gives power
GAINED = 1.1  # times the power or force at the axle, from which more is no error of a gain
SURE_GAIN = 3.0  # [noise] beyond which it is no noise
BROAD = 3.0  # spreads of a channel within which a wrong value may be anywhere


class Reading(NamedTuple):
    """The table read otherwise."""

    name: str
    words: str  # "With ...", in a sentence
    remedy: str
    table: Table
    setup: Setup
    scale: np.ndarray  # [3] of the channels
    source: tuple[int, ...] = (0, 1, 2)  # channel of the table of each


def readings(table: Table, setup: Setup) -> list[Reading]:
    """Every reading of the table that is tried."""
    out = []
    known: dict[str, bool] = {
        name: bool(np.any(np.isfinite(getattr(table, name)))) for name in CHANNELS
    }

    def add(
        name: str,
        words: str,
        remedy: str,
        scale=(1.0, 1.0, 1.0),
        source=(0, 1, 2),
        there: Setup = setup,
        **columns,
    ) -> None:
        for channel, factor in zip(CHANNELS, scale, strict=True):
            columns[f"{channel}_sd"] = factor * getattr(table, f"{channel}_sd")
        otherwise = dataclasses.replace(table, **columns)
        out.append(Reading(name, words, remedy, otherwise, there, np.array(scale), source))

    if known["drawbar_pull"]:
        add(
            "pull",
            "With the sign of drawbar_pull turned",
            "expected drawbar_pull positive where the wheel pulls",
            drawbar_pull=-table.drawbar_pull,
        )
    if known["drawbar_pull"] and known["torque"]:
        add(
            "columns",
            "With the columns of drawbar_pull and torque exchanged",
            "expected drawbar_pull in newtons and torque in newton metres, each in its own column",
            source=(0, 2, 1),
            drawbar_pull=table.torque,
            torque=table.drawbar_pull,
        )
    for name, column, unit, factor, expected in (
        ("pull_kg", "drawbar_pull", "kilograms", GRAVITY, "newtons"),
        ("torque_kg", "torque", "kilogram metres", GRAVITY, "newton metres"),
        ("torque_kg_cm", "torque", "kilogram centimetres", 0.01 * GRAVITY, "newton metres"),
        ("load", "load", "kilograms", GRAVITY, "newtons"),
    ):
        if column == "load" or known[column]:
            add(
                name,
                f"With {column} as {unit} (times {factor:g})",
                f"expected {column} in {expected}",
                [factor if channel == column else 1.0 for channel in CHANNELS],
                **{column: factor * getattr(table, column)},
            )
    if known["drawbar_pull"] or known["torque"]:  # sinkage alone may rise or fall with slip
        add(
            "slip",
            "With the sign of slip turned",
            "expected slip positive where the wheel drives",
            slip=-table.slip,
        )
        add(
            "slip_travel",
            "With slip as (r w - V)/V (divided by 1 + itself)",
            "expected slip as (r w - V)/(r w) where the wheel drives",
            slip=table.slip / (1.0 + np.maximum(table.slip, 0.0)),
        )
        begins = np.min(np.abs(table.slip)) <= LOW_SLIP
        # A rig begins at low slip: a table that does is not read as one that does not.
        if np.all(table.slip >= 0.0) and (not begins or np.max(table.slip) >= 1.0 - LOW_SLIP):
            add(
                "slip_ratio",
                "With slip as V/(r w) (1 less itself)",
                "expected slip as 1 - V/(r w)",
                slip=1.0 - table.slip,
            )
    half = 0.5 * setup.wheel.radius
    if not np.any(np.isfinite(table.wheel_radius)) and half >= 0.01:
        if not np.any(table.sinkage > half) and (setup.wheel.grouser_height or 0.0) < half:
            wheel = dataclasses.replace(setup.wheel, radius=half)
            add(
                "radius",
                f"With wheel.radius of the setup halved to {half:g} m",
                "expected the radius, not the diameter",
                there=dataclasses.replace(setup, wheel=wheel),
            )
    return out


@dataclass(frozen=True, eq=False)
class _Fit:
    """A reading, fitted."""

    reading: Reading
    problem: TableProblem
    u: np.ndarray
    cost: float  # squares of residuals and unknowns
    rms: float  # [noise]

    @cached_property
    def evidence(self) -> float:
        """Logarithm of the evidence."""
        return float(logsumexp(self.problem.evidence(self.u)[0]))


def _plain(table: Table, setup: Setup) -> Reading:
    return Reading("", "", "", table, setup, np.ones(3))


def _problem(
    reading: Reading, sd: np.ndarray, used: np.ndarray | None, scarce: bool = True
) -> TableProblem:
    """The reading under a noise [3] of the channels, of the values `used` [N, 3]; fewer values than
    unknowns are refused unless `scarce`: the priors are enough to compare readings and rows.
    """
    there = reading.table
    order = list(reading.source)
    if used is not None:
        values: dict[str, Any] = {
            name: np.where(used[:, order[j]], getattr(there, name), math.nan)
            for j, name in enumerate(CHANNELS)
        }
        there = dataclasses.replace(there, **values)
    levels = {
        name: float(sd[order[j]] * reading.scale[j])
        if np.any(np.isfinite(getattr(there, name)))
        else None
        for j, name in enumerate(CHANNELS)
    }
    noise = dataclasses.replace(reading.setup.noise, **levels)
    setup = dataclasses.replace(reading.setup, noise=noise)
    return TableProblem(there, setup, np.ones(len(there), dtype=bool), scarce=scarce)


def _fit(
    reading: Reading,
    sd: np.ndarray,
    used: np.ndarray | None = None,
    start: np.ndarray | None = None,
    search: bool = False,
) -> _Fit:
    """The reading, fitted from `start` or the prior mean, or by a search."""
    problem = _problem(reading, sd, used)
    u = np.zeros(len(problem.unknowns)) if start is None else start
    if search:
        u = problem.search()
    for _ in range(CORRECTIONS if np.any(problem.noise[:2] > 0.0) else 1):
        problem.correct(u)
        u, cost = problem.minimise(u, **COARSE)
    e = problem.by_noise(problem.residual(u))[problem.measured.ravel()]
    return _Fit(reading, problem, u, cost, math.sqrt(float(np.mean(e**2))))


def _noise(data: Data, fit: _Fit) -> NoiseEstimate:
    """Noise about the surface of a fit, read as the table is; a rough one where the values do not
    show it.
    """

    def surface(rows: Rows) -> np.ndarray:
        model = np.zeros_like(data.y)
        found = fit.problem.steady(fit.u, rows) / fit.reading.scale
        model[:, list(fit.reading.source)] = finite(found)
        if fit.reading.name == "pull":
            model[:, 1] *= -1.0
        return model

    model = surface(fit.problem.rows)
    try:
        found = find_noise(data, model)
        if fit.reading.name:  # its slip may be another
            return found
        wide = with_noise_of_conditions(data, surface)[0]
        return (
            found if wide is data else dataclasses.replace(found, used=find_noise(wide, model).used)
        )
    except ParameterError:
        alone = np.zeros(len(model), dtype=bool)
        return NoiseEstimate(_rough(data), np.full(3, math.inf), ("",) * 3, data.measured, alone)


def _rough(data: Data, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
    """[3] noise of the channels before it is known, of some `rows` [N] or of all."""
    out = np.full(len(CHANNELS), ROUGH)
    for j, name in enumerate(CHANNELS):
        known = data.table.channel_sd(data.setup, name)
        y = data.y[rows, j]
        y = y[np.isfinite(y)]
        if known is not None:
            out[j] = known
        elif y.size:
            out[j] = max(ROUGH * float(np.std(y)), 1e-12)
    return out


class Better(NamedTuple):
    """A reading that explains the table better."""

    reading: Reading
    gain: float  # of the logarithm of the evidence
    rms: float
    rms_before: float
    by_rises: float = 0.0  # share of the gain that is not the model's

    @property
    def sure(self) -> bool:
        """True if it is to be told."""
        fits = self.rms < self.rms_before and (
            self.by_rises > 0.0 or BETTER * (self.rms**2 - 1.0) < self.rms_before**2 - 1.0
        )
        return self.by_rises > ALONE or (self.gain > SURE and (fits or self.by_rises > WITH))

    @property
    def words(self) -> str:
        """How the table is read, and by how much that is better."""
        if self.rms >= self.rms_before:
            return f"{self.reading.words}, the forces change with slip as on soils"
        return (
            f"{self.reading.words}, the base model misses the table by {self.rms:.2g} times the "
            f"noise instead of {self.rms_before:.2g}"
        )


class _AsIs(NamedTuple):
    """A table read as it is: its noise, and its fit under that."""

    data: Data
    noise: NoiseEstimate
    fit: _Fit

    @property
    def suspect(self) -> bool:
        """True if another reading could be better by `SURE`."""
        return self.fit.cost - int(self.fit.problem.measured.sum()) > 2.0 * SURE


def _as_is(data: Data) -> _AsIs:
    plain = _plain(data.table, data.setup)
    rough = _fit(plain, _rough(data))
    noise = _noise(data, rough)
    return _AsIs(data, noise, _fit(plain, noise.sd, noise.used, rough.u))


def _other_readings(start: _AsIs) -> list[Better]:
    """The readings by their gain, the best first; none where the table as it is leaves nothing to
    gain.
    """
    data, noise, first = start
    plain = first.reading
    rough = _rough(data)
    others = readings(data.table, data.setup)
    rises = _rises(data, noise)
    by_rises = {other.name: _by_rises(rises, data, other) for other in others}
    held = _by_resistance(data, noise, plain)
    by_resistance = {o.name: _by_resistance(data, noise, o) - held for o in others}
    if not start.suspect and max(by_rises.values(), default=0.0) < ALONE:
        return []
    at = {other.name: _fit(other, rough) for other in others}
    # A wrong reading leaves more about its surface.
    noises = [_noise(data, fit) for name, fit in at.items() if name != "columns"]
    noise = min(noise, *noises, key=lambda there: np.sum(np.log(there.sd)))
    base = first if noise is start.noise else _fit(plain, noise.sd, noise.used, first.u)
    fits = [_fit(other, noise.sd, noise.used, at[other.name].u) for other in others]
    if max(f.evidence for f in fits) - base.evidence > MAYBE:
        searched = _fit(plain, noise.sd, noise.used, search=True)
        base = max(base, searched, key=lambda f: f.evidence)
    found = [
        Better(f.reading, f.evidence - base.evidence + more + held_back, f.rms, base.rms, more)
        for f, more, held_back in zip(fits, by_rises.values(), by_resistance.values(), strict=True)
    ]
    return sorted(found, key=lambda f: -f.gain)


def _rises(data: Data, noise: NoiseEstimate) -> np.ndarray:
    """[2] change with slip of pull and torque/radius over the load, in the middle of the groups;
    negative where they fall, nan where not known.
    """
    forces = data.y[:, 1:] / data.rows.load[:, None]
    forces[:, 1] /= data.rows.wheels[:, 0]
    whole = np.all(noise.used[:, 1:] | ~data.measured[:, 1:], axis=1)
    groups = [forces[rows] for rows in _from_low_slip(data, whole)] or [np.full((1, 2), math.nan)]
    size = np.median([np.ptp(y, axis=0) for y in groups], axis=0)
    size[size == 0.0] = math.nan  # of a wheel that climbs freely
    return np.copysign(size, np.median([y[-1] - y[0] for y in groups], axis=0))


def _by_rises(rises: np.ndarray, data: Data, other: Reading) -> float:
    """Gain of the logarithm of the evidence by the rises of the forces; -inf where these
    contradict it, as a turned sign where the pull rises.
    """
    scale = other.scale[1:] * data.table.load[0] / other.table.load[0]
    scale[1] *= data.setup.wheel.radius / other.setup.wheel.radius
    gain = _of_soils(scale * rises) - _of_soils(rises)
    turned = other.name in ("pull", "slip") and rises[0] > 0.0
    return -math.inf if turned or gain < UNLIKE else gain


def _of_soils(rises: np.ndarray) -> float:
    """Logarithm of the probability of the `rises` [2], but for a constant."""
    pull, torque = np.log(np.abs(rises))
    off = (np.array([torque if math.isnan(pull) else pull, pull - torque]) - CENTRE) / SCALE
    return -0.5 * float(np.nansum((FREEDOM + 1.0) * np.log1p(off**2 / FREEDOM)))


def _by_resistance(data: Data, noise: NoiseEstimate, reading: Reading) -> float:
    """Logarithm of the probability, but for a constant, of what soil holds the wheel back by as the
    table is read; 0 where it has not all three channels.

    The vertical stress over the arc of contact holds back with about W/2 times the sine of its
    entry, sqrt(2 z/r): torque/radius less the pull is that share of the load, at any slip.
    """
    table = reading.table
    radius = table.radius(reading.setup.wheel)
    level = np.abs(data.rows.conditions[:, 2]) < LEVEL
    rows = np.all(noise.used, axis=1) & (data.rows.slip > LOW_SLIP) & level & (table.sinkage > 0.0)
    if rows.sum() < FEWEST_ROWS or reading.name in ("slip", "slip_ratio"):
        return 0.0
    share = (table.torque / radius - table.drawbar_pull) / table.load
    root = np.sqrt(np.maximum(table.sinkage, 0.0) / radius)
    off = float(np.median((share - HELD * root)[rows])) / HELD_SD
    freedom = LESS_FREEDOM if off < 0.0 else MORE_FREEDOM
    return -0.5 * (freedom + 1.0) * math.log1p(off**2 / freedom)


class Examined(NamedTuple):
    """A table that was examined."""

    table: Table  # without wrong rows
    said: tuple[str, ...] = ()  # what to check first; none as a rule
    #: Of the rows that are left: [N, 3] values that are no outliers, and the noise; None for a
    #: table that is taken as it is.
    noise: NoiseEstimate | None = None
    left_out: tuple[str, ...] = ()  # rows and values that are left out, in words
    undecided: tuple[str, ...] = ()  # readings that could be meant as well

    @contextmanager
    def named_first(self) -> Iterator[None]:
        """Put the rows that were left out before a refusal of the rest."""
        try:
            yield
        except ParameterError as error:
            if not self.left_out:
                raise
            wrong = " ".join(self.left_out)
            source = f"{self.table.source}: "
            rest = str(error).removeprefix(source)
            raise ParameterError(f"{source}{wrong} Without that: {rest}") from None


@threadpool_limits.wrap(1)  # the matrices are small
def examine(table: Table, setup: Setup) -> Examined:
    """Doubts about a table, most certain first, and the table without the rows that are wrong.

    Raises `ParameterError` where the table cannot be right: it is far better read otherwise, and as
    it is it breaks a physical limit.
    """
    data = prepare(table, setup)
    given_noise(data)  # refuses one that leaves no digits
    _problem(_plain(table, setup), _rough(data), None, scarce=False)  # refuses too few values
    always = [*setup.doubts(), *_grades_doubted(data)]
    dead = _channels_doubted(data)
    if dead:  # what else could be read into such a table says nothing
        return Examined(table, (*dead, *always), _as_is(data).noise)
    start, rows = _without_wrong_rows(_as_is(data))
    cells, gross = _outliers(start.data, start.noise)
    readings_doubted, undecided = _readings_doubted(start)
    first = [*rows, *_load_alone(start.data.table), *gross, *readings_doubted]
    if not first and (load := load_doubt(start.data.table, setup)):
        first = [load]
    said = (*first, *always)
    return Examined(start.data.table, said, start.noise, (*rows, *cells), undecided)


def _readings_doubted(start: _AsIs) -> tuple[list[str], tuple[str, ...]]:
    """A doubt where another reading explains the table far better, or where the pull falls with
    slip and fits no worse with its sign turned; and a caution where one explains it a little
    better.
    """
    others = _other_readings(start)
    possible = [b for b in others if b.gain > MAYBE and b.rms < b.rms_before]
    better = [b for b in others if b.sure]
    data, noise, _ = start
    if better:
        best = better[0]
        probable = f" ({_sure(best.gain)})" if best.gain > SURE else ""
        text = f"{best.words}{probable}: {best.reading.remedy}"
        check = {
            "pull": _pull_falls,
            "load": lambda *_: load_doubt(data.table, data.setup).partition(":")[0],
            "torque_kg": _gains_power,
            "radius": _gains_power,
        }.get(best.reading.name)
        if check is not None and (broken := check(data, noise)):
            raise ParameterError(f"{data.table.source}: {broken}; {text[:1].lower()}{text[1:]}")
        near = [b.reading.words for b in better[1:] if best.gain - b.gain < -UNUSUAL / 2.0]
        also = f" {'; '.join(near)} it fits nearly as well." if near else ""
        return [f"{text}.{also}"], ()
    undecided = tuple(
        f"{b.words}: the table could be meant so ({b.reading.remedy})." for b in possible[:1]
    )
    turned = any(b.reading.name == "pull" and b.gain > 0.0 for b in others)
    if turned and (falls := _pull_falls(data, noise)):
        said = f"{falls}: check the sign of drawbar_pull (positive = the wheel pulls)."
        return [said], undecided
    if more := _gains_power(data, noise) or _outpulls_the_rim(data, noise):
        said = f"{more}: check the units of torque and drawbar_pull, and the wheel's radius."
        return [said], undecided
    return [], undecided


def _sure(gain: float) -> str:
    """Probability of a mistake in words, from the gain of the evidence."""
    probability = expit(gain + UNUSUAL)
    return (
        "probability above 99.9 %"
        if probability > 0.999
        else f"probability {100.0 * probability:.3g} %"
    )


def _without_wrong_rows(start: _AsIs) -> tuple[_AsIs, list[str]]:
    """The table without rows that contradict all others, and what is said of these."""
    said = []
    for _ in range(max(1, int(MOST_WRONG * len(start.data.table)))):
        found = _wrong_row(start)
        if found is None:
            break
        start, words = found
        said.append(words)
    return start, said


def _wrong_row(start: _AsIs) -> tuple[_AsIs, str] | None:
    """The table without the row whose loss helps the fit most, and words on it, if the others then
    agree.
    """
    data, noise, fit = start
    hidden = "scatter" in noise.origin or not any(noise.origin)  # a wrong row is in the noise too
    if len(data.table) <= FEWEST_ROWS or not (start.suspect or hidden):
        return None
    problem = fit.problem
    robust = problem.minimise(fit.u, loss="cauchy", f_scale=CLEAR, **COARSE)[0]
    e = np.where(problem.measured, problem.by_noise(problem.residual(robust)).reshape(-1, 3), 0.0)
    square = np.sum(e**2, axis=1) / np.maximum(problem.measured.sum(axis=1), 1)
    slip = data.table.slip
    load = data.table.load
    # A row far from the others draws the fit to itself.
    ends = [np.argmin(slip), np.argmax(slip), np.argmin(load), np.argmax(load)]
    rows = np.arange(len(slip))
    sd = noise.sd
    if hidden:
        # That of the values without a wrong one, whichever it is.
        sd = np.min([sd, *(_rough(data, rows != row) for row in rows)], axis=0)

    def left(row: int) -> float:
        """Mean cost of a value without the row."""
        there = _plain(data.table.only(rows != row), data.setup)
        try:
            found = _fit(there, sd, np.delete(data.measured, row, axis=0))
        except ParameterError:
            return math.inf
        return found.cost / int(found.problem.measured.sum())

    few = rows if len(rows) <= SMALL else np.argsort(-square)[:2]
    worst = min({int(k) for k in (*few, *ends)}, key=left)
    kept = rows != worst
    # A deviation that the others at its slip share is no mistake of one row.
    level = data.varied["slip"].level
    channel = int(np.argmax(np.abs(e[worst])))
    beside = e[kept & (level == level[worst]) & data.measured[:, channel], channel]
    if beside.size > 1 and np.median(beside) / e[worst, channel] > SHARED:
        return None
    try:
        rest = _as_is(prepare(data.table.only(kept), data.setup))
    except ParameterError:  # too little is left
        return None
    if _goes_on(data, worst, rest):
        return None
    sd = rest.noise.sd
    used = np.insert(rest.noise.used, worst, data.measured[worst], axis=0)
    before = _fit(fit.reading, sd, used)
    gain = rest.fit.evidence - before.evidence - math.log(len(data.table))
    least = GROSS if hidden and len(rows) <= SMALL else WRONG
    words = _words_on(data, worst, rest.fit, sd, gain, least)
    return (rest, words) if words else None


def _goes_on(data: Data, row: int, rest: _AsIs) -> bool:
    """True if the line through the two rows next to it in slip leads to a row that is off the fit
    to the others: the model misses what grows with slip.
    """
    (group,) = (rows for rows in data.groups if row in rows)
    model = rest.fit.problem.steady(rest.fit.u, data.rows)[row]
    off = (data.y[row] - model) / rest.noise.sd
    if not np.any(np.isfinite(off)):
        return False
    channel = int(np.nanargmax(np.abs(off)))
    others = group[(group != row) & data.measured[group, channel]]
    slip = data.rows.slip
    near = others[np.argsort(np.abs(slip[others] - slip[row]))[:2]]
    if near.size < 2 or np.ptp(slip[near]) == 0.0:
        return False
    values = data.y[:, channel]
    line = np.polyval(np.polyfit(slip[near], values[near], 1), slip[row])
    return bool(abs(values[row] - line) < SHARED * abs(values[row] - model[channel]))


def _words_on(data: Data, row: int, others: _Fit, sd: np.ndarray, gain: float, least: float) -> str:
    """Words on a wrong row: which of its cells is wrong by the fit to the other rows; "" where it
    is off them by less than `least` [noise and law error], or the `gain` of the others' evidence
    without it does not pay for what is wrong: a value that may be anywhere, or all of them.
    """
    table = data.table
    here = Rows(*(column[row : row + 1] for column in data.rows))
    known = data.measured[row]
    y = data.y[row, known]
    noise = (sd * np.broadcast_to(data.relative_sd, data.y.shape)[row])[known]
    size = np.sqrt(np.nansum(data.y**2, axis=0) / len(table))[known]  # a pull may be 0
    allowed = np.sqrt(noise**2 + LAW_ERROR**2 * np.maximum(y**2, size**2))
    spread = BROAD * np.max(np.abs(np.nan_to_num(data.y)), axis=0)[known]

    def residuals(name: str, values: np.ndarray) -> np.ndarray:
        """[G, M] of the row at other values of slip or load."""
        many = Rows(*(np.repeat(column, values.size, axis=0) for column in here))
        out = others.problem.steady(others.u, many._replace(**{name: values}))[:, known]
        return np.where(np.isfinite(out), (y - out) / allowed, NO_VALUE)

    off = np.abs(residuals("load", here.load)[0])
    if np.max(off) < least:
        return ""
    grids = {
        "load": here.load[0] * np.geomspace(0.01, 100.0, 401),
        "slip": np.linspace(-0.95, 0.95, 191),
    }
    fits = {name: np.sqrt(np.mean(residuals(name, x) ** 2, axis=1)) for name, x in grids.items()}
    best = min(fits, key=lambda name: float(np.min(fits[name])))
    names = np.array(CHANNELS)[known]
    free = np.ones(len(names), dtype=bool)  # of the values, by what is wrong
    if len(names) > 2 and np.sum(off > CLEAR) == 1:
        name = names[int(np.argmax(off))]
        check = f"check {name} = {getattr(table, name)[row]:g} there."
        free = off > CLEAR
    elif len(names) < 2 or np.min(fits[best]) > CLEAR:
        check = "check slip, load and values there."
    else:
        value = float(f"{grids[best][int(np.argmin(fits[best]))]:.2g}")
        unit = " N" if best == "load" else ""
        check = (
            f"its values are those of a {best} of {value:g}{unit}, check {best} = "
            f"{getattr(table, best)[row]:g}{unit} there."
        )
        free = np.arange(len(names)) == np.argmax(spread / allowed)
        off = residuals(best, np.array([value]))[0]
    gain -= float(
        np.sum(np.where(free, np.log(spread / noise), np.log(allowed / noise) + 0.5 * off**2))
    )
    if gain < SURE:
        return ""
    return (
        f"Row {table.row[row]} (slip {table.slip[row]:g}, load {table.load[row]:g} N) contradicts "
        f"all others ({_sure(gain)}) and is left out: {check}"
    )


def _outliers(data: Data, noise: NoiseEstimate) -> tuple[list[str], list[str]]:
    """Words on the values that leave the surface through the others, and on those among them that
    are to be checked first.
    """
    cells = []
    gross = []
    for k, j in np.argwhere(data.measured & ~noise.used):
        others = data.y[noise.used[:, j], j]
        words = (
            f"Row {data.table.row[k]}, {CHANNELS[j]} = {data.y[k, j]:g}, leaves the surface "
            "through the other values and is left out."
        )
        cells.append(words)
        span = float(np.ptp(others)) if others.size >= FEWEST_ROWS else math.inf
        if np.min(np.abs(data.y[k, j] - others), initial=math.inf) > LONE * span:
            gross.append(words)
    return cells, gross


def _load_alone(table: Table) -> list[str]:
    """A doubt where one row has a load far from that of all others, which are alike: nothing in the
    table can check it.
    """
    order = np.argsort(table.load)
    load = table.load[order]
    if len(load) <= FEWEST_ROWS:
        return []
    for row, others, times in (
        (order[-1], load[:-1], load[-1] / load[-2]),
        (order[0], load[1:], load[0] / load[1]),
    ):
        if others[-1] < ALIKE * others[0] and not 1.0 / APART < times < APART:
            return [
                f"Row {table.row[row]}, load = {table.load[row]:g} N, is {times:.2g} times that of "
                "any other row: check it there."
            ]
    return []


def _grades_doubted(data: Data) -> list[str]:
    """A doubt where the only grade of the table is that of whole degrees in radians."""
    grades = data.table.grade_deg[data.table.grade_deg != 0.0]
    if not look_like_radians([repr(float(g)) for g in grades]):
        return []
    angle = math.degrees(abs(float(grades[0])))
    return [f"grade_deg = {abs(grades[0]):g} is {angle:.0f} degrees in radians: expected degrees."]


def _channels_doubted(data: Data) -> list[str]:
    """Doubts of channels that hold one value at all slips, or forces that are far too small for
    newtons.
    """
    out = []
    # A wheel that climbs freely pulls nothing.
    free = data.setup.load == "vertical" or "grade_deg" in data.varied
    size = data.rows.load * data.rows.wheels[:, 0]
    for j, name, unit, over in (
        (0, "sinkage", "", data.rows.wheels[:, 0]),
        (1, "drawbar_pull", "newtons", data.rows.load),
        (2, "torque", "newton metres", size),
    ):
        known = data.measured[:, j]
        y = data.y[known, j]
        slips = data.rows.slip[known]
        if y.size < 4 or np.ptp(slips) < LEAST_SPAN or (j == 1 and free and not np.any(y)):
            continue
        largest = float(np.max(np.abs(y) / over[known]))
        if np.ptp(y) == 0.0:
            out.append(
                f"{name} is {y[0]:g} in every row: expected measured values, which change with "
                "slip."
            )
        elif unit and largest < WEAK:
            against = "the load" if j == 1 else "load times radius"
            out.append(
                f"{name} is at most {largest:.2g} times {against}: expected {unit} (if it is "
                f"kilo{unit}, times 1000)."
            )
    return out


def _from_low_slip(data: Data, used: np.ndarray) -> Iterator[np.ndarray]:
    """The rows that are `used` [N], by slip, of each group that begins at low slip."""
    for rows in data.groups:
        rows = rows[used[rows]]
        slip = data.rows.slip[rows]
        if rows.size > 2 and -0.05 <= slip.min() <= LOW_SLIP and np.ptp(slip) >= LEAST_SPAN:
            yield rows[np.argsort(slip)]


def _pull_falls(data: Data, noise: NoiseEstimate) -> str:
    """The drawbar pull falls with slip from low slip on, below 0 at much slip, in nearly all groups
    of rows.
    """
    falls = []
    ends = []
    for rows in _from_low_slip(data, noise.used[:, 1]):
        pull = data.y[rows, 1]
        slip = data.rows.slip[rows]
        slope = np.polyfit(slip, pull, 1)[0]
        falls.append(slope * np.ptp(slip) < -3.0 * noise.sd[1] and pull[-1] < min(pull[0], 0.0))
        ends.append(pull[[0, -1]])
    if not falls or np.mean(falls) < FALLS:
        return ""
    where = (
        "in every group of rows"
        if all(falls)
        else f"in {100.0 * np.mean(falls):.0f} % of the groups of rows"
    )
    first, last = np.median(ends, axis=0)
    return (
        f"drawbar_pull falls with slip {where} that differ in slip alone, from "
        f"{first:.3g} N at the least to {last:.3g} N at the largest slip"
    )


def _gains_power(data: Data, noise: NoiseEstimate) -> str:
    """The driven wheel pulls with more power than its axle takes, whatever the soil: DP V > T w."""
    return _over_the_axle(
        data,
        noise,
        1.0 - data.rows.slip,
        "drawbar_pull times travel speed is {:.2g} times torque times rotational speed in the "
        "middle of the rows, and no wheel gains power",
    )


def _outpulls_the_rim(data: Data, noise: NoiseEstimate) -> str:
    """The driven wheel pulls with more than its torque brings to the rim, as if the normal stress
    pushed it forward: DP > T/r.
    """
    return _over_the_axle(
        data,
        noise,
        np.ones_like(data.rows.slip),
        "drawbar_pull is {:.2g} times torque over radius in the middle of the rows, and soil holds "
        "a driven wheel back",
    )


def _over_the_axle(data: Data, noise: NoiseEstimate, speed: np.ndarray, words: str) -> str:
    """`words` with DP `speed`/(T/r) in the middle of the driven rows on the level, where that is
    beyond noise and gains; `speed` [N] as a share of that of the rim.
    """
    level = np.abs(data.rows.conditions[:, 2]) < LEVEL
    both = noise.used[:, 1] & noise.used[:, 2] & (data.rows.slip > 0.0) & level
    radius = data.rows.wheels[:, 0]
    taken = data.y[:, 2] / radius
    given = data.y[:, 1] * speed
    sd = np.hypot(noise.sd[2] / radius, noise.sd[1] * speed)
    gain = (given - GAINED * taken - SURE_GAIN * sd)[both]
    if gain.size < 3 or np.median(gain) <= 0.0 or np.median(taken[both]) <= 0.0:
        return ""
    return words.format(np.median((given / taken)[both]))
