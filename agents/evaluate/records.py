"""Detailed records of driven courses, and their metrics."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields

import numpy as np

from soil_env.env import IMMOBILISED
from soil_env.parameters import Scenario
from soil_env.simulation.task import Cause
from soil_env.terramechanics.model import WheelSoilModel

from . import driving
from .driving import Runs, Totals, drive
from .warning import Foresight, Warnings

#: Metric -> (unit, what it is). A course on which a metric is not defined is left out of it.
METRICS = {
    **{name: driving.METRICS[name] for name in driving.RATES},
    "warned": ("share of immobilised courses", "a warning was on at complete immobilisation"),
    "warning_distance": ("m", "from the warning to complete immobilisation, where warned"),
    "warning_time": ("s", "from the warning to complete immobilisation, where warned"),
    "false_warning": ("share of driving time", "under warning on courses without immobilisation"),
    "foreseen": ("share of immobilised courses", "the probability of immobilisation gave warning then"),
    "foreseen_distance": ("m", "from that warning to complete immobilisation, where foreseen"),
    "foreseen_time": ("s", "from that warning to complete immobilisation, where foreseen"),
    "false_foresight": ("share of driving time", "under that warning on courses without immobilisation"),
    **{name: driving.METRICS[name] for name in ("distance", "time", "speed", "energy_per_metre")},
    "tractive_efficiency": ("-", "drawbar work over motor work while driving with a drawbar pull > 0"),
    "slip": driving.METRICS["slip"],
    "slip_p50": ("-", "median slip over time, halts left out"),
    "slip_p95": ("-", "95th percentile of slip over time, halts left out"),
    "sinkage": driving.METRICS["sinkage"],
    "sinkage_p50": ("mm", "median sinkage over time, halts left out"),
    "sinkage_p95": ("mm", "95th percentile of sinkage over time, halts left out"),
    "return": driving.METRICS["return"],
}
RATES = (*driving.RATES, "warned", "foreseen")
_STUCK = [c.value for c in IMMOBILISED]


@dataclass(frozen=True)
class Records(Runs):
    """One controller on many courses, in detail; arrays [courses], NaN where not defined."""

    slip_p50: np.ndarray
    slip_p95: np.ndarray
    sinkage_p50: np.ndarray  # [m]
    sinkage_p95: np.ndarray  # [m]
    tractive_efficiency: np.ndarray
    warning_distance: np.ndarray  # [m], of immobilised courses that were warned of
    warning_time: np.ndarray  # [s]
    false_warning: np.ndarray  # share of the driving time, of courses without immobilisation
    foreseen_distance: np.ndarray  # the same of the warning by the probability of immobilisation
    foreseen_time: np.ndarray
    false_foresight: np.ndarray

    def metric(self, name: str) -> np.ndarray:
        """Value of a metric for each course [courses]; NaN where it is not defined."""
        if name in ("warned", "foreseen"):
            time = self.warning_time if name == "warned" else self.foreseen_time
            return np.where(np.isin(self.cause, _STUCK), np.isfinite(time).astype(float), math.nan)
        if name in ("sinkage_p50", "sinkage_p95"):
            return 1000.0 * getattr(self, name)
        if name in _OWN:
            return getattr(self, name)
        return super().metric(name)

    def columns(self) -> dict[str, list]:
        """{field: values} for JSON: plain numbers, None where not defined."""
        return {
            f.name: [None if isinstance(x, float) and math.isnan(x) else x for x in getattr(self, f.name).tolist()]
            for f in fields(self)
        }

    @classmethod
    def from_columns(cls, columns: dict[str, list]) -> Records:
        """Rebuild records from columns."""
        n = len(columns["cause"])
        out = {}
        for f in fields(cls):
            kind = np.int64 if f.name == "cause" else np.float64
            out[f.name] = np.array([math.nan if x is None else x for x in columns[f.name]], dtype=kind)
            if len(out[f.name]) != n:
                raise ValueError(f"{f.name}: {len(out[f.name])} values, expected {n}")
        return cls(**out)


_OWN = {f.name for f in fields(Records)} - {f.name for f in fields(Runs)}


def record(
    controller,
    scenario: Scenario,
    seed: int,
    first: int,
    count: int,
    threads: int | None = None,
    model: WheelSoilModel | None = None,
) -> Records:
    """Drive courses `first` ... `first + count - 1` of set `seed` side by side.

    The same arguments give the same records, bit for bit, whatever the number of threads. For a neural network the
    last bits may depend on how many courses are driven side by side.
    """
    alarms, totals = (Warnings(scenario, count), Foresight(scenario, count)), Totals(count)
    drawbar_work, drive_work = np.zeros((2, count))
    slips, depths, drove = [], [], []
    for w, alive in drive(controller, scenario, seed, first, count, threads, model, warnings=True):
        s, on = w.state, totals.add(w, alive)
        pulling = on & (s["drawbar_pull"] > 0.0) & (s["motor_work"] > 0.0)
        drawbar_work += np.where(pulling, np.maximum(s["drawbar_pull"] * s["travel"], 0.0), 0.0)
        drive_work += np.where(pulling, s["motor_work"], 0.0)
        slips.append(s["slip"].copy())
        depths.append(s["sinkage"].copy())
        drove.append(on)
        for alarm in alarms:
            alarm.step(w, alive)
    stuck = np.isin(w.cause, _STUCK)
    lead, foreseen = (np.where(stuck[:, None], a.lead(w, w.cause == Cause.BOGGED.value), math.nan) for a in alarms)
    false = [np.where(stuck, math.nan, _ratio(a.under, a.driven)) for a in alarms]
    slip_p50, slip_p95 = _percentiles(np.array(slips), np.array(drove))
    sinkage_p50, sinkage_p95 = _percentiles(np.array(depths), np.array(drove))
    return Records(
        **totals.runs(w, scenario),
        slip_p50=slip_p50,
        slip_p95=slip_p95,
        sinkage_p50=sinkage_p50,
        sinkage_p95=sinkage_p95,
        tractive_efficiency=_ratio(drawbar_work, drive_work),
        warning_distance=lead[:, 0],
        warning_time=lead[:, 1],
        false_warning=false[0],
        foreseen_distance=foreseen[:, 0],
        foreseen_time=foreseen[:, 1],
        false_foresight=false[1],
    )


def _percentiles(series, mask):
    """Median and 95th percentile of each column of `series` [steps, courses] where `mask`; NaN where nowhere."""
    out = np.full((2, series.shape[1]), math.nan)
    for k in range(series.shape[1]):
        x = series[mask[:, k], k]
        if x.size:
            out[:, k] = np.percentile(x, [50, 95])
    return out


def _ratio(a, b):
    return np.divide(a, b, out=np.full(len(a), math.nan), where=b > 0.0)
