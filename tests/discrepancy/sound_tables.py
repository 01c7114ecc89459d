"""Sound tables of many wheels and soils, and mistakes that can be made in them.

Tables of wheels of 0.05 to 0.35 m on the soils of configs/soils.yaml, with none, one or two effects that the base model
lacks, smooth errors of 0, 5 or 10 % in the measured values, noise of 0.3 to 2 %, and priors that are tight, loose or
absent.
"""

from __future__ import annotations

import dataclasses
import itertools
import math
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env.discrepancy.calibrate import calibrate
from soil_env.discrepancy.data import prepare
from soil_env.discrepancy.mistakes import examine
from soil_env.measurement.table import MEASURED, NoiseLevels, Prior, Setup, SetupWheel, SoilPriors, read_table
from soil_env.parameters import Soil, soils
from soil_env.terramechanics.effects import CATALOGUE
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel

GRAVITY = 9.81
LIGHTEST, LEAST_PRESSURE = 2.0, 1e3  # [N], [Pa] of the wheel of a rig on the ground
SIZES = {"drivetrain_friction_constant": 0.1, "sinkage_offset_offset": 0.25}  # of torque, of sinkage
#: Prior sd of the soil, relative but for phi [deg] and n; each set is given as often as the others.
PRIORS = (
    {},
    {"cohesion": 0.2},
    {"friction_angle_deg": 1.5, "cohesion": 0.2, "sinkage_coefficient": 0.12, "sinkage_exponent": 0.03},
    {"friction_angle_deg": 3.0, "cohesion": 0.5, "shear_modulus": 0.3, "sinkage_coefficient": 0.4,
     "sinkage_exponent": 0.1},
)  # fmt: skip


@dataclass(frozen=True, eq=False)
class Sound:
    """A sound table: conditions and values by column [N], and its setup."""

    columns: dict[str, np.ndarray]
    setup: Setup


def sound_tables(count: int, seed: int) -> Iterator[Sound]:
    """Sound tables, some with effects that the base model lacks."""
    rng, made = np.random.default_rng(seed), 0
    names = list(soils())
    while made < count:
        table = _draw(rng, names[int(rng.integers(len(names)))])
        if table is not None:
            made += 1
            yield table


def _draw(rng: np.random.Generator, name: str) -> Sound | None:
    """One table on a soil; None where the soil does not carry the wheel, or hardly lets it in."""
    r = math.exp(rng.uniform(math.log(0.05), math.log(0.35)))
    b, height = r * rng.uniform(0.4, 1.2), r * rng.choice([0.0, 0.05, 0.1])
    preset = soils()[name]
    S, n = preset.lumped(b), preset.sinkage_exponent
    soil = Soil(preset.friction_angle_deg, preset.cohesion, preset.shear_modulus, n, sinkage_coefficient=S,
                density=preset.density, dig_gain=0.0)  # fmt: skip
    z = r * rng.uniform(0.03, 0.2)
    middle = 0.6 * b * math.sqrt(2.0 * r * z) * S * z**n
    loads = middle * np.geomspace(0.6, 1.6, int(rng.integers(1, 4)))
    slips = np.round(np.linspace(rng.uniform(0.02, 0.12), rng.uniform(0.45, 0.75), int(rng.integers(5, 10))), 3)
    at = np.array(list(itertools.product(loads, slips)))
    conditions = {"load": at[:, 0], "slip": at[:, 1]}
    effects = _effects(rng, middle * r * 0.3, z)
    model = WheelSoilModel(ModelWheel(r, b, height), soil, effects)
    found = model.predict(conditions)
    y = np.stack(found[:3], axis=1)
    if S * z**n < LEAST_PRESSURE or middle < LIGHTEST or not found.supported:
        return None
    if np.max(y[:, 0]) > 0.6 * r or np.min(y[:, 0]) < 0.005 * r:
        return None
    size = np.array([z, 0.3 * middle, 0.3 * middle * r])
    s, w = (at[:, 1] - slips.mean()) / np.ptp(slips), np.log(at[:, 0] / middle)
    waves = np.stack([np.sin(2.0 * s + rng.uniform(0.0, 6.0)) + 0.5 * np.sin(1.5 * w + rng.uniform(0.0, 6.0))
                      for _ in range(3)], axis=1)  # fmt: skip
    error = float(rng.choice([0.0, 0.05, 0.1]))
    sd = size * rng.uniform(0.003, 0.02)
    y = y * (1.0 + error * waves) + sd * rng.normal(size=y.shape)
    drop = rng.choice([-1, -1, 0, 2])  # of the channels, one is sometimes not measured
    columns = conditions | {c: y[:, j] for j, c in enumerate(MEASURED) if j != drop}
    given = dict(zip(MEASURED, sd, strict=True)) if rng.random() < 0.6 else {}
    chosen = PRIORS[int(rng.integers(len(PRIORS)))]
    setup = Setup(SetupWheel(r, b, height), _priors(rng, soil, chosen), NoiseLevels(**given))
    return Sound(columns, setup)


def _effects(rng: np.random.Generator, torque: float, sinkage: float) -> dict[str, dict[str, float]]:
    """None to two effects in one of their forms, 0.5 to 3 times the usual size, in a table of slips and loads."""
    names = [e.name for e in CATALOGUE.values() if e.varies is None]
    out = {}
    for name in rng.choice(names, int(rng.integers(0, 3)), replace=False):
        effect = CATALOGUE[str(name)]
        form = effect.forms[int(rng.integers(len(effect.forms)))]
        values = dict(form.fixed)
        for p in (effect.parameter(name) for name in form.free):
            usual = p.scale * (p.centre or 1.0)
            usual = SIZES.get(f"{effect.name}_{p.name}", usual)
            usual *= {"constant": torque}.get(p.name, sinkage if effect.name == "sinkage_offset" else 1.0)
            values[p.name] = min(max((p.centre or p.neutral) + usual * rng.uniform(0.5, 3.0), p.low), p.high)
        if effect.name == "shear_softening" and "sharpness" in values:
            values["sharpness"] = 1.0 + values["sharpness"]
        out[effect.name] = values
    return out


def _priors(rng: np.random.Generator, soil: Soil, chosen: dict[str, float]) -> SoilPriors:
    """Priors about the truth."""
    out = {"density": Prior(soil.density, 0.0)}
    limits = {f.name: f.metadata for f in dataclasses.fields(Soil)}
    for name, share in chosen.items():
        truth = getattr(soil, name)
        size = {"friction_angle_deg": 1.0, "sinkage_exponent": 1.0, "cohesion": max(truth, 100.0)}.get(name, truth)
        sd = share * size
        low, high = (limits[name][end] for end in ("low", "high"))
        out[name] = Prior(min(max(truth + sd * rng.normal(), 0.2 * truth, low), high), sd)
    return SoilPriors(**out)


# --- examined ---------------------------------------------------------------------------------------------------------


def _times(name: str, factor: float) -> Callable[[Sound], Sound | None]:
    def change(t: Sound) -> Sound | None:
        return replace(t, columns=t.columns | {name: factor * t.columns[name]}) if name in t.columns else None

    return change


def _diameter(t: Sound) -> Sound:
    return replace(t, setup=replace(t.setup, wheel=replace(t.setup.wheel, radius=2.0 * t.setup.wheel.radius)))


#: Mistakes by name; None where the table has no such column.
MISTAKES: dict[str, Callable[[Sound], Sound | None]] = {
    "load in kilograms": _times("load", 1.0 / GRAVITY),
    "pull in kilograms": _times("drawbar_pull", 1.0 / GRAVITY),
    "torque in kilogram metres": _times("torque", 1.0 / GRAVITY),
    "sign of the pull": _times("drawbar_pull", -1.0),
    "sign of the slip": _times("slip", -1.0),
    "diameter for the radius": _diameter,
}


def check_first(t: Sound) -> tuple[str, ...]:
    """Return the doubts about a table; a refusal counts."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "data.csv"
        names = list(t.columns)
        rows = np.stack([t.columns[name] for name in names], axis=1)
        np.savetxt(path, rows, delimiter=",", header=",".join(names), comments="", fmt="%.7g")
        try:
            return examine(calibrate(prepare(read_table(path, t.setup.wheel), t.setup))[0])
        except ParameterError as error:
            return (str(error),)
