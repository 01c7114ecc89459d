"""The online identifier over a log: the soil under the wheel and its uncertainty over time."""

from __future__ import annotations

import dataclasses
import math
from dataclasses import dataclass

import numpy as np

from soil_env.logs.align import Aligned
from soil_env.logs.mapping import LogMap
from soil_env.online import Estimate, OnlineIdentifier, Readings, Status

#: Numbers of an estimate, in the order of the columns of estimates.csv.
ESTIMATED = tuple(n for n in Estimate.__dataclass_fields__ if n not in ("status", "renewed", "borders"))
COLUMNS = (*ESTIMATED, "drawbar_margin", "torque_required")
_LEARNT = 0.8  # sd over prior sd, below which something was learnt
_LEAST_LOAD = 1e-9  # [N] of a wheel that is lifted, or whose reading of the load has noise
_CONTRADICTS = 0.2  # share of the steps with status MISFIT, beyond which it is told


@dataclass(frozen=True, eq=False)
class Replay:
    """Estimates over the steps of a log."""

    time: np.ndarray  # [N] s
    values: dict[str, np.ndarray]  # [N] each, by `COLUMNS`; the last two NaN before the first estimate
    status: np.ndarray  # [N] `Status`
    renewed: np.ndarray  # [N] bool: changed in this step
    ground: np.ndarray  # [N] int from 1: one more at each border to another soil that was found, and at each restart
    prior: Estimate
    method: str  # of the belief: "filter", "window"
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

        Of the estimates that the readings do not contradict; `current`: of those with status CONVERGED.
        """
        kept = self.status == Status.CONVERGED
        kept = kept if current else kept | (self.status == Status.NOT_EXCITED)
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

    After a gap of more than `restart_gap` it starts from the prior again. The drawbar margin and the torque required
    are those of `OnlineIdentifier.traversability`, renewed with the estimate. Borders are those that the filter finds,
    also where the belief asks for the window, which starts anew more often than the soil changes.
    """
    identifier = identifier_of(log_map)
    by_filter = dataclasses.replace(log_map, belief=dataclasses.replace(log_map.belief, method="filter"))
    finder = identifier if log_map.belief.method == "filter" else identifier_of(by_filter)
    prior, size = identifier.estimate, len(log)
    status, renewed, ground = np.zeros(size, np.int64), np.zeros(size, bool), np.ones(size, np.int64)
    names = [n for n in Readings._fields if n in log.readings]
    rows = np.column_stack([log.readings[n] for n in names]).tolist()
    loads, pitches = (log.readings.get(n, np.full(size, math.nan)).tolist() for n in ("load", "pitch"))
    restarts, before, last, ahead = 0, 0, math.nan, (math.nan, math.nan)
    table = np.empty((size, len(COLUMNS)))
    for k, (t, row) in enumerate(zip(log.time.tolist(), rows, strict=True)):
        if t - last > log_map.restart_gap:
            before += finder.estimate.borders
            identifier.reset()
            finder.reset()
            restarts += 1
            ahead = math.nan, math.nan
        reading = Readings(**dict(zip(names, row, strict=True)), time=t)
        e = identifier.update(reading)
        found = e if finder is identifier else finder.update(reading)
        ground[k] = 1 + restarts + before + found.borders
        if e.renewed:
            load, pitch = loads[k], pitches[k] if pitches[k] == pitches[k] else 0.0
            way = identifier.traversability(None if load != load else max(load, _LEAST_LOAD), pitch)
            ahead = way.drawbar_margin, way.torque_required
        table[k], status[k], renewed[k], last = _numbers(e, *ahead), e.status, e.renewed, t
    values = {name: table[:, i] for i, name in enumerate(COLUMNS)}
    warnings = _impassable(log, values["drawbar_margin"], status)
    if restarts:
        warnings.insert(0, f"Started anew {restarts} times, after gaps of more than {log_map.restart_gap:g} s")
    ground = _stretches(log, log_map, ground)
    return Replay(log.time, values, status, renewed, ground, prior, log_map.belief.method, restarts, warnings)


def _stretches(log: Aligned, log_map: LogMap, ground: np.ndarray) -> np.ndarray:
    """`ground` [N] numbered anew from 1, a stretch shorter than two borders being a part of the next.

    A soil that the belief does not expect is found out of it twice, and so is a border that is long.
    """
    where, out = log.travelled(log_map.wheel.radius), np.zeros(len(log), np.int64)
    begins, number = 0, 1
    for k in [*(np.flatnonzero(np.diff(ground)) + 1).tolist(), len(log)]:
        whole = k == len(log) or log.time[k] - log.time[k - 1] > log_map.restart_gap
        if whole or where[k - 1] - where[begins] >= 2.0 * log_map.belief.border:
            out[begins:k] = number
            begins, number = k, number + 1
    return out


def _numbers(e: Estimate, margin: float, torque: float) -> list[float]:
    return [*(getattr(e, name) for name in ESTIMATED), margin, torque]


def _impassable(log: Aligned, margin: np.ndarray, status: np.ndarray) -> list[str]:
    """A sentence for each stretch whose ground, by a current estimate, has no drawbar pull to spare over the grade."""
    bad = (margin <= 0.0) & (status == Status.CONVERGED)
    edges = np.flatnonzero(np.diff(np.concatenate(([False], bad, [False])).astype(int)))
    lines = []
    for first, end in edges.reshape(-1, 2):
        least = float(np.min(margin[first:end]))
        lines.append(
            f"{log.time[first]:.1f} to {log.time[end - 1]:.1f} s: impassable as identified, drawbar margin down to "
            f"{least:.3f} of the load"
        )
    return lines


def what_can_be_told(found: Replay, measured: set[str]) -> list[str]:
    """Sentences on what the channels of this log can tell of the soil, and what they did."""
    pull, torque = measured & {"drawbar_pull", "acceleration"}, measured & {"torque", "motor_torque"}
    lines, followed = [], found.method == "filter"
    if "sinkage" not in measured and not pull and not torque:
        lines.append("Neither sinkage nor a force: the slip is known, and nothing can be told of the soil.")
    elif "sinkage" not in measured and followed:
        lines.append(
            "No sinkage: the filter follows it by the law of slip-sinkage, from that of the belief under the weight. "
            "The soil is told by the forces alone, S with wider intervals."
        )
    elif "sinkage" not in measured:
        lines.append(
            "No sinkage: the window learns nothing, its equations need the arc of contact (belief: {method: filter} "
            "does without). The steady points still serve the discrepancy workflow."
        )
    elif not pull and not torque:
        lines.append(
            "Neither drawbar pull nor torque: friction angle, cohesion and K are not told: nothing measures shear. "
            "The sinkage coefficient S is, if the load is measured, within what the exponent of the belief allows."
        )
        if followed:
            lines.append("What the filter says of them here comes by what the belief has them to do with S.")
    elif not torque:
        lines.append("No torque: friction angle and K follow from the drawbar pull alone, S from load and pull.")
    elif not pull:
        lines.append("No drawbar pull: friction angle and K follow from the torque alone, S from the load.")
    if "load" not in measured and followed:
        lines.append("No load: the weight on the wheel stands for it, doubted by 20 % as far as no force tells more.")
    elif "load" not in measured:
        lines.append("No load: the weight on the wheel stands for it, and vertical equilibrium, Eq. (1), adds nothing.")
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
            "predicts than their errors explain: a wrong unit, sign or wheel in the map, or a wheel that is another."
        )
    return lines
