"""Unknowns of a fit to a measurement table, and what is known of a soil before it.

Every unknown is fitted as u = (x - mean)/sd, x being the parameter or, for K and S, its logarithm.
In u every prior is the standard normal, and parameters of any unit have one scale.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from soil_env.measurement.setup import NUMBERS, STEEPEST_TILT, Prior, Setup
from soil_env.parameters import Soil

USUAL_SINKAGE = 0.08  # [radii] where none was measured
LARGEST_LOG = 700.0  # an exponential of 710 overflows
_LEAST_VALUE = 1e-12  # value that a prior counts as, at least, where its logarithm is taken
_SHALLOWEST = 0.01  # [radii] least sinkage of the plate of `plate_coefficient`; the most is 1
#: Length of that plate over the chord sqrt(2 r z) from the entry to the lowest point; own choice.
_PLATE = 0.6
#: Smallest standard deviations of priors that are given, in the coordinate of the fit.
_LEAST_SD = {
    "friction_angle_deg": 0.05,
    "cohesion": 1.0,
    "shear_modulus": 1e-4,
    "sinkage_coefficient": 1e-4,
    "sinkage_exponent": 1e-3,
}


Values = Mapping[str, float]  # parameters by name


class Unknown(NamedTuple):
    """One unknown with its prior and bounds, in its coordinate: the parameter itself or its
    logarithm.
    """

    name: str  # of the parameter
    mean: float  # of the normal prior
    sd: float
    low: float  # bound
    high: float
    log: bool  # the coordinate is the logarithm

    def value(self, u: float) -> float:
        """The parameter in its unit at the whitened unknown u; a logarithm is cut at
        `LARGEST_LOG`.
        """
        x = self.mean + self.sd * u
        return math.exp(min(x, LARGEST_LOG)) if self.log else x

    def at(self, value: float) -> float:
        """The whitened unknown u of a parameter's value; the inverse of `value`."""
        return ((math.log(value) if self.log else value) - self.mean) / self.sd

    @property
    def bounds(self) -> tuple[float, float]:
        """Bounds of the whitened unknown."""
        return (self.low - self.mean) / self.sd, (self.high - self.mean) / self.sd


#: Unknown by name where the setup says nothing of a soil parameter; without a mean for ln S, which
#: is that of a plate (`plate_coefficient`). Ours, wide enough for every preset soil of
#: configs/soils.yaml, clays with 69 kPa among them.
BROAD = {
    unknown.name: unknown
    for unknown in (
        Unknown("friction_angle_deg", 30.0, 15.0, 2.0, 65.0, log=False),
        Unknown("cohesion", 5e3, 3e4, 0.0, 1e5, log=False),
        Unknown("shear_modulus", math.log(0.02), 1.2, math.log(2e-4), math.log(0.3), log=True),
        Unknown("sinkage_coefficient", math.nan, 3.0, math.log(10.0), math.log(1e13), log=True),
        Unknown("sinkage_exponent", 0.8, 0.5, 0.05, 2.5, log=False),
    )
}


def parameters_at(unknowns: Sequence[Unknown], u: np.ndarray) -> dict[str, float]:
    """Parameters by name, in their units, at whitened unknowns u [p]."""
    return {k.name: k.value(x) for k, x in zip(unknowns, u, strict=True)}


def bounds_of(unknowns: Sequence[Unknown]) -> np.ndarray:
    """[2, p] lower and upper bounds of whitened unknowns."""
    return np.array([k.bounds for k in unknowns]).reshape(-1, 2).T


def soil_unknowns(
    setup: Setup, load: np.ndarray, sinkage: np.ndarray, widened: float = 1.0
) -> tuple[tuple[Unknown, ...], dict[str, float]]:
    """(unknowns of the soil, values by name that the setup knows) of a table: `load` of each row in
    N, `sinkage` of each row in m, nan where not measured.

    A parameter without a prior in the setup is the `BROAD` unknown; ln S has the logarithm of
    `plate_coefficient` for its mean. For any other the standard deviation of its prior is
    multiplied by `widened`. If the setup gives `tilt_deg`, that is the last of the unknowns, its
    prior as it is, or known.
    """
    unknowns = []
    known = {}
    for name, broad in BROAD.items():
        prior = given_prior(setup, name)
        if prior is None:
            unknowns.append(broad)
        elif prior.known:
            known[name] = prior.value
        else:
            unknowns.append(_under_prior(broad, prior, widened))
    # n, known or at its prior mean, with which S has its broad prior below.
    exponent = (known | {k.name: k.mean for k in unknowns})["sinkage_exponent"]
    tilt = setup.tilt_deg
    if tilt is not None and tilt.known:
        known["tilt_deg"] = tilt.value
    elif tilt is not None:
        unknowns.append(
            Unknown("tilt_deg", tilt.value, tilt.sd, -STEEPEST_TILT, STEEPEST_TILT, log=False)
        )
    usual = math.log(plate_coefficient(setup, load, sinkage, exponent))
    return tuple(k._replace(mean=usual) if math.isnan(k.mean) else k for k in unknowns), known


def given_prior(setup: Setup, name: str) -> Prior | None:
    """The setup's prior of an unknown, None where it says nothing; that of S is under its wheel."""
    if name == "sinkage_coefficient":
        return setup.soil.lumped(setup.wheel.width)
    prior: Prior | None = getattr(setup if name == "tilt_deg" else setup.soil, name)
    return prior


def _under_prior(broad: Unknown, prior: Prior, widened: float) -> Unknown:
    """The `broad` unknown under the setup's prior, whose sd is multiplied by `widened`.

    The prior is taken in the coordinate of the fit; of a logarithm its sd is ln(1 + sd/value). The
    bounds are widened to include its value. Its sd is at least `_LEAST_SD`.
    """
    value = max(prior.value, _LEAST_VALUE) if broad.log else prior.value
    mean = math.log(value) if broad.log else value
    sd = widened * (math.log1p(prior.sd / value) if broad.log else prior.sd)
    low = min(broad.low, mean)
    high = max(broad.high, mean)
    # A prior wider than the range says no less than one as wide.
    sd = min(max(sd, _LEAST_SD[broad.name]), high - low)
    return broad._replace(mean=mean, sd=sd, low=low, high=high)


def middle_sinkage(sinkage: np.ndarray, radius: float) -> float:
    """Median [m] of the sinkages that are measured (not nan); `USUAL_SINKAGE` of a wheel of this
    radius [m] without any, or where the median is not above 0, as of a sensor with a wrong zero.
    """
    middle = np.nanmedian(sinkage) if np.any(np.isfinite(sinkage)) else 0.0
    return middle if middle > 0.0 else USUAL_SINKAGE * radius


def plate_coefficient(
    setup: Setup, load: np.ndarray, sinkage: np.ndarray, exponent: float
) -> float:
    """S [N/m^(n+2)] with which a flat plate, in place of the wheel's contact, carries the median
    load at the `middle_sinkage`.

    `load` of each row in N, `sinkage` of each row in m, nan where not measured. `exponent`: n.
    """
    r = setup.wheel.radius
    z = min(max(middle_sinkage(sinkage, r), _SHALLOWEST * r), r)
    carried: float = setup.wheel.width * math.sqrt(2.0 * r * z) * _PLATE * z**exponent
    return float(np.median(load)) / carried


def soil_of(setup: Setup, values: Values) -> Soil:
    """The soil with the parameters `values` by name, each cut to its bounds; laws and gravity are
    those of the setup, and so is a density that `values` do not have. Other names are ignored.

    `sinkage_coefficient` is that under the setup's wheel [N/m^(n+2)]. Where the setup gives k_c and
    k_phi, the soil has these in place of S, in their ratio. So wheels of other widths have the S
    that `rig.predict_table` gives them.
    """
    stated = setup.soil
    numbers = {**given_laws(setup), "gravity_measured": setup.gravity}
    density = stated.density
    numbers |= {"density": density.value} if density else {}
    numbers |= values
    usual = stated.lumped(setup.wheel.width)
    k_c = stated.k_c
    k_phi = stated.k_phi
    if usual is not None and k_c is not None and k_phi is not None:
        ratio = numbers.pop("sinkage_coefficient") / usual.value
        numbers |= {"k_c": ratio * k_c.value, "k_phi": ratio * k_phi.value}
    return Soil.within(numbers)


def given_laws(setup: Setup) -> dict[str, float]:
    """Parameters of slip-sinkage and of the `FLOW_LAW` by name, as the setup gives them; the
    defaults of `Soil` where it says nothing.
    """
    given = {name: getattr(setup.soil, name) for name in NUMBERS if name != "density"}
    return {
        name: float(prior.value if prior else getattr(Soil, name)) for name, prior in given.items()
    }
