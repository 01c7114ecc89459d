"""Anonymous laws with few numbers: laws of no catalogue with which listed effects are compared.

A mechanism that nobody has listed is likelier to have few numbers than to be a free function of the
conditions (`evidence.patterns`). So a name must explain a table better than these laws do. W and
z0 are the median load and sinkage of the table, V0 the geometric mean of its speeds. W_row is the
load of a row, N the pass number; every parameter is a pure number:

    force                     DP - a W (z/z0)^m,  T + b W r (z/z0)^m  soil beside or on the wheel
    rut_force                 the same times 1 - 1/N                  the same in a rut
    slip_force                DP - a W q,  T + b W r q                soil moved by slip
    slip_load                 W_row (1 + a q)                         it loads or lifts the wheel
    torque_curve, pull_curve  y/(1 + s |y|/y0)                        a sensor that is not linear
    soft_wheel                r (1 + a W_row/W),  T on the lever r    a wheel that its load deforms
    {friction,cohesion,modulus}_pass     tan(phi), c or K alone, times N^p
    {friction,cohesion,modulus}_speed    the same times (V/V0)^p

with q = 1 - exp(-i/k), and y0 = W r/2 of the torque and W/5 of the pull.
"""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from soil_env.identification.table.priors import Values
from soil_env.identification.table.rig import BY_ROW
from soil_env.terramechanics.effects.entry import (
    CHANNELS,
    PULL,
    TORQUE,
    Bench,
    Channel,
    Effect,
    EffectParameter,
    Form,
)
from soil_env.terramechanics.model import Rows


def _p(
    name: str, sd: float, low: float, high: float, centre: float | None = None
) -> EffectParameter:
    """A pure number with a normal prior of mean 0 and standard deviation `sd`, within `low` and
    `high`; symbol, meaning and unit are empty.

    With a `centre` the prior is log-normal about it, and `sd` that of the logarithm.
    """
    return EffectParameter(name, "", low, high, scale=sd, doc="", centre=centre)


def _law(
    name: str,
    title: str,
    moves: tuple[Channel, ...],
    *p: EffectParameter,
    varies: str | None = None,
) -> Effect:
    """An anonymous law as an effect with one form, which frees all its parameters."""
    form = Form(name, tuple(k.name for k in p), "", "own assumption")
    return Effect(name, title, p, (form,), moves, varies=varies)


# Own choices: widths, bounds and centres of the parameters.
_BOTH: tuple[Channel, ...] = (PULL, TORQUE)
_FORCE = _p("pull", 0.15, -3.0, 3.0), _p("torque", 0.15, -3.0, 3.0)
_POWER = _p("power", 0.35, 0.3, 4.0, 1.5)
_LOSS = _p("loss", 0.3, -0.4, 3.0)
_SLIP = _p("slip", 0.5, 0.03, 1.0, 0.2)
_COLUMNS = {"speed": 0, "pass": 1}  # of `Rows.conditions`
#: Soil parameter and condition of the anonymous laws of one soil parameter.
_ANONYMOUS = {
    f"{short}_{condition}": (parameter, condition)
    for short, parameter in (
        ("friction", "friction_angle_deg"),
        ("cohesion", "cohesion"),
        ("modulus", "shear_modulus"),
    )
    for condition in _COLUMNS
}
TORQUE_SCALE = 0.5  # [load times radius] y0 of `torque_curve`; own choice
PULL_SCALE = 0.2  # [load] y0 of `pull_curve`; own choice
LEAST_DIVISOR = 0.1  # of these curves, which would change the sign of a reading below 0; own choice
#: Laws of sensors: a simulated wheel has none of them.
OF_SENSORS = ("torque_curve", "pull_curve")
_NAMELESS = (
    _law(
        "force",
        "a force that goes with the sinkage, as of soil beside the wheel",
        _BOTH,
        *_FORCE,
        _POWER,
    ),
    _law(
        "rut_force",
        "a force that goes with the sinkage in a rut",
        _BOTH,
        *_FORCE,
        _POWER,
        varies="pass",
    ),
    _law("slip_force", "a force that goes with the slip", _BOTH, *_FORCE, _SLIP),
    _law(
        "slip_load", "a load that goes with the slip", CHANNELS, _p("load", 0.15, -0.8, 2.0), _SLIP
    ),
    _law("torque_curve", "a torque that is not read in proportion", (TORQUE,), _LOSS),
    _law("pull_curve", "a drawbar pull that is not read in proportion", (PULL,), _LOSS),
    _law("soft_wheel", "a wheel that its load deforms", CHANNELS, _p("gain", 0.5, -0.4, 4.0)),
    *(
        _law(
            name,
            f"a soil whose {name.split('_')[0]} alone goes with the {by}",
            CHANNELS,
            _p("power", 0.2, -2.0, 2.0),
            varies=by,
        )
        for name, (_, by) in _ANONYMOUS.items()
    ),
)
UNNAMED: Mapping[str, Effect] = MappingProxyType({law.name: law for law in _NAMELESS})


def _slip_share(rows: Rows, scale: float) -> np.ndarray:
    """[N] q = 1 - exp(-i/k) with k the `scale` of slip; 0 where braked."""
    return -np.expm1(-np.maximum(rows.slip, 0.0) / scale)


def _radius_factor(rows: Rows, values: Values, load: float) -> np.ndarray:
    """[N] factor on the radius of a wheel that its load deforms, 1 + a W_row/W; a is among the
    `values`, `load` is W.
    """
    return 1.0 + values["soft_wheel_gain"] * rows.load / load


def loaded(rows: Rows, values: Values, load: float) -> Rows:
    """Rows with the load that `slip_load` makes, or the wheel radius that `soft_wheel` makes, if
    `values` hold the parameters of one of them; `load`: the median one [N].
    """
    if "soft_wheel_gain" in values:
        wheels = rows.wheels.copy()
        wheels[:, 0] *= _radius_factor(rows, values, load)
        return rows._replace(wheels=wheels)
    if "slip_load_load" not in values:
        return rows
    return rows._replace(
        load=rows.load
        * (1.0 + values["slip_load_load"] * _slip_share(rows, values["slip_load_slip"]))
    )


def factors(rows: Rows, values: Values, bench: Bench) -> np.ndarray | None:
    """Factors [N, 4] on the soil parameters `BY_ROW`, by the laws of one soil parameter whose power
    is among `values`; None if none is.

    The factor of the friction angle multiplies its tangent.
    """
    laws = [name for name in _ANONYMOUS if f"{name}_power" in values]
    out = np.ones((rows.slip.size, len(BY_ROW)))
    for name in laws:
        parameter, by = _ANONYMOUS[name]
        # Base of the power: the speed over its geometric mean, or the pass number.
        base = rows.conditions[:, _COLUMNS[by]] / (bench.speed if by == "speed" else 1.0)
        out[:, BY_ROW.index(parameter)] *= base ** values[f"{name}_power"]
    return out if laws else None


def changed(out: np.ndarray, rows: Rows, values: Values, bench: Bench) -> np.ndarray:
    """Sinkage, pull and torque [N, 3] after the anonymous laws among `values`: added forces, the
    lever of a soft wheel, curved sensors.

    `out` [N, 3]: the outcome on `loaded` rows.
    """
    out = out.copy()
    load = bench.load
    size = load * rows.wheels[:, 0]
    if "soft_wheel_gain" in values:
        out[:, 2] /= _radius_factor(rows, values, load)
    for name in ("force", "rut_force", "slip_force"):
        if f"{name}_pull" not in values:
            continue
        if name == "slip_force":
            share = _slip_share(rows, values["slip_force_slip"])
        else:
            share = (np.maximum(out[:, 0], 0.0) / bench.sinkage) ** values[f"{name}_power"]
        if name == "rut_force":
            share *= 1.0 - 1.0 / np.maximum(rows.conditions[:, 1], 1.0)
        out[:, 1] -= values[f"{name}_pull"] * load * share
        out[:, 2] += values[f"{name}_torque"] * size * share
    for name, j, scale in (
        ("pull_curve", 1, PULL_SCALE * load),
        ("torque_curve", 2, TORQUE_SCALE * size),
    ):
        if f"{name}_loss" in values:
            loss = values[f"{name}_loss"] * np.abs(out[:, j]) / scale
            out[:, j] /= np.maximum(1.0 + loss, LEAST_DIVISOR)
    return out
