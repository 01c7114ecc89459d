"""The online identifier over a log: the soil under the wheel and its uncertainty over time.

Borders are those that the identifier finds by the grade and the forces. It finds more than there are, so a border
counts as one between grounds only where the estimates on both sides differ (`_differ`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from soil_env.logs.align import Aligned
from soil_env.logs.mapping import LogMap
from soil_env.online import Estimate, OnlineIdentifier, Readings, Status, slips
from soil_env.parameters import Soil
from soil_env.slip import travel_speeds

#: Numbers of an estimate, in the order of the columns of estimates.csv.
ESTIMATED = tuple(n for n in Estimate.__dataclass_fields__ if n not in ("status", "renewed", "borders"))
COLUMNS = (*ESTIMATED, "drawbar_margin", "drawbar_margin_sd", "torque_required")
DIFFERS = 0.5  # probability from which the ground behind a border counts as another
_SURE = 0.95  # probability from which ground is called impassable
_LEARNT = 0.8  # sd over prior sd, below which something was learnt
_LEAST_LOAD = 1e-9  # [N] of a wheel that is lifted, or whose reading of the load has noise
_CONTRADICTS = 0.2  # share of the steps with status MISFIT, beyond which it is told
_SPINS = 0.9  # slip from which a wheel does not travel
_LEFT = 1.2  # [border lengths] before a border that the identifier found, where it may have begun
_COMPARED = {  # of two grounds: value, its sd, and whether the sd is relative
    "friction_angle_deg": ("friction_angle_sd_deg", False),
    "shear_modulus": ("shear_modulus_relative_sd", True),
    "cohesion": ("cohesion_sd", False),
}
_SEEN = 0.8  # probability that there is another soil behind a border that the identifier saw, whatever the estimates
_DOUBTED = 0.1  # of the prior sd, by which every estimate may be off beside its own
_BOUNDS = {f.name: (f.metadata["low"], f.metadata["high"]) for f in fields(Soil) if f.name in ESTIMATED}


@dataclass(frozen=True, eq=False)
class Replay:
    """Estimates over the steps of a log."""

    time: np.ndarray  # [N] s
    values: dict[str, np.ndarray]  # [N] each, by `COLUMNS`; the last three NaN before the first, all where refused
    status: np.ndarray  # [N] `Status`
    renewed: np.ndarray  # [N] bool: changed in this step
    ground: np.ndarray  # [N] int from 1: one more at each border to another soil, and after each gap
    differs: list[float]  # probability, by ground, that its soil is not that of the last; NaN of the first after a gap
    borders: int  # that the identifier found, whatever lies behind them
    prior: Estimate
    on_border: np.ndarray  # [N] bool: the ground is a blend of two soils, better known than either
    measured: frozenset[str]  # readings that the identifier was given
    restarts: int  # because of gaps
    warnings: list[str]

    def csv(self) -> str:
        """One line a step: time, estimate, standard deviations, margin, status, ground."""
        lines = [",".join(("time", *COLUMNS, "status", "renewed", "ground"))]
        columns = zip(*(self.values[n].tolist() for n in COLUMNS), strict=True)
        states = zip(self.status.tolist(), self.renewed, self.ground, strict=True)
        for t, row, (status, new, ground) in zip(self.time.tolist(), columns, states, strict=True):
            cells = ["" if x != x else f"{x:.8g}" for x in row]
            lines.append(f"{t:.9g},{','.join(cells)},{Status(status).name},{int(new)},{ground}")
        return "\n".join(lines) + "\n"

    def last_on(self, ground: int) -> dict[str, float] | None:
        """The last current estimate on a ground, by `COLUMNS`; None where there was none."""
        current = np.flatnonzero((self.ground == ground) & (self.status == Status.CONVERGED))
        return {name: float(values[current[-1]]) for name, values in self.values.items()} if current.size else None

    def learnt(self, current: bool = False) -> dict[str, float]:
        """Least standard deviation over that of the prior, for each parameter: 1 where nothing was learnt.

        Of the estimates away from borders that the readings do not contradict; `current`: with status CONVERGED.
        """
        kept = self.status == Status.CONVERGED
        kept = ~self.on_border & (kept if current else kept | (self.status == Status.NOT_EXCITED))
        return {
            name: float(np.min(self.values[sd], where=kept, initial=getattr(self.prior, sd))) / getattr(self.prior, sd)
            for name, sd in {
                "friction_angle_deg": "friction_angle_sd_deg",
                "shear_modulus": "shear_modulus_relative_sd",
                "sinkage_coefficient": "sinkage_coefficient_relative_sd",
                "cohesion": "cohesion_sd",
                "dig_gain": "dig_gain_relative_sd",
            }.items()
        }


def identifier_of(log_map: LogMap) -> OnlineIdentifier:
    """The identifier that a map describes."""
    return OnlineIdentifier(
        log_map.wheel.wheel(), log_map.belief, log_map.noise(), period=log_map.period, gravity=log_map.gravity,
        relaxation=log_map.relaxation,
    )  # fmt: skip


def replay(log: Aligned, log_map: LogMap) -> Replay:
    """Give the readings of a log to the online identifier, step by step.

    After a gap of more than `restart_gap` it starts from the prior again. A motor torque without the inertia of the
    wheel is left out. The drawbar margin and the torque required are those of `OnlineIdentifier.traversability`,
    renewed with the estimate. An estimate that is of no soil is refused: NaN, with status MISFIT.
    """
    identifier = identifier_of(log_map)
    prior, size = identifier.estimate, len(log)
    status, renewed, found = np.zeros(size, np.int64), np.zeros(size, bool), np.zeros(size, np.int64)
    on_border = np.zeros(size, bool)
    blind = log_map.wheel.inertia is None and "motor_torque" in log.readings
    names = [n for n in Readings._fields if n in log.readings and not (blind and n == "motor_torque")]
    rows = np.column_stack([log.readings[n] for n in names]).tolist()
    loads, pitches = (log.readings.get(n, np.full(size, math.nan)).tolist() for n in ("load", "pitch"))
    restarts, before, last, ahead = 0, 0, math.nan, (math.nan,) * 3
    table = np.empty((size, len(COLUMNS)))
    for k, (t, row) in enumerate(zip(log.time.tolist(), rows, strict=True)):
        if t - last > log_map.restart_gap:
            before += identifier.estimate.borders
            identifier.reset()
            restarts += 1
            ahead = (math.nan,) * 3
        reading = Readings(**dict(zip(names, row, strict=True)), time=t)
        e = identifier.update(reading)
        found[k], on_border[k] = before + e.borders, identifier.on_border
        if e.renewed:
            load, pitch = loads[k], pitches[k] if pitches[k] == pitches[k] else 0.0
            way = identifier.traversability(None if load != load else max(load, _LEAST_LOAD), pitch)
            ahead = way.drawbar_margin, way.drawbar_margin_sd, way.torque_required
        table[k], status[k], renewed[k], last = _numbers(e, *ahead), e.status, e.renewed, t
    values, warnings = {name: table[:, i] for i, name in enumerate(COLUMNS)}, []
    if restarts:
        warnings.append(f"Started anew {restarts} times, after gaps of more than {log_map.restart_gap:g} s")
    warnings += _refused(log.time, values, status)
    ground, differs = _grounds(log, log_map, found, values, status, prior)
    warnings += _impassable(log, log_map, ground, values, status)
    borders = int(found[-1]) if size else 0
    return Replay(
        log.time,
        values,
        status,
        renewed,
        ground,
        differs,
        borders,
        prior,
        on_border,
        frozenset(names),
        restarts,
        warnings,
    )


def _numbers(e: Estimate, *ahead: float) -> list[float]:
    return [*(getattr(e, name) for name in ESTIMATED), *ahead]


def _refused(time: np.ndarray, values: dict[str, np.ndarray], status: np.ndarray) -> list[str]:
    """Put NaN in place of estimates that are of no soil; a line that says so, where there are some."""
    bad, said = ~np.all([np.isfinite(values[n]) for n in ESTIMATED], axis=0), ""
    for name, (low, high) in _BOUNDS.items():
        if name == "dig_gain":  # of which little may be known
            continue
        outside = ~bad & ~((values[name] >= low) & (values[name] <= high))
        if outside.any() and not said:
            k = int(np.argmax(outside))
            said = f" (at {time[k]:.1f} s {name} = {values[name][k]:.3g}: expected {low:g} to {high:g})"
        bad |= outside
    if not bad.any():
        return []
    for column in values.values():
        column[bad] = math.nan
    status[bad] = Status.MISFIT
    return [f"{bad.sum()} of {bad.size} estimates are refused, being of no soil{said}: a wrong unit, sign or wheel?"]


# --- grounds ----------------------------------------------------------------------------------------------------------


def _grounds(
    log: Aligned, log_map: LogMap, found: np.ndarray, values: dict[str, np.ndarray], status: np.ndarray, prior: Estimate
) -> tuple[np.ndarray, list[float]]:
    """Number [N] from 1 of the ground at each step, and the probability by ground that it is not as the last.

    `found` [N]: borders found so far. A stretch shorter than two borders is part of the next: a border that is long is
    found twice. A stretch whose estimate does not differ from that of the ground before is part of that.
    """
    where, border, size = log.travelled(log_map.wheel.radius), log_map.belief.border, len(log)
    gap, out = np.diff(log.time, append=math.inf) > log_map.restart_gap, np.zeros(size, np.int64)
    ends = np.flatnonzero((np.diff(found, append=found[-1:] + 1) != 0) | gap).tolist() if size else []
    begins, before, differs = 0, None, []
    for end in ends:
        if not gap[end] and where[end] - where[begins] < 2.0 * border:
            continue
        settled = end if gap[end] else int(np.searchsorted(where, where[end] - _LEFT * border, side="right")) - 1
        here = _compared(values, status, begins, max(settled, begins), prior)
        differs.append(math.nan if before is None else _differ(before, here))
        if before is not None and differs[-1] < DIFFERS:
            differs.pop()
            here = _pooled(before, here)
        out[begins : end + 1], begins = len(differs), end + 1
        before = None if gap[end] else here
    return out, differs


def _compared(values: dict[str, np.ndarray], status: np.ndarray, begins: int, at: int, prior: Estimate) -> np.ndarray:
    """(Value, variance) [2, 3] of `_COMPARED` over the sd of the prior, as last known in the steps `begins` to `at`."""
    steps = slice(begins, at + 1)
    known = np.flatnonzero((status[steps] != Status.NO_DATA) & np.isfinite(values["cohesion"][steps]))
    if known.size == 0:
        return np.array([np.zeros(len(_COMPARED)), np.ones(len(_COMPARED))])
    k, rows = begins + int(known[-1]), []
    for name, (sd, relative) in _COMPARED.items():
        value, middle = float(values[name][k]), getattr(prior, name)
        away = math.log(value / middle) if relative else value - middle
        rows.append((away / getattr(prior, sd), min(float(values[sd][k]) / getattr(prior, sd), 1.0) ** 2))
    return np.array(rows).T


def _differ(one: np.ndarray, other: np.ndarray) -> float:
    """Probability that the soils of two estimates (`_compared`) differ, if it was `_SEEN` before.

    An estimate of variance v, of a soil that scatters by 1, scatters by 1 - v itself. Two of one soil have in common
    what they take from the prior: their difference has the variance v + w - 2 v w. Two of two soils have 2 - v - w.
    """
    away, doubt = one[0] - other[0], 2.0 * _DOUBTED**2
    v, w = one[1], other[1]
    same, apart = v + w - 2.0 * v * w + doubt, 2.0 - v - w + doubt
    odds = 0.5 * float(np.sum(np.log(same / apart) + away**2 * (1.0 / same - 1.0 / apart)))
    odds += math.log(_SEEN / (1.0 - _SEEN))
    return 1.0 / (1.0 + math.exp(-min(max(odds, -50.0), 50.0)))


def _pooled(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """The estimate of two of one soil, whose prior (0, 1) counts once."""
    precision = 1.0 / np.maximum(one[1], 1e-9) + 1.0 / np.maximum(other[1], 1e-9) - 1.0
    value = (one[0] / np.maximum(one[1], 1e-9) + other[0] / np.maximum(other[1], 1e-9)) / precision
    return np.array([value, 1.0 / precision])


def _impassable(
    log: Aligned, log_map: LogMap, ground: np.ndarray, values: dict[str, np.ndarray], status: np.ndarray
) -> list[str]:
    """A line for each ground that has no drawbar pull to spare over the grade, where the wheel got no radius further.

    It got further as far as it travelled without spinning; what it rolled back counts against that.
    """
    nan, radius = np.full(len(log), math.nan), log_map.wheel.radius
    rim, speed = log.readings["wheel_speed"] * radius, log.readings.get("speed", nan)
    slip = log.readings.get("slip", nan)
    slip = np.where(np.isnan(slip), slips(rim, speed), slip)
    speed = np.nan_to_num(np.where(np.isnan(speed), travel_speeds(rim, np.clip(slip, -_SPINS, 1.0)), speed))
    speed[(speed > 0.0) & (slip >= _SPINS)] = 0.0
    place = np.cumsum(speed * np.minimum(np.diff(log.time, prepend=0.0), log.period))
    ahead = np.maximum.accumulate(place[::-1])[::-1] - place
    margin, sd, lines = values["drawbar_margin"], values["drawbar_margin_sd"], []
    chance = np.array([0.5 * math.erfc(m / (math.sqrt(2.0) * max(s, 1e-12))) for m, s in zip(margin, sd, strict=True)])
    bad = (chance > _SURE) & (status == Status.CONVERGED) & (ahead < radius)
    for number in np.unique(ground[bad]).tolist():
        here = np.flatnonzero(bad & (ground == number))
        k = here[np.argmax(chance[here])]
        lines.append(
            f"{log.time[here[0]]:.1f} to {log.time[here[-1]]:.1f} s: impassable with probability {chance[k]:.2f} as "
            f"identified, drawbar margin {margin[k]:.3f} +- {sd[k]:.3f} of the load"
        )
    return lines


# --- words ------------------------------------------------------------------------------------------------------------


def what_can_be_told(found: Replay, log: Aligned) -> list[str]:
    """Sentences on what the channels of this log can tell of the soil, and what they did."""
    measured, lines = found.measured, []
    if "motor_torque" in log.readings and "motor_torque" not in measured:
        lines.append("The motor torque is left out: the map lacks wheel.inertia [kg m2], rotor and gear included.")
    pull, torque = measured & {"drawbar_pull", "acceleration"}, measured & {"torque", "motor_torque"}
    if "sinkage" not in measured and not pull and not torque:
        lines.append("Neither sinkage nor a force: the slip is known, and nothing can be told of the soil.")
    elif "sinkage" not in measured:
        lines.append(
            "No sinkage: the filter follows it by the law of slip-sinkage, from that of the belief under the weight. "
            "The soil is told by the forces alone, S with wider intervals."
        )
    elif not pull and not torque:
        lines.append(
            "Neither drawbar pull nor torque: friction angle, cohesion and K are not told: nothing measures shear. "
            "The sinkage coefficient S is, if the load is measured, within what the exponent of the belief allows."
        )
        lines.append("What the filter says of them here comes by what the belief has them to do with S.")
    elif not torque:
        lines.append("No torque: friction angle and K follow from the drawbar pull alone, S from load and pull.")
    elif not pull:
        lines.append("No drawbar pull: friction angle and K follow from the torque alone, S from the load.")
    if "load" not in measured:
        lines.append("No load: the weight on the wheel stands for it, doubted by 5 %.")
    if "acceleration" in pull and "drawbar_pull" not in pull:
        lines.append(
            "The drawbar pull is the accelerometer's reading times the mass on the wheel, so far as that is known."
        )
    if "motor_torque" in torque and "torque" not in torque:
        lines.append("The torque is that of the motor less what accelerates the wheel: friction of the gear is in it.")
    if "slip" not in measured:
        lines.append("The slip follows from wheel and travel speed; an error of the wheel radius is an offset of it.")
    names = {"friction_angle_deg": "friction angle", "shear_modulus": "K", "sinkage_coefficient": "S"}
    shares, current = found.learnt(), found.learnt(current=True)
    for name, words in names.items():
        told = "told" if current[name] < _LEARNT else "not told: this is the prior"
        if shares[name] < _LEARNT <= current[name]:
            told = "narrowed, by estimates that were never current (no range of slip, or readings that contradict)"
        lines.append(f"{words}: {told} (standard deviation at best {shares[name]:.2f} of the prior's)")
    share = {s: float(np.mean(found.status == s)) if found.status.size else 0.0 for s in Status}
    lines.append(f"The estimate was current in {100.0 * share[Status.CONVERGED]:.0f} % of the steps.")
    if share[Status.MISFIT] > _CONTRADICTS:
        lines.append(
            f"In {100.0 * share[Status.MISFIT]:.0f} % of the steps the readings were further from what the model "
            "predicts than their errors explain: a wrong unit, sign or wheel in the map, a belief without this soil, "
            "or laws that do not hold here."
        )
    return lines
