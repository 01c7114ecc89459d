"""Noise of the channels and outliers, before any effect is known.

The reference is a *smooth surface* through the data: the calibrated base model plus polynomials of
the conditions in every channel. Whatever effect is missing, it is smooth in the conditions; single
values that leave the surface are not an effect. (`identification.table.problem` estimates noise
from what its own fit leaves: there the model is taken to be right, here it is in question.)
"""

import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations
from typing import Any

import numpy as np
from scipy import special

from soil_env._io.loading import ParameterError
from soil_env.measurement.setup import NoiseLevels
from soil_env.terramechanics.model import Rows

from .data import CHANNELS, WHEEL, Data
from .form_error import LOGARITHMIC, finite

OUTLIER = 4.5  # [sd] distance from the smooth surface beyond which a value is left out
#: Median distance of the other values at a slip, in sd over the root of their number, from which a
#: deviation that they share is no outlier.
COMMON = 3.8
#: Share of the values of a channel that may be left out. Their number is rounded down, one at
#: least; then one more may be. Own choice.
MOST_OUTLIERS = 0.06
SD_OF_MEDIAN = 1.4826  # sd of a normal distribution over its median distance from the median
LEAST_FREE = 0.05  # least value of 1 - leverage, by whose root a residual is divided
LEAST_TAIL = 1e-300  # probability that a distance is computed from, at least
ALONE = 0.8  # leverage on the smooth surface above which a value is checked by no other
#: Scatter over the size of the values below which they are rounded or computed, not measured.
LEAST_NOISE = 1e-5
LEAST_GIVEN = 1e-6  # the same of noise that the setup gives; less leaves no digits to fit with
ROUGH = 0.05  # of the spread of a channel: its noise before any fit; own choice
#: [of radius, load, load x radius] least noise of a channel before any fit; own choice.
LEAST_ROUGH = 1e-4
SMALLEST_SD = 1e-12  # [unit of the channel] of any noise, since it divides
FEWEST_REPEATS = 6  # degrees of freedom of repeats, from which noise is taken from them; own choice
SPARE = 3  # values of a channel beyond the functions of the surface, at least
STEPS = {"slip": 0.005, "load": 0.01}  # of a derivative of the model: absolute, relative
SHIFT = 1e-4  # of a condition scaled to [-1, 1], for the derivative of the polynomials
INDEPENDENT = 1e-9  # share of a column that those before it do not make up; less is rounding
REPEAT_SLIP = 0.02  # largest difference of slip within repeats
REPEAT_LOAD = 0.2  # largest difference of load within repeats, over their mean


@dataclass(frozen=True, eq=False)
class NoiseEstimate:
    """Noise of the channels and the values that count."""

    sd: np.ndarray  # [3], of a value whose row gives none of its own; 1 where not measured
    #: [3] degrees of freedom of the estimate; inf where noise is given, or nothing was measured.
    freedom: np.ndarray
    #: [3] "setup" (also of noise that the rows give), "repeats", "scatter", or "" without values.
    origin: tuple[str, ...]
    used: np.ndarray  # [N, 3] bool, measured values that are no outliers
    alone: np.ndarray  # [N] bool, rows whose values no other row comes near enough to check
    #: Those of slip and load whose noise is included in that of the channels.
    of_conditions: tuple[str, ...] = ()


def find_noise(data: Data, model: np.ndarray) -> NoiseEstimate:
    """`NoiseEstimate` of the channels.

    The noise of each is from the setup or a column of standard deviations. Else it is from repeats
    with at least `FEWEST_REPEATS` degrees of freedom, else from the scatter about the surface
    through the data.

    `model` [N, 3]: the calibrated base model, to which the surface adds polynomials. Outliers from
    the surface are left out one after the other, and count in no noise. None is sought with fewer
    than `SPARE` values more than the surface has polynomials. `ParameterError` where noise
    would have to be taken from too few values, or from values that hardly scatter.
    """
    given = given_noise(data)
    repeat_freedom = repeat_noise(data, model)[1]
    basis = smooth_basis(data)
    used = data.measured
    sd = np.ones(3)
    freedom = np.full(3, math.inf)
    origin = [""] * 3
    alone = np.zeros(len(used), bool)
    for j, name in enumerate(CHANNELS):
        values = used[:, j].sum()
        if not values:
            continue
        if given[j] is not None:
            origin[j] = "setup"
            sd[j] = given[j]
        else:
            origin[j] = "repeats" if repeat_freedom[j] >= FEWEST_REPEATS else "scatter"
        if values - basis.shape[1] < SPARE:
            if origin[j] == "scatter":
                raise ParameterError(
                    f"{data.table.source}: noise of {name}: cannot be estimated from {values} "
                    "values with too few repeats; expected noise in the setup, or repeated points"
                )
            continue
        relative = data.relative_sd[:, j]
        e = (data.y[:, j] - model[:, j]) / relative
        weighted = basis / relative[:, None]
        kept = _without_outliers(weighted, e, used[:, j], given[j], data.varied["slip"].level)
        used[:, j] = kept
        left, leverage = _surface(weighted, e, kept)
        alone |= kept & (leverage > ALONE)
        if origin[j] == "scatter":
            freedom[j] = kept.sum() - basis.shape[1]
            sd[j] = math.sqrt(np.sum(left[kept] ** 2) / freedom[j])
    if "repeats" in origin:
        repeats = [text == "repeats" for text in origin]
        cleaned = dataclasses.replace(data, y=np.where(used, data.y, math.nan))
        repeat_sd, repeat_freedom = repeat_noise(cleaned, model)  # without the outliers
        sd[repeats] = repeat_sd[repeats]
        freedom[repeats] = repeat_freedom[repeats]
    _check_scatter(data, used, sd, origin)
    return NoiseEstimate(np.maximum(sd, SMALLEST_SD), freedom, tuple(origin), used, alone)


def rough_noise(data: Data, rows: np.ndarray | slice = slice(None)) -> np.ndarray:
    """[3] noise of the channels before any fit: as given, else `ROUGH` times the sd of the values
    in `rows` (bool or a slice; all by default), but at least `LEAST_ROUGH` of the usual size.
    `ROUGH` itself of a channel without values.
    """
    out = np.full(len(CHANNELS), ROUGH)
    load = np.median(data.rows.load)
    radius = data.rows.wheels[0, 0]
    sizes = (radius, load, load * radius)
    for j, name in enumerate(CHANNELS):
        known = data.table.channel_sd(data.setup, name)
        y = data.y[rows, j]
        y = y[np.isfinite(y)]
        if known is not None:
            out[j] = known
        elif y.size:
            out[j] = max(ROUGH * np.std(y), LEAST_ROUGH * sizes[j])
    return out


def given_noise(data: Data) -> list[float | None]:
    """Noise of each of the three channels as the setup or the rows give it, None where neither
    does.

    `ParameterError` where it is less than `LEAST_GIVEN` of the root mean square of the values.
    """
    given = [data.table.channel_sd(data.setup, name) for name in CHANNELS]
    for j, name in enumerate(CHANNELS):
        values = data.y[data.measured[:, j], j]
        least = LEAST_GIVEN * np.sqrt(np.mean(values**2)) if values.size else 0.0
        sd = given[j]
        if sd is not None and sd < least:
            raise ParameterError(
                f"{data.table.sd_source(data.setup, name)} = {sd:g}: expected at least "
                f"{least:.2g}, a millionth of the values; leave it out where it is not known"
            )
    return given


def with_noise_of_conditions(
    data: Data, predict: Callable[[Rows], np.ndarray]
) -> tuple[Data, tuple[str, ...]]:
    """(data in which given noise of slip and load is noise of the channels, names of these
    conditions).

    An error of the slip moves a value along the surface through the data. The effective variance
    (Orear 1982, Am. J. Phys. 50:912-916) adds that to the noise of a channel that the setup or the
    table gives. Noise that is taken from the scatter has it already. Where there is nothing to add,
    the data are returned as they are, without names. `predict`: values [N, 3] of the calibrated
    base model at rows.
    """
    noise = {name: sd for name in STEPS if (sd := getattr(data.setup.noise, name)) is not None}
    given = given_noise(data)
    if not noise or all(sd is None for sd in given):
        return data, ()
    more = sum((sd * _derivatives(data, predict, name)) ** 2 for name, sd in noise.items())
    columns: dict[str, Any] = {}
    for j, channel in enumerate(CHANNELS):
        own = given[j]
        if own is not None:
            columns[f"{channel}_sd"] = np.sqrt((own * data.relative_sd[:, j]) ** 2 + more[:, j])
    # Each row has its noise now, and slip and load are exact.
    setup = data.setup.changed(noise=NoiseLevels())
    table = dataclasses.replace(data.table, **columns)
    return dataclasses.replace(
        data, table=table, setup=setup, relative_sd=table.relative_sd(setup)
    ), tuple(noise)


def _derivatives(data: Data, predict: Callable[[Rows], np.ndarray], name: str) -> np.ndarray:
    """Derivatives [N, 3] of the smooth surface by the condition `name`, slip or load, in the units
    of channel and condition; `predict`: values [N, 3] of the base model at rows.

    The surface is the base model and polynomials that are fitted to what it leaves; these count
    only if the condition varies. 0 where the model has no value.
    """
    value = getattr(data.rows, name)
    # d(condition) / d(logarithm), where the logarithm is what is scaled.
    unit = value if name in LOGARITHMIC else np.ones_like(value)
    step = STEPS[name] * unit
    above, below = (predict(data.rows._replace(**{name: value + h})) for h in (step, -step))
    out = (above - below) / (2.0 * step[:, None])
    if name in data.varied:
        factor = data.varied[name]
        span = np.ptp(np.log(value) if name in LOGARITHMIC else value)
        scaled_by_value = np.ptp(factor.scaled) / span / unit  # d(scaled) / d(condition)
        shifted = dataclasses.replace(factor, scaled=factor.scaled + SHIFT)
        basis = smooth_basis(data)
        moved = smooth_basis(dataclasses.replace(data, varied=data.varied | {name: shifted}))
        by_scaled = (moved - basis) / SHIFT
        left = data.y - predict(data.rows)
        for j, e in enumerate(left.T):
            rows = np.isfinite(e)
            if rows.any():
                coefficients, *_ = np.linalg.lstsq(basis[rows], e[rows], rcond=1e-10)
                out[:, j] += by_scaled @ coefficients * scaled_by_value
    return finite(out)


def _without_outliers(
    basis: np.ndarray, e: np.ndarray, used: np.ndarray, sd: float | None, slip: np.ndarray
) -> np.ndarray:
    """[N] bool, True for the values `used` [N, bool] of a channel that are no outliers.

    `basis` [N, B]: functions of the surface; `e` [N]: values less the model; `sd`: their noise,
    None to take it from their scatter; `slip` [N]: levels. The value furthest from the surface is
    left out, one after the other, while it is beyond `OUTLIER`, and up to `MOST_OUTLIERS`. A value
    that no other checks (`ALONE`) stays. Distances are residuals over sqrt(1 - leverage), over the
    `sd` or the median scatter, whichever is larger; without an `sd` those of `_studentised` count
    where they are larger.

    With a given `sd` values come back that a larger outlier had moved the surface away from. A
    value also comes back if two or more others at its slip leave the surface the same way
    (`COMMON`).
    """
    keep = used.copy()
    for _ in range(max(1, int(MOST_OUTLIERS * keep.sum())) + 1):
        left, leverage = _surface(basis, e, keep)
        known = keep & (leverage <= ALONE)
        spread = left / np.sqrt(np.maximum(1.0 - leverage, LEAST_FREE))
        # Where the surface errs by more than the noise, all values leave it: that is the scale.
        scale = max(SD_OF_MEDIAN * np.median(np.abs(spread[keep])), sd or SMALLEST_SD)
        far = np.abs(spread) / scale
        if sd is None:
            freedom = keep.sum() - basis.shape[1] - 1
            if freedom < 1:  # too few values are left to judge one by the others
                break
            far = np.maximum(far, _studentised(spread, np.sum(left[keep] ** 2), freedom))
        far[~known] = 0.0
        worst = np.argmax(far)
        if far[worst] <= OUTLIER:
            break
        keep[worst] = False
    # From here on in the `scale` of the last pass.
    if sd is not None:  # values that a first outlier had masked come back
        left, leverage = _surface(basis, e, keep)
        keep |= used & (np.abs(left) <= OUTLIER * scale * np.sqrt(1.0 + leverage))
    left = _surface(basis, e, keep)[0] / scale
    for k in np.flatnonzero(used & ~keep):
        # Distances of the others at its slip, > 0 on the side of the surface where it lies.
        others = left[used & (slip == slip[k]) & (np.arange(slip.size) != k)] * np.sign(left[k])
        keep[k] = others.size > 1 and np.median(others) > COMMON / math.sqrt(others.size)
    return keep


def _studentised(spread: np.ndarray, square: float, freedom: int) -> np.ndarray:
    """Distances [N] in sd of values from the surface through all others, with the noise of these.

    So a single large value cannot hide by drawing the surface to itself or by raising the noise.
    This is the externally studentised residual (Belsley, Kuh & Welsch 1980, Eq. 2.26), turned into
    the distance that has the same probability under a known noise. `spread` [N]: residuals over
    sqrt(1 - leverage); `square`: sum of squared residuals of the values kept; `freedom`: degrees of
    freedom of the others.
    """
    # of the others; where one value makes up the whole sum its difference is rounding
    rest = np.maximum(square - spread**2, 1e-12 * square)
    t = np.abs(spread) / np.sqrt(rest / freedom)
    return np.asarray(-special.ndtri(np.maximum(special.stdtr(freedom, -t), LEAST_TAIL)))


def _check_scatter(data: Data, used: np.ndarray, sd: np.ndarray, origin: list[str]) -> None:
    """Raise `ParameterError` where noise `sd` [3] was taken from values that are rounded or
    computed.

    Values count as such where this noise is at most `LEAST_NOISE` of their root mean square, or all
    are the same.
    """
    for j, name in enumerate(CHANNELS):
        if origin[j] not in ("repeats", "scatter"):
            continue
        y = data.y[used[:, j], j]
        if np.ptp(y) == 0.0 or sd[j] <= LEAST_NOISE * np.sqrt(np.mean(y**2)):
            raise ParameterError(
                f"{data.table.source}: noise of {name}: the values hardly scatter, so it cannot be "
                "taken from them; expected noise in the setup"
            )


def smooth_basis(data: Data) -> np.ndarray:
    """Functions [N, B] of the smooth surface: polynomials of the varied conditions, up to the third
    power of slip and the second of the others, and products of two.

    A square needs three levels of its condition, the cube five. Sizes of the wheel multiply all of
    these columns, so that two wheels have a surface each. A column with a size is left out if those
    before it make it up. Only the first columns are taken, up to half as many as there are cells,
    but two at least.
    """
    slip = data.varied["slip"]
    s = slip.scaled
    columns = [np.ones_like(s), s]
    if slip.levels > 2:
        columns.append(s * s)
    if slip.levels > 4:
        columns.append(s**3)
    others = [c for name, c in data.varied.items() if name not in ("slip", *WHEEL)]
    columns += [c.scaled for c in others]
    columns += [s * c.scaled for c in others]
    columns += [c.scaled**2 for c in others if c.levels > 2]
    columns += [a.scaled * b.scaled for a, b in combinations(others, 2)]
    sizes = [c for name, c in data.varied.items() if name in WHEEL]
    plain = len(columns)
    columns += [column * c.scaled for column in tuple(columns) for c in sizes]
    columns += [c.scaled**2 for c in sizes if c.levels > 2]
    cells = data.cell.max() + 1
    basis = np.stack(columns, axis=1)
    kept = np.ones(len(columns), bool)
    # With fewer rows than columns, R has no diagonal for the last ones; the cut at the end then
    # leaves few enough.
    if sizes and len(basis) >= len(columns):
        kept[plain:] = np.abs(np.diag(np.linalg.qr(basis)[1]))[plain:] > INDEPENDENT * math.sqrt(
            len(basis)
        )
    return basis[:, kept][:, : max(2, cells // 2)]


def repeat_noise(data: Data, model: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(sd [3], degrees of freedom [3]) of the scatter of measured minus `model` [N, 3] within
    `Data.cell`, for a value whose row gives no noise of its own; nan and 0 without repeats.

    The model takes up the small differences of slip and load that repeats have. Cells with larger
    differences (`REPEAT_SLIP`, `REPEAT_LOAD`) do not count.
    """
    left = (data.y - model) / data.relative_sd
    total = np.zeros(3)
    freedom = np.zeros(3)
    for k in range(data.cell.max() + 1):
        inside = data.cell == k
        load = data.rows.load[inside]
        if (
            inside.sum() < 2
            or np.ptp(data.rows.slip[inside]) > REPEAT_SLIP
            or np.ptp(load) > REPEAT_LOAD * load.mean()
        ):
            continue
        for j in range(3):
            v = left[inside, j]
            v = v[np.isfinite(v)]
            if v.size > 1:
                total[j] += np.sum((v - v.mean()) ** 2)
                freedom[j] += v.size - 1
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.sqrt(total / freedom), freedom


def _surface(basis: np.ndarray, e: np.ndarray, keep: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(residual [N], leverage [N]) of all values `e` [N] about the least-squares surface of the
    functions `basis` [N, B] through those to `keep` [N, bool].

    Leverage is the variance of the surface at a row over that of the noise. For a value that is
    kept it is also how much the value moves the surface there, at most 1.
    """
    coefficients, *_ = np.linalg.lstsq(basis[keep], e[keep], rcond=1e-10)
    inverse = np.linalg.pinv(basis[keep].T @ basis[keep], rcond=1e-12)
    leverage = np.einsum("nb,bc,nc->n", basis, inverse, basis)
    return e - basis @ coefficients, np.where(keep, np.minimum(leverage, 1.0), leverage)
