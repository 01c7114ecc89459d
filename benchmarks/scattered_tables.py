"""How often intervals of a table hold the soil where slip and load scatter, as the setup says.

    python -m benchmarks.scattered_tables --tables 20    both kinds at 120 rows, some minutes

Tables of many conditions on the soils of configs/soils.yaml that keep to the base model, with
noise of 1 %. Slip errs by 0.02 and load by 3 % of the middle one, in each row by itself, or all
rows of a drive together, of which a table has four. The rig errs by as much as a setup believes
that does not state its calibration: level to 0.5 deg, gains to 2 %, zeros to 0.3 % of the load,
crosstalk of 1 %.
"""

import math
from dataclasses import replace

import click
import numpy as np

from benchmarks.sound_tables import (
    INTERVAL,
    LEAST_PRESSURE,
    LIGHTEST,
    Sound,
    of_a_rig,
    print_share,
)
from soil_env._io.loading import ParameterError
from soil_env.cli.running import WholeNumber, leave, run, seed_option
from soil_env.identification.table import identify_table
from soil_env.measurement.setup import NoiseLevels, Setup, SetupWheel, SoilPriors
from soil_env.measurement.table import MEASURED
from soil_env.parameters import Soil, soils
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel

SLIP = 0.02  # [-] standard deviation of the slip
LOAD = 0.03  # of the middle load
NOISE = 0.01  # of the channels, relative to a typical value
DRIVES = 4  # of a table
MOST_PRESSURE = 1e6  # [Pa] of a wheel on soil
JUDGED = ("friction_angle_deg", "shear_modulus", "sinkage_coefficient")
#: Standard normal deviates of the ends of intervals of 68 % and 95 %.
REACH = {68: 1.0, 95: 1.96}


def draw(rng: np.random.Generator, rows: int, shared: bool) -> tuple[Sound, Soil]:
    """Draw (a table of so many `rows` that a rig could measure, its soil).

    Slip and load err in each row by itself, or, if `shared`, in all rows of a drive together. The
    soil is a preset with a straight strength and without a firm layer. It has the S of the drawn
    wheel in place of k_c and k_phi, and no slip-sinkage, flow along the rim and growth of K. Six of
    ten setups state the noise of the channels, all that of slip and load. Draws are repeated until
    soil and wheel could be those of a rig (`of_a_rig`).
    """
    plain = [s for s in soils().values() if s.reference_stress == 0.0 and s.layer is None]
    while True:
        preset = plain[int(rng.integers(len(plain)))]
        r = math.exp(rng.uniform(math.log(0.05), math.log(0.35)))
        b = r * rng.uniform(0.4, 1.2)
        stiffness = preset.lumped(b)
        lumped = {"k_c": None, "k_phi": None, "sinkage_coefficient": stiffness}
        soil = replace(preset, **lumped, dig_gain=0.0, rim_flow=0.0, shear_growth=0.0)
        z = r * rng.uniform(0.03, 0.2)
        pressure = stiffness * z**soil.sinkage_exponent
        # [N] load at the sinkage z, as in `sound_tables`.
        middle = 0.6 * b * math.sqrt(2.0 * r * z) * pressure
        slip = rng.uniform(0.03, 0.6, rows)
        load = middle * np.exp(rng.uniform(-0.5, 0.5, rows))
        # The table states slip and load as drawn; the true ones differ by these errors.
        errors = rng.normal(size=(DRIVES if shared else rows, 2))
        of_rows = np.sort(rng.integers(0, DRIVES, rows)) if shared else np.arange(rows)
        off = errors[of_rows] * (SLIP, LOAD * middle)
        true = {"slip": slip + off[:, 0], "load": load + off[:, 1]}
        if not LEAST_PRESSURE < pressure < MOST_PRESSURE or middle < LIGHTEST:
            continue
        try:
            found = WheelSoilModel(ModelWheel(r, b), soil).predict(true)
        except ParameterError:
            continue
        y = np.stack(found[:3], axis=1)
        if np.all(found.supported) and of_a_rig(y, r, np.max(load)):
            break
    y = _as_read(rng, y, load, r)
    sd = NOISE * np.array([z, 0.3 * middle, 0.3 * middle * r])
    y = y + sd * rng.normal(size=y.shape)
    columns = {"load": load, "slip": slip} | {c: y[:, j] for j, c in enumerate(MEASURED)}
    given = dict(zip(MEASURED, map(float, sd), strict=True)) if rng.random() < 0.6 else {}
    noise = NoiseLevels(slip=SLIP, load=LOAD * middle, **given)
    return Sound(columns, Setup(SetupWheel(r, b), SoilPriors(), noise), ""), soil


def _as_read(rng: np.random.Generator, y: np.ndarray, load: np.ndarray, r: float) -> np.ndarray:
    """Sinkage, pull and torque `y` [N, 3] under loads [N] as a usual rig reads them on a wheel of
    the radius r [m], without noise.
    """
    z, pull, torque = y.T
    middle = np.median(load)
    gain = 1.0 + 0.02 * rng.normal(size=2)
    zero = 0.003 * middle * rng.normal(size=2)
    crosstalk = 0.01 * rng.normal(size=2)
    tilt = math.radians(0.5 * rng.normal())
    pull_read = gain[0] * pull + zero[0] + crosstalk[0] * torque / r - load * math.sin(tilt)
    torque_read = gain[1] * torque + zero[1] * r + crosstalk[1] * pull * r
    return np.stack([z, pull_read, torque_read], axis=1)


def judged(table: Sound, soil: Soil) -> tuple[bool, dict[str, float]]:
    """(True if something is doubted or does not fit, {parameter: |error| over its standard
    deviation} of `JUDGED`) by `identify_table`; K and S in the logarithm.
    """
    found = identify_table(table.table(), table.setup)
    out = {}
    for name in JUDGED:
        p = found.parameters[name]
        value, low, high, truth = (
            x if name == "friction_angle_deg" else math.log(x)
            for x in (p.value, p.low, p.high, getattr(soil, name))
        )
        out[name] = abs(value - truth) / (high - low) * INTERVAL
    return bool(found.check_first or found.misfit), out


@click.command(help=__doc__)
@click.option("--tables", type=WholeNumber(1), default=20, metavar="N", help="Tables of each kind.")
@click.option("--rows", type=WholeNumber(60), default=120, metavar="N", help="Of a table.")
@seed_option()
def main(tables: int, rows: int, seed: int) -> None:
    """Print how often tables of each kind are doubted, and how often the intervals of each of
    `JUDGED` hold the truth.
    """
    for shared in (False, True):
        rng = np.random.default_rng(seed)
        found = [judged(*draw(rng, rows, shared)) for _ in range(tables)]
        print(f"scatter of {'drives' if shared else 'rows'}, tables of {rows} rows")
        print_share("  doubted, or not fitted", [doubted for doubted, _ in found])
        for name in JUDGED:
            for percent, reach in REACH.items():
                inside = [far[name] <= reach for _, far in found]
                print_share(f"  {name}, in the interval of {percent} %", inside)


if __name__ == "__main__":
    leave(run(main, None, "benchmarks.scattered_tables"))
