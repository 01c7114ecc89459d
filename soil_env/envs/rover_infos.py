"""Info of the environments of a rover, for one rover and for many."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from soil_env.envs.infos import STUCK, asks, estimates, flat, masked
from soil_env.envs.rovers import RoverSimulation
from soil_env.identification import Status
from soil_env.simulation.rover.task import axle_names
from soil_env.simulation.task import REWARD_TERMS, Cause

_OF_BODY = ("x", "speed", "pitch", "slip", "sinkage", "drawbar_pull", "motor_work")
_OF_WHEEL = (
    "x",
    "wheel_speed",
    "slip",
    "sinkage",
    "load",
    "drawbar_pull",
    "torque",
    "motor_torque",
    "grade",
)


class RoverInfos:
    """Infos of the rovers of one `RoverSimulation`, of a `kind` of `infos.INFOS`."""

    def __init__(self, simulation: RoverSimulation, kind: str) -> None:
        self.kind: str = kind
        self._simulation = simulation
        self._axles = axle_names(simulation.scenario.axles)

    def one(self, j: int) -> dict[str, Any]:
        """Info of rover j; in words with "full" and "state", else in numbers of numpy."""
        return _one_of(self.many(), j, self.kind in ("full", "state"))

    def _estimates(self) -> dict[str, np.ndarray]:
        """Estimates of the soil under each wheel [rovers, axles]; empty if not asked for."""
        w = self._simulation.worlds
        return (
            estimates(w.known, self._simulation.scenario)
            if asks(self.kind) and w.known is not None
            else {}
        )

    def many(self) -> dict[str, Any]:
        """Info of all rovers, arrays [rovers]; causes and statuses are numbers."""
        if self.kind == "none":
            return {}
        w = self._simulation.worlds
        terms = {name: w.terms[:, i].copy() for i, name in enumerate(REWARD_TERMS)}
        info: dict[str, Any] = {"cause": w.cause.copy(), "immobilised": STUCK[w.cause]}
        if self.kind == "short":
            return info | {"x": w.state["x"].copy()} | {f"reward_{n}": v for n, v in terms.items()}
        info["reward_terms"] = terms
        info["state"] = {name: w.state[name].copy() for name in _OF_BODY}
        known = self._estimates()
        for a, axle in enumerate(self._axles):
            wheels = w.state["wheels"][:, a]
            info[axle] = {"state": {name: wheels[name].copy() for name in _OF_WHEEL}}
            if known:
                info[axle]["estimate"] = {name: values[:, a] for name, values in known.items()}
        return info if self.kind != "numeric" else flat(info)

    def after_step(self, reset: np.ndarray) -> None:
        """Nothing to do after a step: estimates are taken as they are."""

    renew = after_step

    def final(self, ended: np.ndarray) -> dict[str, Any]:
        """Info of rovers that have `ended` [rovers], 0 for others, and `_key` beside each key."""
        return masked(self.many(), ended)


def _one_of(infos: Mapping[str, Any], j: int, words: bool) -> dict[str, Any]:
    """Info of rover j of the infos of many."""
    out: dict[str, Any] = {}
    for name, values in infos.items():
        if isinstance(values, Mapping):
            out[name] = _one_of(values, j, words)
        elif not words:
            out[name] = np.int64(values[j]) if values.dtype.kind in "bi" else values[j]
        elif name in ("cause", "status"):
            out[name] = (Cause if name == "cause" else Status)(values[j]).name
        else:
            out[name] = values.item(j)
    return out
