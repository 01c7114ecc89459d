"""Errors of a rig whose sizes its setup states (`Setup.calibration`), and what sensors read with
them.

Those of a single sensor, and the tilt, are linear in what is read (`SENSORS`): fits have them as
further unknowns, or in their covariance.
"""

import math

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env.measurement.setup import Calibration, Setup
from soil_env.terramechanics.model import Rows

from .form_error import side_by_side
from .priors import Unknown, Values

#: Standard deviation of a zero that the setup does not state: over the median load, for the torque
#: over this load times the radius; own choice.
LEAST_OFFSET = 0.003
#: The same of the rate of a spring [median load over the radius]; own choice.
LEAST_SPRING = 0.1
#: Parameter of each error of a single sensor, and of the tilt, as `reading` takes it.
SENSORS = {
    "tilt": "tilt",  # [deg]
    "force_offset": "force_offset_offset",  # [N]
    "force_gain": "force_gain_gain",
    "torque_offset": "torque_offset_offset",  # [N m]
    "torque_gain": "torque_gain_gain",
    "force_crosstalk": "force_crosstalk_share",
    "torque_crosstalk": "torque_crosstalk_share",
}
#: A rig without errors.
EXACT = Calibration(**dict.fromkeys(vars(Calibration()), 0.0))
_FARTHEST = 10.0  # [sd] of an error in a fit; own choice


def stated_errors(calibration: Calibration) -> dict[str, float | None]:
    """Standard deviation by name of each error of a rig, as the setup states it or by default; None
    where the default depends on the load.
    """
    stated = dict(vars(calibration))
    return {"tilt": stated.pop("tilt_deg"), **stated}


def sd_of_errors(
    calibration: Calibration, load: float, radius: float, where: str = ""
) -> dict[str, float]:
    """Standard deviation by name of each error of a rig with a median `load` [N] on a wheel of this
    `radius` [m]: as `stated_errors`, else the usual share of the load.

    `ParameterError`, beginning with `where`, for a stated zero of the pull above the load, or of
    the torque above load times radius.
    """
    usual = {
        "force_offset": LEAST_OFFSET * load,
        "torque_offset": LEAST_OFFSET * load * radius,
        "spring_load": LEAST_SPRING * load / radius,
    }
    stated = stated_errors(calibration).items()
    spread = {name: usual[name] if x is None else x for name, x in stated}
    for name in ("force_offset", "torque_offset"):
        most = usual[name] / LEAST_OFFSET
        if spread[name] > most:
            raise ParameterError(
                f"{where}: calibration.{name} = {spread[name]:g}: expected at most {most:.3g}, the "
                "median load (of the torque times the radius)"
            )
    return spread


def sensor_unknowns(setup: Setup, load: float, radius: float) -> tuple[Unknown, ...]:
    """Unknown errors of `SENSORS` of a rig, as in `sd_of_errors`, each with the prior mean 0.

    Left out are those that the setup has ruled out, by a check or a standard deviation of 0, and
    the tilt where the setup has one of its own.
    """
    known = {*setup.checked} | ({"tilt"} if setup.tilt_deg is not None else set())
    spread = sd_of_errors(setup.calibration, load, radius, setup.source)
    return tuple(
        Unknown(parameter, 0.0, sd, -_FARTHEST * sd, _FARTHEST * sd, log=False)
        for name, parameter in SENSORS.items()
        if (sd := spread[name]) > 0.0 and name not in known
    )


def reading(out: np.ndarray, values: Values, rows: Rows) -> np.ndarray:
    """Readings [N, 3] of the sensors for true values `out` [N, 3] of `rows`, with the parameters of
    `SENSORS` among `values`. The sinkage is read as it is.

    Crosstalk is a share of the other sensor's true value. A `tilt` [deg] takes load times its sine
    off the pull; that it changes the load on the ground too is left out.
    """
    if {*values}.isdisjoint(SENSORS.values()):
        return out
    radius = rows.wheels[:, 0]
    read = out.copy()
    for j, name, other in ((1, "force", out[:, 2] / radius), (2, "torque", out[:, 1] * radius)):
        gain, offset, share = (
            values.get(SENSORS[f"{name}_{of}"], 0.0) for of in ("gain", "offset", "crosstalk")
        )
        read[:, j] += gain * out[:, j] + offset + share * other
    read[:, 1] -= rows.load * math.sin(math.radians(values.get("tilt", 0.0)))
    return read


def changes(out: np.ndarray, sizes: Values, rows: Rows) -> np.ndarray:
    """[N, 3, R] change of the `reading` of true values `out` [N, 3] by each of the R parameters of
    `SENSORS` in `sizes`, if it has that size.
    """
    moved = [reading(out, {name: size}, rows) - out for name, size in sizes.items()]
    return side_by_side(moved, out.shape)
