"""Sound tables of many wheels and soils, and mistakes that can be made in them.

Tables of wheels of 0.05 to 0.35 m on the soils of configs/soils.yaml, with none, one or two effects that the base model
lacks, smooth errors of 0, 5 or 10 % in the measured values, noise of 0.3 to 2 %, and priors that are tight, loose or
absent.
"""

import dataclasses
import itertools
import math
import tempfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env.discrepancy.calibrate import calibrate
from soil_env.discrepancy.data import prepare
from soil_env.discrepancy.doubts import of_table
from soil_env.measurement.table import MEASURED, NoiseLevels, Prior, Setup, SetupWheel, SoilPriors, read_table
from soil_env.parameters import Soil, soils
from soil_env.terramechanics.effects import CATALOGUE
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel

GRAVITY = 9.81
LIGHTEST, LEAST_PRESSURE = 2.0, 1e3  # [N], [Pa] of the wheel of a rig on the ground
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


def sound_tables(count, seed):
    """Sound tables, some with effects that the base model lacks."""
    rng, names = np.random.default_rng(seed), list(soils())
    drawn = (_draw(rng, names[int(rng.integers(len(names)))]) for _ in itertools.count())
    return itertools.islice((table for table in drawn if table is not None), count)


def _draw(rng, name):
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
    load, slip = np.array(list(itertools.product(loads, slips))).T
    found = WheelSoilModel(ModelWheel(r, b, height), soil, _effects(rng)).predict({"load": load, "slip": slip})
    y = np.stack(found[:3], axis=1)
    if S * z**n < LEAST_PRESSURE or middle < LIGHTEST or not found.supported:
        return None
    if np.max(y[:, 0]) > 0.6 * r or np.min(y[:, 0]) < 0.005 * r:
        return None
    s, w = (slip - slips.mean()) / np.ptp(slips), np.log(load / middle)
    waves = np.stack([np.sin(2.0 * s + rng.uniform(0.0, 6.0)) + 0.5 * np.sin(1.5 * w + rng.uniform(0.0, 6.0))
                      for _ in range(3)], axis=1)  # fmt: skip
    sd = np.array([z, 0.3 * middle, 0.3 * middle * r]) * rng.uniform(0.003, 0.02)
    y = y * (1.0 + rng.choice([0.0, 0.05, 0.1]) * waves) + sd * rng.normal(size=y.shape)
    drop = rng.choice([-1, -1, 0, 2])  # of the channels, one is sometimes not measured
    columns = {"load": load, "slip": slip} | {c: y[:, j] for j, c in enumerate(MEASURED) if j != drop}
    given = dict(zip(MEASURED, sd, strict=True)) if rng.random() < 0.6 else {}
    return Sound(columns, Setup(SetupWheel(r, b, height), _priors(rng, soil), NoiseLevels(**given)))


def _effects(rng):
    """None to two effects in one of their forms, 0.5 to 3 times the usual size, in a table of slips and loads."""
    names = [e.name for e in CATALOGUE.values() if e.varies is None and all(p.scale > 0.0 for p in e.parameters)]
    out = {}
    for name in rng.choice(names, int(rng.integers(0, 3)), replace=False):
        effect = CATALOGUE[str(name)]
        form = effect.forms[int(rng.integers(len(effect.forms)))]
        out[effect.name] = dict(form.fixed)
        for p in map(effect.parameter, form.free):
            usual = p.scale * (p.centre or 1.0) * rng.uniform(0.5, 3.0)
            out[effect.name][p.name] = min(max((p.centre or p.neutral) + usual, p.low), p.high)
    return out


def _priors(rng, soil):
    """Priors about the truth."""
    out = {"density": Prior(soil.density, 0.0)}
    limits = {f.name: f.metadata for f in dataclasses.fields(Soil)}
    for name, share in PRIORS[int(rng.integers(len(PRIORS)))].items():
        truth = getattr(soil, name)
        size = {"friction_angle_deg": 1.0, "sinkage_exponent": 1.0, "cohesion": max(truth, 100.0)}.get(name, truth)
        low, high = (limits[name][end] for end in ("low", "high"))
        value = min(max(truth + share * size * rng.normal(), 0.2 * truth, low), high)
        out[name] = Prior(value, share * size)
    return SoilPriors(**out)


def in_kilograms(t):
    """The table with its load in kilograms."""
    return replace(t, columns=t.columns | {"load": t.columns["load"] / GRAVITY})


def doubts(t):
    """Doubts of a table; a refusal counts."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "data.csv"
        rows = np.stack(list(t.columns.values()), axis=1)
        np.savetxt(path, rows, delimiter=",", header=",".join(t.columns), comments="", fmt="%.7g")
        try:
            return of_table(calibrate(prepare(read_table(path, t.setup.wheel), t.setup))[0])
        except ParameterError as error:
            return (str(error),)
