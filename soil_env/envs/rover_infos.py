"""Info of the environments of a rover, for one rover and for many."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from soil_env.identification import Status
from soil_env.simulation.rover.task import axle_names
from soil_env.simulation.task import Cause

from .infos import NESTED, STATE, Info, VehicleInfos, asks, estimates
from .rovers import RoverSimulation

_OF_BODY = ("x", "speed", "pitch", "slip", "sinkage", "drawbar_pull", "motor_work")
_OF_WHEEL = tuple(name for name in STATE if name != "speed")  # all wheels have that of the rover


class RoverInfos(VehicleInfos):
    """Infos of the rovers of one `RoverSimulation`."""

    def __init__(self, simulation: RoverSimulation, kind: str) -> None:
        super().__init__(simulation, kind)
        self._axles = axle_names(simulation.scenario.axles)

    def one(self, j: int) -> Info:
        """Info of rover j: with "full" and "state" causes and statuses in words and numbers of
        Python, else numbers of numpy.
        """
        return _one_of(self.many(), j, self.kind in NESTED)

    def _groups(self) -> Info:
        """States of body and axles of all rovers, and the estimate of each axle if the kind asks
        for it.
        """
        w = self._simulation.worlds
        info: Info = {"state": {name: w.state[name].copy() for name in _OF_BODY}}
        known = estimates(w.known, self.scenario) if asks(self.kind) else {}
        for a, axle in enumerate(self._axles):
            wheels = w.state["wheels"][:, a]
            info[axle] = {"state": {name: wheels[name].copy() for name in _OF_WHEEL}}
            if known:
                info[axle]["estimate"] = {name: values[:, a] for name, values in known.items()}
        return info


def _one_of(infos: Mapping[str, Any], j: int, words: bool) -> Info:
    """Info of rover j out of the infos of many; `words` as in `RoverInfos.one`."""
    out: Info = {}
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
