"""The online identifier over a log: the soil under the wheel and its uncertainty over time.

Borders are those that the identifier finds by the grade and the forces. It finds more than there
are, so a border counts as one between grounds only where the estimates on both sides differ
(`_probability_of_two`).
"""

import math
from dataclasses import dataclass, fields

import numpy as np

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
#: Standard deviation of each parameter of the soil, by its name.
SD_OF = {
    "friction_angle_deg": "friction_angle_sd_deg",
    "shear_modulus": "shear_modulus_relative_sd",
    "sinkage_coefficient": "sinkage_coefficient_relative_sd",
    "cohesion": "cohesion_sd",
    "dig_gain": "dig_gain_relative_sd",
}
DIFFERS = 0.5  # probability from which the ground behind a border counts as another
_LEARNT = 0.8  # sd over prior sd, below which something was learnt
_LEAST_LOAD = 1e-9  # [N] of a wheel that is lifted, or whose reading of the load has noise
_CONTRADICTS = 0.1  # share of the steps with status MISFIT, beyond which the report says so
_LEFT = 1.2  # [border lengths] before a border that the identifier found, where it may have begun
#: Of two grounds.
_COMPARED = ("friction_angle_deg", "shear_modulus", "sinkage_coefficient", "cohesion")
_SEEN = 0.8  # prior probability that there is another soil behind a border that the identifier saw
_DOUBTED = 0.1  # [prior sd] by which every estimate may be off beside its own sd
#: Of the parameters of a soil but the gain of slip-sinkage, of which little may be known.
_BOUNDS = {
    f.name: (f.metadata["low"], f.metadata["high"])
    for f in fields(Soil)
    if f.name in ESTIMATED and f.name != "dig_gain"
}
_NO_WAY = (math.nan,) * 3  # margin, its sd and torque of a step without them


@dataclass(frozen=True, eq=False)
class Replay:
    """Estimates over the steps of a log."""

    time: np.ndarray  # [N] s
    #: [N] each, by `COLUMNS`; the last three NaN before the first, all where refused.
    values: dict[str, np.ndarray]
    status: np.ndarray  # [N] `Status`
    renewed: np.ndarray  # [N] bool: changed in this step
    #: [N] int from 1: one more at each border to another soil, and after each gap.
    ground: np.ndarray
    #: Probability, by ground, that its soil is not that of the last; NaN of the first after a gap.
    differs: list[float]
    borders: int  # that the identifier found, whatever lies behind them
    prior: Estimate
    on_border: np.ndarray  # [N] bool: the ground is a blend of two soils, better known than either
    measured: frozenset[str]  # readings that the identifier received
    restarts: int  # because of gaps
    warnings: list[str]

    def csv(self) -> str:
        """One line a step: time, estimate, standard deviations, margin, status, ground."""
        lines = [",".join(("time", *COLUMNS, "status", "renewed", "ground"))]
        columns = zip(*(self.values[n].tolist() for n in COLUMNS), strict=True)
        states = zip(self.status.tolist(), self.renewed, self.ground, strict=True)
        for t, row, (status, new, ground) in zip(self.time.tolist(), columns, states, strict=True):
            cells = ",".join("" if x != x else f"{x:.8g}" for x in row)
            lines.append(f"{t:.9g},{cells},{Status(status).name},{int(new)},{ground}")
        return "\n".join(lines) + "\n"

    def surest_on(self, ground: int) -> dict[str, float] | None:
        """The surest current estimate on a ground, by `COLUMNS`; None where there was none.

        The last may be the prior's, behind a border that was none.
        """
        current = np.flatnonzero((self.ground == ground) & (self.status == Status.CONVERGED))
        if not current.size:
            return None
        sds = [self.values[sd][current] / getattr(self.prior, sd) for sd in SD_OF.values()]
        k = current[np.argmin(np.sum(np.log(sds), axis=0))]
        return {name: float(values[k]) for name, values in self.values.items()}

    def learnt(self, current: bool = False) -> dict[str, float]:
        """Least standard deviation over that of the prior, for each parameter: 1 where nothing was
        learnt.

        Of the estimates away from borders that the readings do not contradict; `current`: with
        status CONVERGED.
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
    `OnlineIdentifier.traversability`, renewed with the estimate. An estimate out of the bounds of
    `Soil` is refused: NaN, with status MISFIT.
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
    found = np.zeros(size, np.int64)
    restarts = 0
    renewed = np.zeros(size, bool)
    on_border = np.zeros(size, bool)
    table = np.empty((size, len(COLUMNS)))
    names = set(log.readings)
    if log_map.wheel.inertia == UNKNOWN_INERTIA:
        names.discard("motor_torque")
    before = 0
    last = math.nan
    way = _NO_WAY
    for k, t in enumerate(log.time.tolist()):
        if t - last > log_map.restart_gap:
            before += identifier.estimate.borders
            identifier.reset()
            restarts = restarts + 1
            way = _NO_WAY
        reading = Readings(**{n: float(log.readings[n][k]) for n in names}, time=t)
        e = identifier.update(reading)
        if e.renewed:
            load = None if math.isnan(reading.load) else max(reading.load, _LEAST_LOAD)
            ahead = identifier.traversability(load, float(np.nan_to_num(reading.pitch)))
            way = ahead.drawbar_margin, ahead.drawbar_margin_sd, ahead.torque_required
        table[k] = [*(getattr(e, name) for name in ESTIMATED), *way]
        status[k] = e.status
        renewed[k] = e.renewed
        on_border[k] = identifier.on_border
        found[k] = before + e.borders
        last = t
    values = {name: table[:, i] for i, name in enumerate(COLUMNS)}
    warnings = []
    if restarts:
        warnings.append(
            f"The identifier started anew {'once' if restarts == 1 else f'{restarts} times'}, "
            f"after gaps of more than {log_map.restart_gap:g} s."
        )
    warnings += _refused(log.time, values, status)
    ground, differs = _grounds(log, log_map, found, values, status, prior)
    return Replay(
        log.time,
        values,
        status,
        renewed,
        ground,
        differs,
        int(found.max(initial=0)),
        prior,
        on_border,
        frozenset(names),
        restarts,
        warnings,
    )


def _refused(time: np.ndarray, values: dict[str, np.ndarray], status: np.ndarray) -> list[str]:
    """Put NaN in place of estimates out of the bounds of a soil, in `values` itself, with MISFIT
    in `status`; a line that says so, where there are some.
    """
    bad = ~np.all([np.isfinite(values[n]) for n in ESTIMATED], axis=0)
    said = ""
    for name, (low, high) in _BOUNDS.items():
        outside = ~bad & ~((values[name] >= low) & (values[name] <= high))
        if outside.any() and not said:
            k = int(np.argmax(outside))
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
    found: np.ndarray,
    values: dict[str, np.ndarray],
    status: np.ndarray,
    prior: Estimate,
) -> tuple[np.ndarray, list[float]]:
    """Number [N] from 1 of the ground at each step, and the probability by ground that it is not as
    the last.

    `found` [N]: borders found so far. A part shorter than two borders is part of the next: a
    border that is long is found twice. A part whose estimate does not differ from that of the
    ground before is part of that.
    """
    where = log.travelled(log_map.wheel.radius)
    border = log_map.belief.border
    gap = np.diff(log.time, append=math.inf) > log_map.restart_gap
    out = np.zeros(len(log), np.int64)
    begins = 0
    before = None
    differs = []
    for end in np.flatnonzero((np.diff(found, append=found[-1:] + 1) != 0) | gap).tolist():
        settled = end
        if not gap[end]:
            if where[end] - where[begins] < 2.0 * border:
                continue
            settled = int(np.searchsorted(where, where[end] - _LEFT * border, side="right")) - 1
        here = _last_known(values, status, begins, max(settled, begins), prior)
        two = math.nan if before is None else _probability_of_two(before, here)
        if before is not None and two < DIFFERS:
            here = _pooled(before, here)
        else:
            differs.append(two)
        out[begins : end + 1] = len(differs)
        begins = end + 1
        before = None if gap[end] else here
    return out, differs


def _last_known(
    values: dict[str, np.ndarray], status: np.ndarray, first: int, last: int, prior: Estimate
):
    """[2, 4] of `_COMPARED` at the last known step of `first` to `last`, over the prior's sd:
    deviation from the prior, and variance; (0, 1) if there is none.
    """
    known = (status != Status.NO_DATA) & np.isfinite(values["cohesion"])
    steps = np.flatnonzero(known[first : last + 1])
    if not steps.size:
        return np.repeat([[0.0], [1.0]], len(_COMPARED), axis=1)
    k = first + steps[-1]
    rows = []
    for name in _COMPARED:
        value = float(values[name][k])
        middle = getattr(prior, name)
        scale = getattr(prior, SD_OF[name])
        away = math.log(value / middle) if "relative" in SD_OF[name] else value - middle
        rows.append((away / scale, min(float(values[SD_OF[name]][k]) / scale, 1.0) ** 2))
    return np.transpose(rows)


def _probability_of_two(one: np.ndarray, other: np.ndarray) -> float:
    """Probability that the soils of two estimates (`_last_known`) differ, if it was `_SEEN` before.

    An estimate of variance v, of a soil that scatters by 1, scatters by 1 - v itself. Two of one
    soil have in common what they take from the prior: their difference has the variance v + w - 2 v
    w. Two of two soils have 2 - v - w.
    """
    away = one[0] - other[0]
    doubt = 2.0 * _DOUBTED**2
    v = one[1]
    w = other[1]
    same = v + w - 2.0 * v * w + doubt
    apart = 2.0 - v - w + doubt
    odds = 0.5 * float(np.sum(np.log(same / apart) + away**2 * (1.0 / same - 1.0 / apart)))
    odds += math.log(_SEEN / (1.0 - _SEEN))
    return 1.0 / (1.0 + math.exp(-min(max(odds, -50.0), 50.0)))


def _pooled(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The estimate of two of one soil, whose prior (0, 1) counts once."""
    own = 1.0 / np.maximum(one[1], 1e-9)
    more = 1.0 / np.maximum(other[1], 1e-9)
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
    "coefficient S is identified, if the load is measured. Friction angle, cohesion and K follow "
    "from it by the correlations of the belief."
)
_MISFIT = (
    "In {:.0f} % of the steps the readings contradict the model by more than their errors explain. "
    "Perhaps a unit, a sign or the wheel in the map is wrong, the belief leaves out this soil, or "
    "the laws of the model do not hold here."
)


def findings(found: Replay, log: Aligned) -> list[str]:
    """Sentences on what can be identified from the channels of this log, and what was."""
    measured = found.measured
    lines = []
    if "motor_torque" in log.readings and "motor_torque" not in measured:
        lines.append(
            "The motor torque is left out because the map lacks wheel.inertia [kg m2], which "
            "has to include rotor and gearbox."
        )
    forces = measured & {"drawbar_pull", "acceleration", "torque", "motor_torque"}
    if not forces:
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
    current_share = 100.0 * np.mean(found.status == Status.CONVERGED)
    lines.append(f"The estimate was current in {current_share:.0f} % of the steps.")
    misfit = np.mean(found.status == Status.MISFIT)
    if misfit > _CONTRADICTS:
        lines.append(_MISFIT.format(100.0 * misfit))
    return lines
