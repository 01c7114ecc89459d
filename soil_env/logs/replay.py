"""The online identifier over a log: the soil under the wheel and its uncertainty over time.

Borders are those that the identifier finds by the forces and the law of sinkage. It finds more than
there are, so a border counts as one between grounds only where the estimates on both sides differ
(`_probability_of_two`).
"""

import math
from dataclasses import dataclass, fields
from warnings import catch_warnings

import numpy as np
from scipy.special import expit

from soil_env.online import Estimate, OnlineIdentifier, Readings, Status
from soil_env.parameters import Soil

from .align import Aligned
from .mapping import UNKNOWN_INERTIA, LogMap

#: Numbers of an estimate, in the order of the columns of estimates.csv.
ESTIMATED = tuple(
    name
    for name in Estimate.__dataclass_fields__
    if name not in ("status", "renewed", "borders", "instruments", "refused")
)
COLUMNS = (*ESTIMATED, "drawbar_margin", "drawbar_margin_sd", "torque_required")
#: Name of the standard deviation of each parameter of the soil; a relative one is of the logarithm.
SD_OF = {
    "friction_angle_deg": "friction_angle_sd_deg",
    "shear_modulus": "shear_modulus_relative_sd",
    "sinkage_coefficient": "sinkage_coefficient_relative_sd",
    "cohesion": "cohesion_sd",
    "dig_gain": "dig_gain_relative_sd",
}
DIFFERS = 0.5  # probability from which the ground behind a border counts as another
_LEARNT = 0.8  # sd over prior sd, below which something was learnt
_LEAST_LOAD = 1e-9  # [N] for which a margin is computed: that of a lifted wheel reads 0 or less
_CONTRADICTS = 0.1  # share of the steps with status MISFIT, beyond which the report says so
_MOSTLY = 0.5  # the same, beyond which it says so first
#: [border lengths] of the stretch before the place where the identifier found a border. The border
#: may have begun in it, so its estimates do not count for the ground before.
_LEFT = 1.2
_LEAST_PART = 2.0  # [border lengths] of a part of the drive that is compared with that before
#: Parameters by which two grounds are compared.
_COMPARED = ("friction_angle_deg", "shear_modulus", "sinkage_coefficient", "cohesion")
_SEEN = 0.8  # prior probability that there is another soil behind a border that the identifier saw
_DOUBTED = 0.1  # [prior sd] by which every estimate may be off beside its own sd
_LEAST_VARIANCE = 1e-9  # [of the prior's] that is divided by
#: (least, greatest) value that a soil has of each of `_COMPARED`. The gain of slip-sinkage is not
#: checked: little may be known of it.
_BOUNDS = {
    f.name: (f.metadata["low"], f.metadata["high"]) for f in fields(Soil) if f.name in _COMPARED
}
#: Factor on the sds of an estimate that was picked because they are the least, which are too small
#: therefore. Own measurement: errors over these sds have root mean squares of 1.4 to 1.8 on drives
#: in one soil of `mixed`, `loose_slopes` and `sticky`.
PICKED = 1.6
_NO_MARGIN = (math.nan,) * 3  # drawbar margin, its sd and the torque required, where not known


@dataclass(frozen=True, eq=False)
class Replay:
    """Estimates over the steps of a log."""

    time: np.ndarray  # [N] s
    #: [N] each, by `COLUMNS`. The last three, of `traversability`, are NaN from the start or a gap
    #: to the first renewed estimate; all are NaN where an estimate is refused (`_refuse`).
    values: dict[str, np.ndarray]
    status: np.ndarray  # [N] `Status`
    renewed: np.ndarray  # [N] bool: changed in this step
    #: [N] int from 1: one more at each border to another soil, and after each gap.
    ground: np.ndarray
    #: Probability, by ground, that its soil is not that of the last; NaN of the first after a gap.
    differs: list[float]
    borders: int  # that the identifier found, whatever lies behind them
    prior: Estimate  # of the identifier before any reading
    #: [N] bool: the estimate is a blend of those of two soils, with sds that may be below either's.
    on_border: np.ndarray
    measured: frozenset[str]  # readings that the identifier received
    restarts: int  # because of gaps
    warnings: list[str]

    def csv(self) -> str:
        """CSV text with a header and one line a step: time, `COLUMNS` (empty for NaN), name of the
        status, 1 if the step renewed the estimate, ground.
        """
        lines = [",".join(("time", *COLUMNS, "status", "renewed", "ground"))]
        columns = zip(*(self.values[n].tolist() for n in COLUMNS), strict=True)
        states = zip(self.status.tolist(), self.renewed, self.ground, strict=True)
        for t, row, (status, new, ground) in zip(self.time.tolist(), columns, states, strict=True):
            cells = ",".join("" if x != x else f"{x:.8g}" for x in row)
            lines.append(f"{t:.9g},{cells},{Status(status).name},{int(new)},{ground}")
        return "\n".join(lines) + "\n"

    def surest_on(self, ground: int) -> dict[str, float] | None:
        """The surest estimate on a ground, by `COLUMNS`; None where none was current.

        Current are estimates with status CONVERGED that are not `on_border`. The surest has the
        least product of its sds, each over that of the prior. All its sds are multiplied by
        `PICKED`. The last estimate on the ground errs more: the identifier began anew after borders
        that `_grounds` does not count.
        """
        converged = (self.status == Status.CONVERGED) & ~self.on_border
        current = np.flatnonzero(converged & (self.ground == ground))
        if not current.size:
            return None
        sds = [self.values[sd][current] / getattr(self.prior, sd) for sd in SD_OF.values()]
        k = current[np.argmin(np.sum(np.log(sds), axis=0))]
        return {
            name: float(values[k]) * (PICKED if "_sd" in name else 1.0)
            for name, values in self.values.items()
        }

    def learnt(self, current: bool = False) -> dict[str, float]:
        """Least standard deviation of each parameter over that of the prior; 1: nothing learnt.

        The least is that of the estimates away from borders with status CONVERGED or NOT_EXCITED;
        with `current` only of CONVERGED ones.
        """
        sound = [Status.CONVERGED] if current else [Status.CONVERGED, Status.NOT_EXCITED]
        kept = np.isin(self.status, sound) & ~self.on_border
        out = {}
        for name, sd in SD_OF.items():
            prior = getattr(self.prior, sd)
            out[name] = float(np.min(self.values[sd], where=kept, initial=prior)) / prior
        return out


def replay(log: Aligned, log_map: LogMap) -> Replay:
    """Give the readings of a log to the online identifier, step by step.

    After a gap of more than `restart_gap` it starts from the prior again. A motor torque without
    the inertia of the wheel is left out. The drawbar margin and the torque required are those of
    `OnlineIdentifier.traversability` at the load and pitch of the step that renewed the estimate,
    and held until the next. A missing load is the weight's part normal to the ground there, a
    missing pitch is 0.

    An estimate out of the bounds of `Soil` is refused: NaN, with status MISFIT. Where one speed is
    missing and the slip gives one that no wheel reaches, only the time of the step is taken.
    """
    identifier = OnlineIdentifier(
        log_map.wheel,
        log_map.belief,
        log_map.noise(),
        period=log_map.period,
        gravity=log_map.gravity,
        relaxation=log_map.relaxation,
    )
    prior = identifier.estimate
    size = len(log)
    status = np.zeros(size, np.int64)
    borders = np.zeros(size, np.int64)  # found so far
    restarts = 0
    renewed = np.zeros(size, bool)
    on_border = np.zeros(size, bool)
    table = np.empty((size, len(COLUMNS)))
    names = set(log.readings)
    if log_map.wheel.inertia == UNKNOWN_INERTIA:
        names.discard("motor_torque")
    borders_before = 0  # found before the last restart
    last = math.nan  # [s] of the last step
    margin = _NO_MARGIN
    impossible = 0  # steps
    for k, t in enumerate(log.time.tolist()):
        if t - last > log_map.restart_gap:
            borders_before += identifier.estimate.borders
            identifier.reset()
            restarts += 1
            margin = _NO_MARGIN
        reading = Readings(**{n: float(log.readings[n][k]) for n in names}, time=t)
        # The warning is of a long step: `restart_gap` says what is long.
        with catch_warnings(action="ignore", category=UserWarning):
            try:
                e = identifier.update(reading)
            except ValueError:
                if not math.isnan(reading.speed + reading.wheel_speed):
                    raise  # of another reading
                e = identifier.update(Readings(time=t))
                impossible += 1
        if e.renewed:
            load = None if math.isnan(reading.load) else max(reading.load, _LEAST_LOAD)
            ahead = identifier.traversability(load, float(np.nan_to_num(reading.pitch)))
            margin = ahead.drawbar_margin, ahead.drawbar_margin_sd, ahead.torque_required
        table[k] = [*(getattr(e, name) for name in ESTIMATED), *margin]
        status[k] = e.status
        renewed[k] = e.renewed
        on_border[k] = identifier.on_border
        borders[k] = borders_before + e.borders
        last = t
    values = dict(zip(COLUMNS, table.T, strict=True))
    # a normal posterior goes below 0, which counts as 0 wherever a soil is made of it
    values["cohesion"] = np.maximum(values["cohesion"], 0.0)
    warnings = []
    if restarts:
        warnings.append(
            f"The identifier started anew {'once' if restarts == 1 else f'{restarts} times'}, "
            f"after gaps of more than {log_map.restart_gap:g} s."
        )
    if impossible:
        warnings.append(
            f"In {impossible} of {size} steps a speed that follows from the slip is none of a "
            "wheel. They are left out."
        )
    warnings += _refuse(log.time, values, status)
    ground, differs = _grounds(log, log_map, borders, values, status, prior)
    return Replay(
        time=log.time,
        values=values,
        status=status,
        renewed=renewed,
        ground=ground,
        differs=differs,
        borders=int(borders.max(initial=0)),
        prior=prior,
        on_border=on_border,
        measured=frozenset(n for n in names if np.isfinite(log.readings[n]).any()),
        restarts=restarts,
        warnings=warnings,
    )


def _refuse(time: np.ndarray, values: dict[str, np.ndarray], status: np.ndarray) -> list[str]:
    """Refuse estimates that are not finite or out of the bounds of a soil (`_BOUNDS`).

    All `values` [N] of a refused step become NaN and its `status` [N] MISFIT, both in place.
    Returns a list of one warning, which names the first value out of bounds if there is one; an
    empty list where nothing is refused.
    """
    bad = ~np.all([np.isfinite(values[n]) for n in ESTIMATED], axis=0)
    said = ""
    for name, (low, high) in _BOUNDS.items():
        outside = ~bad & ~((values[name] >= low) & (values[name] <= high))
        if outside.any() and not said:
            k = np.argmax(outside)
            said = (
                f" (at {time[k]:.1f} s {name} = {values[name][k]:.3g}: expected {low:g} to "
                f"{high:g})"
            )
        bad |= outside
    if not bad.any():
        return []
    for column in values.values():
        column[bad] = math.nan
    status[bad] = Status.MISFIT
    return [
        f"No soil has the values of {bad.sum()} of {bad.size} estimates{said}. They are left out. "
        "Perhaps a unit, a sign or the wheel in the map is wrong."
    ]


def _grounds(
    log: Aligned,
    log_map: LogMap,
    borders: np.ndarray,
    values: dict[str, np.ndarray],
    status: np.ndarray,
    prior: Estimate,
) -> tuple[np.ndarray, list[float]]:
    """(Number [N] from 1 of the ground at each step, probability for each ground that its soil is
    not that of the ground before).

    `borders` [N]: count of those found so far. They and gaps part the drive. A part shorter than
    `_LEAST_PART`, as a long border is found twice, or without an estimate is joined to the next.
    Where a gap ends it, it is joined to the one before if it has no estimate. A part that differs
    with a probability below `DIFFERS` belongs to the ground before, and the two estimates are
    pooled. The first part after a gap is a ground of its own, with NaN.
    """
    where = log.travelled(log_map.wheel.radius)
    border = log_map.belief.border  # [m] its length
    gap = np.diff(log.time, append=math.inf) > log_map.restart_gap
    out = np.zeros(len(log), np.int64)
    begins = 0  # first step of the part
    before = None  # estimate of the ground before, None after a gap
    differs = []
    # Last step of each part.
    for end in np.flatnonzero((np.diff(borders, append=borders[-1:] + 1) != 0) | gap).tolist():
        settled = end  # last step whose estimate is of this part alone
        if not gap[end]:
            if where[end] - where[begins] < _LEAST_PART * border:
                continue
            settled = np.searchsorted(where, where[end] - _LEFT * border, side="right") - 1
        here = _last_known(values, status, begins, max(settled, begins), prior)
        if here is None and not gap[end]:
            continue
        if before is None:
            differs.append(math.nan)
        elif here is not None:
            probability = _probability_of_two(before, here)
            if probability < DIFFERS:
                here = _pooled(before, here)
            else:
                differs.append(probability)
        out[begins : end + 1] = len(differs)
        begins = end + 1
        before = None if gap[end] else here
    return out, differs


def _last_known(
    values: dict[str, np.ndarray], status: np.ndarray, first: int, last: int, prior: Estimate
) -> np.ndarray | None:
    """Last estimate of the steps `first` to `last` relative to the prior [2, 4], for `_COMPARED`.

    The first row has deviations from the prior in its sds, of the logarithm where the sd is
    relative. The second has variances over the prior's, at most 1. None without an estimate in
    these steps.
    """
    known = (status != Status.NO_DATA) & np.isfinite(values["cohesion"])
    steps = np.flatnonzero(known[first : last + 1])
    if not steps.size:
        return None
    k = first + steps[-1]
    rows = []
    for name in _COMPARED:
        value = values[name][k]
        middle = getattr(prior, name)
        sd = SD_OF[name]
        scale = getattr(prior, sd)
        away = math.log(value / middle) if "relative" in sd else value - middle
        rows.append((away / scale, min(values[sd][k] / scale, 1.0) ** 2))
    return np.transpose(rows)


def _probability_of_two(one: np.ndarray, other: np.ndarray) -> float:
    """Probability, `_SEEN` a priori, that the soils of two estimates (`_last_known`) differ.

    Soils have variance 1 about the prior. An estimate whose error has the variance v has itself the
    variance 1 - v about the prior, since it is drawn towards it. The difference of two estimates
    (v, w) of one soil has the variance v + w - 2 v w, that of two independent soils 2 - v - w. Each
    estimate adds `_DOUBTED`^2 to both variances.
    """
    away = one[0] - other[0]
    doubt = 2.0 * _DOUBTED**2
    v = one[1]
    w = other[1]
    same = v + w - 2.0 * v * w + doubt
    apart = 2.0 - v - w + doubt
    odds = 0.5 * np.sum(np.log(same / apart) + away**2 * (1.0 / same - 1.0 / apart))
    odds += math.log(_SEEN / (1.0 - _SEEN))
    return float(expit(odds))


def _pooled(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """One estimate [2, 4] from two of one soil (`_last_known`), each weighted by 1/variance.

    Both contain the prior (0, 1), so its weight of 1 is taken off once.
    """
    own = 1.0 / np.maximum(one[1], _LEAST_VARIANCE)
    more = 1.0 / np.maximum(other[1], _LEAST_VARIANCE)
    return np.array([one[0] * own + other[0] * more, np.ones_like(own)]) / (own + more - 1.0)


#: Quantities and the readings that measure them.
_SENSORS = {
    "sinkage": {"sinkage"},
    "load": {"load"},
    "drawbar pull": {"drawbar_pull", "acceleration"},
    "torque": {"torque", "motor_torque"},
}
_NOTHING = "Sinkage and forces are not measured. Only the slip is known, which identifies nothing."
_NO_FORCE = (
    "Drawbar pull and torque are not measured, so nothing shows shear. Only the sinkage "
    "coefficient S is identified, by the load or, where that is not measured, the weight. Friction "
    "angle, cohesion and K follow from it by the correlations of the belief."
)
_MISFIT = (
    "In {:.0f} % of the steps the readings contradict the model by more than their errors explain. "
    "Perhaps a unit, a sign or the wheel in the map is wrong, the belief leaves out this soil, or "
    "the laws of the model do not hold here."
)


def findings(found: Replay, log: Aligned, log_map: LogMap) -> list[str]:
    """Sentences on what can be identified from the channels of this log, and what was.

    A parameter counts as identified if an estimate with status CONVERGED has an sd below `_LEARNT`
    of the prior's (`Replay.learnt`).
    """
    measured = found.measured
    lines = []
    if "motor_torque" in log.readings and log_map.wheel.inertia == UNKNOWN_INERTIA:
        lines.append(
            "The motor torque is left out because the map lacks wheel.inertia [kg m2], which "
            "has to include rotor and gearbox."
        )
    if not measured & {"drawbar_pull", "acceleration", "torque", "motor_torque"}:
        lines.append(_NO_FORCE if "sinkage" in measured else _NOTHING)
    missing = [words for words, of in _SENSORS.items() if not measured & of]
    if missing and len(missing) < len(_SENSORS):
        lines.append(
            f"Not measured: {', '.join(missing)}. The standard deviations allow for that. Whether "
            "these quantities would contradict the estimate cannot be seen."
        )
    names = {
        "friction_angle_deg": "The friction angle",
        "shear_modulus": "K",
        "sinkage_coefficient": "S",
    }
    shares = found.learnt()
    current = found.learnt(current=True)
    for name, words in names.items():
        result = "is identified" if current[name] < _LEARNT else "is not identified"
        if shares[name] < _LEARNT <= current[name]:
            result = "is not identified by any estimate that was current"
        lines.append(
            f"{words} {result}. Its least standard deviation is {shares[name]:.2f} of the prior's."
        )
    return [
        *lines,
        f"The estimate was current in {100.0 * np.mean(found.status == Status.CONVERGED):.0f} % of "
        "the steps.",
    ]


def contradiction(found: Replay) -> tuple[list[str], list[str]]:
    """(doubts, further findings) on the share of the steps in which readings contradict the model.

    One sentence at most: a doubt where the share is above `_MOSTLY`, a finding where it is above
    `_CONTRADICTS`. Both lists are empty below.
    """
    misfit = np.mean(found.status == Status.MISFIT)
    said = [_MISFIT.format(100.0 * misfit)] if misfit > _CONTRADICTS else []
    return (said, []) if misfit > _MOSTLY else ([], said)
