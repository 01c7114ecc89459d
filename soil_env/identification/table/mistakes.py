"""Mistakes in a table: a unit, sign or convention of a column, the diameter for the radius, a wrong
row.

Each is another reading of the table. Readings are compared by their evidence under the base model
whose laws may err (`form_error`): a mistake is told where another reading explains the table far
better. What only an effect that the base model lacks would explain is no mistake, since every
reading may err by so much. The noise is that of a smooth surface (`noise`), so that a
table that no reading fits is not compared by its misfit.

Drawbar pull and torque/radius rise with slip by what soil can bear, and both by about the same:
their difference is the resistance, which changes little. This is evidence beside that of the
model, since a large error of its laws could take up a factor of the unit.
"""

import dataclasses
import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy.special import expit, logsumexp
from threadpoolctl import threadpool_limits

from soil_env._io.loading import ParameterError
from soil_env.measurement.doubts import load_doubt
from soil_env.measurement.setup import Calibration, Setup
from soil_env.measurement.table import Table, look_like_radians
from soil_env.parameters import EARTH_GRAVITY
from soil_env.terramechanics.model import Rows

from .calibration import EXACT
from .data import CHANNELS, Data, prepare
from .form_error import finite
from .noise import (
    NoiseEstimate,
    find_noise,
    given_noise,
    rough_noise,
    with_noise_of_conditions,
)
from .problem import COARSE, NO_VALUE, TableProblem

UNUSUAL = math.log(1e-3)  # log of the prior probability of a mistake of one kind
# Evidence for another reading, or for a wrong row, is over that of the table as it is.
SURE = 8.5  # log of the evidence for another reading, from which it is told
LESS = 0.97  # times the misfit of the table as it is, below which a reading is a possible one
MAYBE = 4.5  # log of the evidence, from which another reading is mentioned as a possible one
#: Factor, at least, by which a reading that is told reduces the mean square misfit above the noise.
BETTER = 1.5
FITS = 4  # of a reading; slip and load that have noise are corrected between them
FEWEST_ROWS = 3  # that have to agree against a wrong one
SMALL = 8  # rows up to which a table is small: every row is tried as the wrong one
CANDIDATES = 2  # rows of a larger table that are tried, those furthest off a robust fit; own choice
#: Share of a row's deviation: others at its slip that deviate by more excuse it (`_is_shared`), and
#: so does a trend of its neighbours that it leaves by less (`_goes_on`).
SHARED = 0.5
MOST_WRONG = 0.04  # share of the rows that may be wrong, but one may always be
ALIKE = 1.5  # largest over least load of rows whose loads are alike
APART = 5.0  # ratio of a load to the nearest of these, from which it stands alone
#: Distance of an outlier from every other value, over the range of these, above which it is told
#: first.
LONE = 1.0
CLEAR = 3.0  # [noise and law error] within which a row fits with another load or slip
WRONG = 4.0  # [noise and law error] from which a row is wrong
GROSS = 6.0  # the same in a small table whose noise is not known
LAW_ERROR = 0.1  # relative error of the laws in the unit of `CLEAR`, `WRONG` and `GROSS`
# Values tried in place of a wrong load or slip: least, largest, number. Own choices.
LOADS_TRIED = (0.01, 100.0, 401)  # over the load in the table
SLIPS_TRIED = (-0.95, 0.95, 191)
LEAST_RADIUS = 0.01  # [m] of a wheel in a setup: none is halved below it
CERTAIN = 0.999  # probability from which words give no number
#: Student's t distributions [2] of two logarithms: of the rise of a force with slip over the load,
#: and of the rise of the pull over that of torque/radius. Fitted to 2000 tables of
#: `benchmarks.sound_tables` (seed 5001).
FREEDOM = np.array([5.0, 1.5])
CENTRE = np.log([0.19, 1.0])
SCALE = np.array([0.385, 0.106])
#: Usual resistance over the load, as a multiple of sqrt(sinkage/radius), and the scale of its
#: Student's t distribution. Fitted to 800 tables of `benchmarks.sound_tables` (seed 9001).
HELD = 0.72
HELD_SD = 0.056
LESS_FREEDOM = 8.0  # degrees of freedom of that distribution below the usual resistance
MORE_FREEDOM = 2.0  # and above it
NONE_HELD = 5.0  # [`HELD_SD`] usual resistance from which a table that shows none is doubted
MOST_HELD = 0.1  # of the usual resistance, up to which a table shows none
ALONE = 4.5  # log of the evidence by rises, from which a reading is told whatever the model says
#: Log of the evidence by rises, from which a reading of enough evidence is told although it misses
#: the table by more noise. An effect that is missing can do that.
WITH = 3.0
UNLIKE = -2.5  # log of the evidence by rises, below which a reading is out of the question
FALLS = 0.8  # share of the groups of rows in which the pull has to fall with slip to be doubted
FALL_SD = 3.0  # [noise] by which the pull of a group has to fall; own choice
# slip up to which a group must begin for a rise or fall to say anything, and from which a row
# counts for the resistance to the wheel
LOW_SLIP = 0.2
LOWEST_SLIP = -0.05  # slip from which it must begin, so that it is not of a braked wheel
LEAST_SPAN = 0.15  # least range of its slips, for the same
FEWEST_VALUES = 4  # of a channel, from which it can be found constant or too weak
#: Largest force of a table over the load, below which its unit is another: rolling takes more.
WEAK = 2e-3
LEVEL = 0.02  # sine of the grade below which the weight neither takes nor gives power
GAINED = 1.1  # times the power or force at the axle, beyond which no error of a gain explains it
SURE_GAIN = 3.0  # [noise] by which power or force must also exceed that at the axle
BROAD = 3.0  # times the largest value of a channel, within which a wrong one may be anywhere


class Reading(NamedTuple):
    """The table read otherwise."""

    name: str  # "" for the table as it is
    words: str  # "With ...", in a sentence
    remedy: str  # what was expected in the table
    table: Table
    setup: Setup
    scale: np.ndarray  # [3] factor on each channel of the table as it is
    source: tuple[int, ...] = (0, 1, 2)  # channel of the table as it is that each one is taken from


def readings(table: Table, setup: Setup) -> list[Reading]:
    """Every other reading of the table that is tried.

    They are: the sign of pull or slip turned; pull and torque exchanged; pull, torque, load, or
    load with pull, read in kilograms; torque also in kilogram centimetres; the slip read as
    (r w - V)/V or V/(r w); the radius read as the diameter.

    A reading is left out where the table cannot show it, or where it would be impossible.
    """
    out = []
    has_pull = np.isfinite(table.drawbar_pull).any()
    has_torque = np.isfinite(table.torque).any()

    def add(
        name: str,
        words: str,
        remedy: str,
        scale=(1.0, 1.0, 1.0),
        source=(0, 1, 2),
        there: Setup = setup,
        **columns,
    ) -> None:
        """Add a reading with other `columns` and the setup `there`; the rest as in `Reading`.

        Noise of single rows is scaled, too.
        """
        for channel, k, factor in zip(CHANNELS, source, scale, strict=True):
            columns[f"{channel}_sd"] = factor * getattr(table, f"{CHANNELS[k]}_sd")
        otherwise = dataclasses.replace(table, **columns)
        out.append(Reading(name, words, remedy, otherwise, there, np.array(scale), source))

    if has_pull:
        add(
            "pull",
            "With the sign of drawbar_pull turned",
            "expected drawbar_pull positive where the wheel pulls",
            drawbar_pull=-table.drawbar_pull,
        )
    if has_pull and has_torque:
        add(
            "columns",
            "With the columns of drawbar_pull and torque exchanged",
            "expected drawbar_pull in newtons and torque in newton metres, each in its own column",
            source=(0, 2, 1),
            drawbar_pull=table.torque,
            torque=table.drawbar_pull,
        )
    torque = ("torque",)
    for name, columns, unit, factor, expected in (
        ("pull_kg", ("drawbar_pull",), "kilograms", EARTH_GRAVITY, "newtons"),
        ("torque_kg", torque, "kilogram metres", EARTH_GRAVITY, "newton metres"),
        ("torque_kg_cm", torque, "kilogram centimetres", 0.01 * EARTH_GRAVITY, "newton metres"),
        ("load", ("load",), "kilograms", EARTH_GRAVITY, "newtons"),
        ("forces", ("load", "drawbar_pull"), "kilograms", EARTH_GRAVITY, "newtons"),
    ):
        # Two forces that are wrong alike show only beside the torque. Zeros are the same in every
        # unit, and so leave nothing but a larger noise.
        needed = columns if len(columns) == 1 else (*columns, "torque")
        if all(np.nansum(np.abs(getattr(table, column))) > 0.0 for column in needed):
            both = " and ".join(columns)
            add(
                name,
                f"With {both} as {unit} (times {factor:g})",
                f"expected {both} in {expected}",
                [factor if channel in columns else 1.0 for channel in CHANNELS],
                **{column: factor * getattr(table, column) for column in columns},
            )
    if has_pull or has_torque:  # sinkage alone may rise or fall with slip
        slip = table.slip
        add(
            "slip",
            "With the sign of slip turned",
            "expected slip positive where the wheel drives",
            slip=-slip,
        )
        add(
            "slip_travel",
            "With slip as (r w - V)/V (divided by 1 + itself)",
            "expected slip as (r w - V)/(r w) where the wheel drives",
            slip=slip / (1.0 + np.maximum(slip, 0.0)),
        )
        begins = np.min(np.abs(slip)) <= LOW_SLIP
        # A rig begins at low slip: a table that does is not read as one that does not.
        if np.all(slip >= 0.0) and (not begins or np.max(slip) >= 1.0 - LOW_SLIP):
            add(
                "slip_ratio",
                "With slip as V/(r w) (1 less itself)",
                "expected slip as 1 - V/(r w)",
                slip=1.0 - slip,
            )
    half = 0.5 * setup.wheel.radius
    if not np.any(np.isfinite(table.wheel_radius)) and half >= LEAST_RADIUS:
        # a sinkage or lugs beyond the halved radius make it impossible
        if not np.any(table.sinkage > half) and (setup.wheel.grouser_height or 0.0) < half:
            add(
                "radius",
                f"With wheel.radius of the setup halved to {half:g} m",
                "expected the radius, not the diameter",
                there=setup.changed(wheel=dataclasses.replace(setup.wheel, radius=half)),
            )
    return out


@dataclass(frozen=True, eq=False)
class _Fit:
    """A reading of the table and its most probable soil."""

    reading: Reading
    problem: TableProblem
    u: np.ndarray  # [p] whitened unknowns
    cost: float  # sum of the squares of residuals over their noise, and of u
    rms: float  # root mean square of these residuals

    @cached_property
    def evidence(self) -> float:
        """Logarithm of the evidence over all sizes of the laws' error."""
        return logsumexp(self.problem.evidence(self.u)[0])


def _plain(table: Table, setup: Setup) -> Reading:
    """The table read as it is."""
    return Reading("", "", "", table, setup, np.ones(3))


def _problem(
    reading: Reading, sd: np.ndarray, used: np.ndarray, scarce: bool = True
) -> TableProblem:
    """The least-squares problem of a reading, with the noise `sd` [3] and the values `used` [N, 3].
    Both are of the channels of the table as it is, in its units.

    Fewer values than unknowns are refused unless `scarce`: the priors are enough to compare
    readings and rows. A rig whose calibration is not stated counts as exact: mistakes are far
    larger than its usual errors.
    """
    order = list(reading.source)
    there = reading.table.with_values(used[:, order])
    # No noise of a channel without values, whose `sd` is no level.
    levels = {
        name: float(sd[order[j]] * reading.scale[j])
        if np.any(np.isfinite(getattr(there, name)))
        else None
        for j, name in enumerate(CHANNELS)
    }
    noise = dataclasses.replace(reading.setup.noise, **levels)
    stated = reading.setup.calibration
    setup = reading.setup.changed(
        noise=noise, calibration=EXACT if stated == Calibration() else stated
    )
    # all rows: `usable_rows` would refuse some readings
    return TableProblem(there, setup, np.ones(len(there), bool), scarce=scarce)


def _fit(
    reading: Reading,
    sd: np.ndarray,
    used: np.ndarray,
    start: np.ndarray | None = None,
    search: bool = False,
) -> _Fit:
    """Fit of a reading with noise and without errors of the laws: from `start`, else from the prior
    mean, or by a `search` from several starts, which leaves out `start`.

    `sd` and `used` as in `_problem`. Slip and load that have noise are corrected between fits.
    """
    problem = _problem(reading, sd, used)
    if search:
        u = problem.search()
    else:
        u = np.zeros(len(problem.unknowns)) if start is None else start
    for _ in range(FITS if np.any(problem.noise[:2] > 0.0) else 1):
        problem.correct(u)
        u, cost = problem.minimise(u, **COARSE)
    e = problem.by_noise(problem.residual(u))[problem.measured.ravel()]
    return _Fit(reading, problem, u, cost, math.sqrt(np.mean(e**2)))


def _noise(data: Data, fit: _Fit) -> NoiseEstimate:
    """Noise of the channels of the table as it is, about the surface of the `fit` of any reading.

    For the table as it is, a given noise of slip and load lets values lie further off before they
    are outliers, but does not enter the noise. Where the values do not show their noise it is
    `rough_noise`, and all values are used.
    """
    reading = fit.reading

    def surface(rows: Rows) -> np.ndarray:
        """Values [N, 3] of the fit in units, signs and columns of the table as it is."""
        model = np.zeros_like(data.y)
        found = fit.problem.read(fit.u, rows) / reading.scale
        model[:, list(reading.source)] = finite(found)
        if reading.name == "pull":  # its values have another sign, its `scale` is 1
            model[:, 1] *= -1.0
        return model

    model = surface(fit.problem.rows)
    try:
        found = find_noise(data, model)
        if reading.name:  # its slip may differ from that of the data
            return found
        wide = with_noise_of_conditions(data, surface)[0]
        return dataclasses.replace(found, used=find_noise(wide, model).used)
    except ParameterError:
        alone = np.zeros(len(model), bool)
        return NoiseEstimate(
            rough_noise(data), np.full(3, math.inf), ("",) * 3, data.measured, alone
        )


class Better(NamedTuple):
    """A reading compared with the table as it is."""

    reading: Reading
    gain: float  # log evidence over that of the table as it is, by model, rises and resistance
    rms: float  # [noise] of the fit of the reading
    rms_before: float  # [noise] of the fit of the table as it is
    by_rises: float = 0.0  # part of the gain, from the rises of the forces with slip

    @property
    def sure(self) -> bool:
        """True if the reading is to be told.

        Evidence of `ALONE` by the rises is enough. Else the gain must be `SURE`, and the base model
        must fit better: by `BETTER`, or at all where the rises speak for the reading. It need not
        fit better where they do so by `WITH`.
        """
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
        """True if the fit misses the table by more than noise, so that another reading or a wrong
        row may be sought.

        Noise alone costs about 1 for each measured value, and the log evidence falls by half the
        cost. So a reading that leaves only noise would gain `SURE`.
        """
        return self.fit.cost - self.fit.problem.measured.sum() > 2.0 * SURE


def _as_is(data: Data) -> _AsIs:
    """The table as it is: fitted under a rough noise, then, from there, under the noise about that
    fit and without its outliers (values that `NoiseEstimate.used` leaves out).
    """
    plain = _plain(data.table, data.setup)
    rough = _fit(plain, rough_noise(data), data.measured)
    noise = _noise(data, rough)
    return _AsIs(data, noise, _fit(plain, noise.sd, noise.used, rough.u))


def _other_readings(start: _AsIs) -> list[Better]:
    """The other readings, that with the largest gain first; none where the table is not `suspect`
    and the rises of its forces speak for no reading (`ALONE`).

    All are fitted under one noise: the smallest that any reading but exchanged columns leaves about
    its surface, as a wrong reading leaves more. If a reading may be better, the table as it is gets
    a fit by search.
    """
    data, noise, first = start
    plain = first.reading
    rough = rough_noise(data)
    others = readings(data.table, data.setup)
    rises = _rises(data, noise)
    by_rises = [_by_rises(rises, data, other) for other in others]
    if not start.suspect and max(by_rises, default=0.0) < ALONE:
        return []
    as_it_is = _by_resistance(data, noise, plain)
    by_resistance = [_by_resistance(data, noise, other) - as_it_is for other in others]
    under_rough = [_fit(other, rough, data.measured) for other in others]
    noises = [_noise(data, fit) for fit in under_rough if fit.reading.name != "columns"]
    noise = min(noise, *noises, key=lambda there: np.sum(np.log(there.sd)))
    base = first if noise is start.noise else _fit(plain, noise.sd, noise.used, first.u)
    fits = [_fit(fit.reading, noise.sd, noise.used, fit.u) for fit in under_rough]
    if max(f.evidence for f in fits) - base.evidence > MAYBE:
        base = max(base, _fit(plain, noise.sd, noise.used, search=True), key=lambda f: f.evidence)
    found = [
        Better(f.reading, f.evidence - base.evidence + rise + held, f.rms, base.rms, rise)
        for f, rise, held in zip(fits, by_rises, by_resistance, strict=True)
    ]
    return sorted(found, key=lambda f: -f.gain)


def _rises(data: Data, noise: NoiseEstimate) -> np.ndarray:
    """[2] rises with slip of pull and of torque/radius, over the load: medians of the groups whose
    rows with that force begin at low slip.

    The size of a rise is the range of the force within a group, its sign that of the last row less
    the first. nan where a force was not measured, does not change, or no group begins at low slip.
    """
    forces = data.y[:, 1:] / data.rows.load[:, None]
    forces[:, 1] /= data.rows.wheels[:, 0]
    whole = np.all(noise.used[:, 1:] | ~data.measured[:, 1:], axis=1)
    rises = np.full(2, math.nan)
    for k in range(2):
        known = [forces[rows, k] for rows in _from_low_slip(data, whole & data.measured[:, k + 1])]
        size = np.median([np.ptp(y) for y in known]) if known else 0.0
        if size > 0.0:  # not of a wheel that climbs freely
            rises[k] = math.copysign(size, np.median([y[-1] - y[0] for y in known]))
    return rises


def _by_rises(rises: np.ndarray, data: Data, other: Reading) -> float:
    """Log evidence for the reading `other` over the table as it is, by the `_rises` of the latter.

    Only sizes of rises are compared. 0 where the reading changes none, where no rise is known, and
    for exchanged columns, whose rises are not exchanged here. -inf where this evidence is
    below `UNLIKE`, or where the reading turns the sign of pull or slip although the pull rises.
    """
    # A reading multiplies all loads by one factor, which the first row gives. [2] factors on pull
    # over load, and on torque over radius and load:
    scale = other.scale[1:] * data.table.load[0] / other.table.load[0]
    scale[1] *= data.setup.wheel.radius / other.setup.wheel.radius
    gain = _of_soils(scale * rises) - _of_soils(rises)
    turned = other.name in ("pull", "slip") and rises[0] > 0.0
    return -math.inf if turned or gain < UNLIKE else gain


def _of_soils(rises: np.ndarray) -> float:
    """Log probability density of the `rises` [2] of a wheel on soil, but for a constant; signs do
    not count, nor does what is nan.

    The rise of the pull (else of torque/radius) and the ratio of the two are independent
    (`CENTRE`).
    """
    pull, torque = np.log(np.abs(rises))
    off = (np.array([torque if math.isnan(pull) else pull, pull - torque]) - CENTRE) / SCALE
    return -0.5 * np.nansum((FREEDOM + 1.0) * np.log1p(off**2 / FREEDOM))


def _by_resistance(data: Data, noise: NoiseEstimate, reading: Reading) -> float:
    """Log probability density, but for a constant, of the resistance to the wheel under a reading:
    of its median over the `_resisted` rows.

    0 for less than `FEWEST_ROWS` such rows, which are those of the table as it is: a reading of the
    slip changes nothing.
    """
    rows = _resisted(data, noise)
    if rows.sum() < FEWEST_ROWS:
        return 0.0
    share, usual = _resistance(reading.table, reading.setup)
    off = np.median((share - usual)[rows]) / HELD_SD
    freedom = LESS_FREEDOM if off < 0.0 else MORE_FREEDOM
    return -0.5 * (freedom + 1.0) * math.log1p(off**2 / freedom)


def _resisted(data: Data, noise: NoiseEstimate) -> np.ndarray:
    """[N] bool, True for rows by which the resistance to the wheel is judged.

    They are on the level, at slips above `LOW_SLIP` (own choice), with a sinkage above 0. All three
    channels are measured, and none is an outlier.
    """
    level = np.abs(data.rows.conditions[:, 2]) < LEVEL
    return np.all(noise.used, axis=1) & (data.rows.slip > LOW_SLIP) & level & (data.y[:, 0] > 0.0)


def _resistance(table: Table, setup: Setup) -> tuple[np.ndarray, np.ndarray]:
    """(resistance to the wheel over the load, its usual value `HELD` sqrt(z/r)), both [-], one a
    row.

    Resistance is torque/radius less the pull, about the same at any slip. The vertical stress over
    the arc of contact makes it about W/2 times the sine sqrt(2 z/r) of the entry angle.
    """
    radius = table.radius(setup.wheel)
    share = (table.torque / radius - table.drawbar_pull) / table.load
    return share, HELD * np.sqrt(np.maximum(table.sinkage, 0.0) / radius)


class Examined(NamedTuple):
    """What `examine` found in a table."""

    table: Table  # without wrong rows
    said: tuple[str, ...] = ()  # what to check first; none as a rule
    #: Of the rows that are left: [N, 3] values that are no outliers, and the noise; None for a
    #: table that is taken as it is.
    noise: NoiseEstimate | None = None
    left_out: tuple[str, ...] = ()  # rows and values that are left out, in words
    undecided: tuple[str, ...] = ()  # readings that could be meant as well

    @contextmanager
    def named_first(self) -> Iterator[None]:
        """Within this context the message of a `ParameterError` about the rest begins with the rows
        and values that are left out.
        """
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

    A channel of one value, or of forces far too small for newtons, ends the examination. Else first
    come wrong rows, a load far from all others, outliers far from every other value (`gross`) and
    other readings; `load_doubt` is asked where there are none of these. Doubts of the setup and the
    grades come last. Outliers stay in the table: `noise.used` masks them, and `left_out` names
    them. Raises `ParameterError` where the table cannot be right (`_readings_doubted`), and for
    what `prepare` refuses, too little noise or too few values.
    """
    data = prepare(table, setup)
    given_noise(data)  # refuses one that leaves no digits
    _problem(
        _plain(table, setup), rough_noise(data), data.measured, scarce=False
    )  # refuses too few values
    always = [*setup.doubts(), *_grades_doubted(data)]
    dead = _channels_doubted(data)
    start = _as_is(data)
    if dead:  # what else could be read into such a table says nothing
        cells, _ = _outliers(data, start.noise)
        return Examined(table, (*dead, *always), start.noise, tuple(cells))
    start, rows = _without_wrong_rows(start)
    table = start.data.table
    cells, gross = _outliers(start.data, start.noise)
    readings_doubted, undecided = _readings_doubted(start)
    first = [*rows, *_load_alone(table), *gross, *readings_doubted]
    if not first and (load := load_doubt(table, setup)):
        first = [load]
    return Examined(table, (*first, *always), start.noise, (*rows, *cells), undecided)


def _readings_doubted(start: _AsIs) -> tuple[list[str], tuple[str, ...]]:
    """([doubt] or [], cautions): what is told of other readings, in sentences.

    The best of the `sure` readings is a doubt, with those nearly as good. It is a `ParameterError`
    if the table also breaks the physical limit that goes with this reading: a pull that falls with
    slip, a load that is hardly in newtons, or a wheel that gains power.

    Without a sure reading the first limit that is broken is a doubt. The first is a pull that falls
    with slip while its turned sign gains evidence. Then come a wheel that gains power, pulls with
    more than its torque brings to the rim, or meets no resistance. The best reading with a gain of
    `MAYBE` and a better fit (`LESS`) is a caution then.
    """
    others = _other_readings(start)
    possible = [b for b in others if b.gain > MAYBE and b.rms < LESS * b.rms_before]
    better = [b for b in others if b.sure]
    data, noise, _ = start
    if better:
        best = better[0]
        probable = f" ({_sure(best.gain)})" if best.gain > SURE else ""
        text = f"{best.words}{probable}: {best.reading.remedy}"
        # Clause on the limit that the table as it is breaks, "" for none.
        check = {
            "pull": _pull_falls,
            "load": lambda *_: load_doubt(data.table, data.setup).partition(":")[0],
            "torque_kg": _gains_power,
            "radius": _gains_power,
        }.get(best.reading.name)
        if check is not None and (broken := check(data, noise)):
            raise ParameterError(f"{data.table.source}: {broken}; {text[:1].lower()}{text[1:]}")
        # Nearly as good: the gains differ by less than half of the log evidence -`UNUSUAL` that
        # outweighs the prior of a mistake.
        near = [b.reading.words for b in better[1:] if best.gain - b.gain < -UNUSUAL / 2.0]
        also = f" {'; '.join(near)} it fits nearly as well." if near else ""
        return [f"{text}.{also}"], ()
    undecided = tuple(
        f"{b.words}: the table could be meant so ({b.reading.remedy})." for b in possible[:1]
    )
    turned = any(b.reading.name == "pull" and b.gain > 0.0 for b in others)
    doubts = []
    if turned and (falls := _pull_falls(data, noise)):
        doubts = [f"{falls}: check the sign of drawbar_pull (positive = the wheel pulls)."]
    elif more := _gains_power(data, noise) or _outpulls_the_rim(data, noise):
        doubts = [f"{more}: check the units of torque and drawbar_pull, and the wheel's radius."]
    elif missing := _no_resistance(data, noise):
        doubts = [
            f"{missing}: expected drawbar_pull at the axle, the thrust less the resistance; check "
            "also the unit of torque and the wheel's radius."
        ]
    return doubts, undecided


def _sure(gain: float) -> str:
    """Probability of a mistake in words, from its gain of log evidence and its prior `UNUSUAL`."""
    probability = expit(gain + UNUSUAL)
    return (
        "probability above 99.9 %"
        if probability > CERTAIN
        else f"probability {100.0 * probability:.3g} %"
    )


def _without_wrong_rows(start: _AsIs) -> tuple[_AsIs, list[str]]:
    """(table without the rows that contradict all others, a sentence on each).

    They are left out one by one, up to `MOST_WRONG` of the rows.
    """
    said: list[str] = []
    most = max(1, int(MOST_WRONG * len(start.data.table)))
    while len(said) < most and (found := _wrong_row(start)):
        start, words = found
        said.append(words)
    return start, said


def _wrong_row(start: _AsIs) -> tuple[_AsIs, str] | None:
    """(table without the wrong row, a sentence on it), None where no row is found wrong.

    The row is that without which the others fit best (`_worst_row`). It is kept where others at its
    slip share the deviation (`_is_shared`), or the trend of its neighbours leads to it
    (`_goes_on`). It is also kept where the evidence is too little (`_words_on`), or the rest are
    too few for a fit. A table that is not `suspect` is searched only if its noise is not known
    otherwise: taken from the scatter, it hides a wrong row. Tables of `FEWEST_ROWS` or fewer are
    not searched.
    """
    data, noise, fit = start
    count = len(data.table)
    # Noise that was taken from the scatter, or that the values do not show (`_noise`).
    hidden = "scatter" in noise.origin or not any(noise.origin)
    if count <= FEWEST_ROWS or not (start.suspect or hidden):
        return None
    off = _robust_deviations(fit)
    row = _worst_row(data, off, _noise_without_a_row(data, noise.sd) if hidden else noise.sd)
    if _is_shared(data, row, off):
        return None
    try:
        rest = _as_is(prepare(data.table.only(np.arange(count) != row), data.setup))
    except ParameterError:  # too little is left
        return None
    if _goes_on(data, row, rest):
        return None
    # The rest alone, less the rest with the row, both under the noise of the rest.
    sd = rest.noise.sd
    with_row = np.insert(rest.noise.used, row, data.measured[row], axis=0)
    gain = rest.fit.evidence - _fit(fit.reading, sd, with_row).evidence
    gain -= math.log(count)  # prior: any row may be the wrong one
    # Few rows under a noise that is taken from them need more evidence.
    least = GROSS if hidden and count <= SMALL else WRONG
    words = _words_on(data, row, rest.fit, sd, gain, least)
    return (rest, words) if words else None


def _robust_deviations(fit: _Fit) -> np.ndarray:
    """Residuals [N, 3] of a robust fit, which single rows hardly draw to themselves, whitened by
    the noise of `fit`; 0 where not measured.
    """
    problem = fit.problem
    robust = problem.minimise(fit.u, loss="cauchy", f_scale=CLEAR, **COARSE)[0]
    off = problem.by_noise(problem.residual(robust)).reshape(-1, 3)
    return np.where(problem.measured, off, 0.0)


def _noise_without_a_row(data: Data, sd: np.ndarray) -> np.ndarray:
    """[3] noise that no wrong row has made larger, whichever it is: the least of the noise `sd` and
    of the `rough_noise` of all rows but one, each row left out in turn.
    """
    rows = np.arange(len(data.table))
    return np.min([sd, *(rough_noise(data, rows != row) for row in rows)], axis=0)


def _worst_row(data: Data, off: np.ndarray, sd: np.ndarray) -> int:
    """The row without which the others fit best under the noise `sd` [3], by their cost over the
    number of their values.

    All rows of a `SMALL` table are tried, else the `CANDIDATES` whose deviations `off` [N, 3] are
    largest. So are those at the ends of slip and load, which draw the fit to themselves.
    """
    slip = data.table.slip
    load = data.table.load
    rows = np.arange(len(slip))

    def cost_without(row: int) -> float:
        """Cost of the fit to all other rows, over the number of their values; inf where the rest is
        refused.
        """
        there = _plain(data.table.only(rows != row), data.setup)
        try:
            found = _fit(there, sd, np.delete(data.measured, row, axis=0))
        except ParameterError:
            return math.inf
        return found.cost / found.problem.measured.sum()

    square = np.sum(off**2, axis=1) / np.maximum(data.measured.sum(axis=1), 1)
    few = rows if len(rows) <= SMALL else np.argsort(-square)[:CANDIDATES]
    tried = (*few, np.argmin(slip), np.argmax(slip), np.argmin(load), np.argmax(load))
    return min({int(k) for k in tried}, key=cost_without)


def _is_shared(data: Data, row: int, off: np.ndarray) -> bool:
    """True if the others at the slip of a row share its largest deviation of `off` [N, 3], so that
    it is no mistake of one row: two or more, by their median (`SHARED`).
    """
    level = data.varied["slip"].level
    channel = np.argmax(np.abs(off[row]))
    others = (level == level[row]) & (np.arange(len(level)) != row)
    beside = off[others & data.measured[:, channel], channel]
    return beside.size > 1 and np.median(beside) / off[row, channel] > SHARED


def _goes_on(data: Data, row: int, rest: _AsIs) -> bool:
    """True if a row goes on the trend of the two rows of its group that are next in slip.

    Its distance from the line through these is less than `SHARED` of its distance from the fit
    `rest` to all others, in the channel where that is largest. Then the row is not wrong: the model
    misses what grows with slip.
    """
    group = np.flatnonzero(data.group == data.group[row])
    model = rest.fit.problem.read(rest.fit.u, data.rows)[row]
    off = (data.y[row] - model) / (rest.noise.sd * data.relative_sd[row])
    if not np.any(np.isfinite(off)):
        return False
    channel = np.nanargmax(np.abs(off))
    others = group[(group != row) & data.measured[group, channel]]
    slip = data.rows.slip
    near = others[np.argsort(np.abs(slip[others] - slip[row]))[:2]]
    level = data.varied["slip"].level[near]
    if near.size < 2 or level[0] == level[1]:
        return False
    values = data.y[:, channel]
    line = np.polyval(np.polyfit(slip[near], values[near], 1), slip[row])
    return abs(values[row] - line) < SHARED * abs(values[row] - model[channel])


def _words_on(data: Data, row: int, others: _Fit, sd: np.ndarray, gain: float, least: float) -> str:
    """Sentence on a wrong row and on which of its cells to check, by the fit to the `others`; "" if
    the row is not sure to be wrong.

    It is sure if a value is off by `least` [noise and law error] and the evidence reaches `SURE`:
    the `gain` plus the log density of the row's own values if it is wrong. The `gain` is of the log
    evidence of the other rows without this one. The cell to check is the only value of three that
    is off, else the load or slip with which two or more values fit, else every one.

    If the row is wrong, the wrong values are anywhere within `spread`, the others about the fit. A
    load or slip is chosen to fit, so that one value counts as anywhere: that which tells most of
    it. `sd` [3]: noise.
    """
    table = data.table
    here = Rows(*(column[row : row + 1] for column in data.rows))
    known = data.measured[row]
    y = data.y[row, known]
    noise = (sd * data.relative_sd)[row, known]
    # Of a value near 0, as a pull may be, the law errs by a share of the usual size.
    size = np.sqrt(np.nanmean(data.y[:, known] ** 2, axis=0))
    allowed = np.hypot(noise, LAW_ERROR * np.maximum(np.abs(y), size))
    # Range in which a wrong value may be.
    spread = BROAD * np.max(np.abs(np.nan_to_num(data.y)), axis=0)[known]

    def residuals(name: str, values: np.ndarray) -> np.ndarray:
        """[G, M] residuals of the row's M values [noise and law error], with each of the G `values`
        in place of its slip or load.
        """
        many = Rows(*(np.repeat(column, values.size, axis=0) for column in here))
        out = others.problem.read(others.u, many._replace(**{name: values}))[:, known]
        return finite((y - out) / allowed, NO_VALUE)

    off = np.abs(residuals("load", here.load)[0])
    if np.max(off) < least:
        return ""
    grids = {
        "load": here.load[0] * np.geomspace(*LOADS_TRIED),
        "slip": np.linspace(*SLIPS_TRIED),
    }
    fits = {name: np.sqrt(np.mean(residuals(name, x) ** 2, axis=1)) for name, x in grids.items()}
    best = min(fits, key=lambda name: np.min(fits[name]))
    free = np.ones(y.size, bool)  # [M] values that may be anywhere
    if y.size > 2 and np.sum(off > CLEAR) == 1:
        name = np.array(CHANNELS)[known][np.argmax(off)]
        check = f"check {name} = {getattr(table, name)[row]:g} there."
        free = off > CLEAR
    elif y.size < 2 or np.min(fits[best]) > CLEAR:
        check = "check slip, load and values there."
    else:
        value = float(f"{grids[best][np.argmin(fits[best])]:.2g}")
        unit = " N" if best == "load" else ""
        check = (
            f"its values are those of a {best} of {value:g}{unit}, check {best} = "
            f"{getattr(table, best)[row]:g}{unit} there."
        )
        # The value that tells most of the load or slip.
        free = np.arange(y.size) == np.argmax(spread / allowed)
        off = residuals(best, np.array([value]))[0]
    gain -= np.sum(np.where(free, np.log(spread / noise), np.log(allowed / noise) + 0.5 * off**2))
    if gain < SURE:
        return ""
    if table.slip[row] in (table.slip.min(), table.slip.max()):
        # No row beyond it tells a mistake from a wheel that behaves otherwise from there on.
        check += " If it is right, repeat it: what comes again at the end of the slips is kept."
    return (
        f"Row {table.row[row]} (slip {table.slip[row]:g}, load {table.load[row]:g} N) contradicts "
        f"all others ({_sure(gain)}) and is left out: {check}"
    )


def _outliers(data: Data, noise: NoiseEstimate) -> tuple[list[str], list[str]]:
    """(sentences on the outliers, those of them that are to be checked first).

    An outlier leaves the smooth surface through the other values. It is to be checked first if its
    distance to the nearest of the values that count is more than `LONE` times their range. There
    must be `FEWEST_ROWS` of these.
    """
    sentences = []
    first = []
    for k, j in np.argwhere(data.measured & ~noise.used):
        others = data.y[noise.used[:, j], j]
        words = (
            f"Row {data.table.row[k]}, {CHANNELS[j]} = {data.y[k, j]:g}, leaves the surface "
            "through the other values and is left out."
        )
        sentences.append(words)
        span = np.ptp(others) if others.size >= FEWEST_ROWS else math.inf
        if np.min(np.abs(data.y[k, j] - others), initial=math.inf) > LONE * span:
            first.append(words)
    return sentences, first


def _load_alone(table: Table) -> list[str]:
    """[doubt] of the largest or least load where it is far (`APART`) from all others, which are
    `ALIKE`: nothing in the table can check it. Else, and for `FEWEST_ROWS` rows or fewer, [].
    """
    order = np.argsort(table.load)
    load = table.load[order]
    if len(load) <= FEWEST_ROWS:
        return []
    for row, others, ratio in (
        (order[-1], load[:-1], load[-1] / load[-2]),
        (order[0], load[1:], load[0] / load[1]),
    ):
        if others[-1] < ALIKE * others[0] and not 1.0 / APART < ratio < APART:
            return [
                f"Row {table.row[row]}, load = {table.load[row]:g} N, is {ratio:.2g} times the "
                "nearest load of another row: check it there."
            ]
    return []


def _grades_doubted(data: Data) -> list[str]:
    """[doubt] where all grades but 0 look like whole degrees in radians (`look_like_radians`), else
    [].
    """
    grades = data.table.grade_deg[np.abs(data.table.grade_deg) > 0.0]  # of those that are given
    if not look_like_radians([repr(float(g)) for g in grades]):
        return []
    return [
        f"grade_deg = {abs(grades[0]):g} is {math.degrees(abs(grades[0])):.0f} degrees in radians: "
        "expected degrees."
    ]


def _channels_doubted(data: Data) -> list[str]:
    """Doubts of channels that hold one value at all slips, or forces that are far too small for
    newtons (`WEAK`).

    Judged are `FEWEST_VALUES` or more over a range of slip of `LEAST_SPAN`. A pull of 0 throughout
    is no doubt where the load is vertical: the wheel may climb by itself.
    """
    out = []
    load = data.rows.load
    radius = data.rows.wheels[:, 0]
    for j, name, unit, over in (
        (0, "sinkage", "", radius),
        (1, "drawbar_pull", "newtons", load),
        (2, "torque", "newton metres", load * radius),
    ):
        known = data.measured[:, j]
        y = data.y[known, j]
        if (
            y.size < FEWEST_VALUES
            or np.ptp(data.rows.slip[known]) < LEAST_SPAN
            or (j == 1 and data.setup.load == "vertical" and not np.any(y))
        ):
            continue
        largest = np.max(np.abs(y) / over[known])
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
    """Indices of the `used` rows [N, bool] by rising slip, of each group that begins at low slip.

    Its lowest slip is between `LOWEST_SLIP` and `LOW_SLIP`, its range `LEAST_SPAN` or more, and it
    has three rows or more.
    """
    for rows in data.groups:
        rows = rows[used[rows]]
        slip = data.rows.slip[rows]
        if rows.size > 2 and LOWEST_SLIP <= slip.min() <= LOW_SLIP and np.ptp(slip) >= LEAST_SPAN:
            yield rows[np.argsort(slip)]


def _pull_falls(data: Data, noise: NoiseEstimate) -> str:
    """Clause that the drawbar pull falls with slip from low slip on, beyond noise and to below 0,
    in nearly all groups of rows (`FALLS`); "" else.
    """
    falls = []
    ends = []
    for rows in _from_low_slip(data, noise.used[:, 1]):
        pull = data.y[rows, 1]
        slip = data.rows.slip[rows]
        slope = np.polyfit(slip, pull, 1)[0]
        falls.append(slope * np.ptp(slip) < -FALL_SD * noise.sd[1] and pull[-1] < min(pull[0], 0.0))
        ends.append(pull[[0, -1]])
    if not falls or np.mean(falls) < FALLS:
        return ""
    first, last = np.median(ends, axis=0)
    return (
        f"drawbar_pull falls with slip in {100.0 * np.mean(falls):.0f} % of the groups of rows "
        f"that differ in slip alone, from {first:.3g} N at the least to {last:.3g} N at the "
        "largest slip"
    )


def _gains_power(data: Data, noise: NoiseEstimate) -> str:
    """Clause that the driven wheel pulls with more power than its axle takes, DP V > T w, which no
    soil can make; "" else.
    """
    return _over_the_axle(
        data,
        noise,
        1.0 - data.rows.slip,  # V / (r w)
        "drawbar_pull times travel speed is {:.2g} times torque times rotational speed in the "
        "middle of the rows, and no wheel gains power",
    )


def _outpulls_the_rim(data: Data, noise: NoiseEstimate) -> str:
    """Clause that the driven wheel pulls with more than its torque brings to the rim, DP > T/r, as
    if the normal stress pushed it forward; "" else.
    """
    return _over_the_axle(
        data,
        noise,
        1.0,
        "drawbar_pull is {:.2g} times torque over radius in the middle of the rows, and soil holds "
        "a driven wheel back",
    )


def _no_resistance(data: Data, noise: NoiseEstimate) -> str:
    """Clause that torque over radius equals the pull, as if the soil did not hold back a wheel that
    is deep in it; "" else.

    The pull is the whole thrust then. The usual resistance must be clear of 0 by `NONE_HELD`, and
    what is measured far below it (`MOST_HELD`).
    """
    rows = _resisted(data, noise)
    if rows.sum() < FEWEST_ROWS:
        return ""
    share, usual = (np.median(x[rows]) for x in _resistance(data.table, data.setup))
    if usual < NONE_HELD * HELD_SD or abs(share) > MOST_HELD * usual:
        return ""
    return (
        f"torque over radius less drawbar_pull is {round(share, 2) + 0.0:g} times the load in the "
        "middle of the rows, where soil holds a wheel as deep as this one back with about "
        f"{usual:.2g}"
    )


def _over_the_axle(data: Data, noise: NoiseEstimate, ratio: np.ndarray | float, words: str) -> str:
    """`words` with the median of DP `ratio`/(T/r) over the driven rows on the level, if it exceeds
    1 by more than noise (`SURE_GAIN`) and errors of gains (`GAINED`); "" else.

    `ratio`: [N] travel speed over that of the rim to compare powers, 1 to compare forces. `words`
    has a place for the median. Three rows are needed, and a positive torque.
    """
    level = np.abs(data.rows.conditions[:, 2]) < LEVEL
    both = noise.used[:, 1] & noise.used[:, 2] & (data.rows.slip > 0.0) & level
    radius = data.rows.wheels[:, 0]
    taken = data.y[:, 2] / radius  # by the axle
    given = data.y[:, 1] * ratio  # by the pull
    of_rows = noise.sd * data.relative_sd  # [N, 3]
    sd = np.hypot(of_rows[:, 2] / radius, of_rows[:, 1] * ratio)
    gain = (given - GAINED * taken - SURE_GAIN * sd)[both]
    if gain.size < 3 or np.median(gain) <= 0.0 or np.median(taken[both]) <= 0.0:
        return ""
    return words.format(np.median((given / taken)[both]))
