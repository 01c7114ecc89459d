"""Base model, and soil that flows along the rim, against wheels that neither was made from.

    python -m benchmarks.rigs                minutes; writes docs/results/rigs.json and .md
    python -m benchmarks.rigs --data DIR     folder of the measurements, else $SOIL_ENV_DATA
    python -m benchmarks.rigs --smoke --out X   every part in seconds, numbers without meaning

The wheels are nine:
- the smooth and the lugged one of the Carnegie Mellon rig (Pavlov & Johnson; one load, no torque),
- a smooth one on a three-dimensional continuum (material point method; five loads),
- a lugged one on particles (discrete elements after Nakanishi 2020; one load),
- five of three published papers (benchmarks/measured; one load, driving).

A lugged wheel counts as a smooth one on a soil of its own.

A soil is fitted to rows by least squares with Gaussian priors and predicts rows that it was not
fitted to. Sinkage weighs 1 % of the radius, pull 2 % of the load, torque 2 % of the load times the
radius. Locked wheels (slip -1) are predicted and never fitted.

The constants of soil that flows along the rim are chosen on one rig and judged on the others.
Chosen are those with which soils from driving rows predict that rig best. This is done on the
continuum and on the Carnegie Mellon rig.

For two wheels a shear test gave K as well. It is compared with K as `soil-env identify` finds it
from the drive, where the rest of the soil is known from plates and shear tests.
"""

import math
import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import NamedTuple

import click
import numpy as np
from scipy.optimize import least_squares, minimize_scalar

from benchmarks.common import read_rig, ready, short, study_options, write
from soil_env._io.document import Table
from soil_env._io.files import write_json
from soil_env._io.loading import ParameterError
from soil_env.cli.running import PATH, leave, run
from soil_env.identification.table.fit import identify_table
from soil_env.measurement.setup import Prior, SoilPriors
from soil_env.parameters import SoilState, soils
from soil_env.terramechanics.steady import steady_state

NAME = "rigs"
#: Folder of the measurements where the environment names none, as for the tests.
BESIDE = Path(__file__).resolve().parents[2] / "shared" / "data"
DATA = Path(os.environ.get("SOIL_ENV_DATA") or BESIDE)
PUBLISHED = Path(__file__).resolve().parent / "measured"  # tables and setups, with their sources
data_option = click.option(
    "--data", type=PATH, default=DATA, metavar="DIR", help="Folder of the measurements."
)
LOCKED = -0.9  # [-] slip below which a wheel counts as locked
BRAKED = -0.05  # [-] slip below which a wheel counts as braked
TRAINING_LOADS = (40.0, 80.0, 150.0)  # [N] of the continuum; the others are predicted
SINKAGE_SD = 0.01  # [radii] weight of sinkage
FORCE_SD = 0.02  # [loads], [loads x radius] weight of pull and torque
DEPTH = 0.1  # [radii] at which the pressure, not S, is fitted: its unit depends on n
RECOVERY = 0.5  # [-] of slip-sinkage, as in the shipped soils
#: Prior mean and standard deviation, bounds, and starting values of what is fitted.
FRICTION = (33.0, 6.0, 5.0, 60.0)  # [deg] sand
LN_MODULUS = (math.log(0.1), 1.0, math.log(2e-3), math.log(3.0))  # ln of K over the radius
EXPONENT = (1.0, 0.4, 0.2, 2.5)  # [-]
DIGGING = (1.0, 1.5, 0.0, 8.0)  # [-] gain of slip-sinkage
LN_COHESION = (math.log(300.0), 1.0, 0.0, 9.0)  # ln of c [Pa], where it is not known to be 0
LN_PRESSURE = (8.0, 1e3, 3.0, 18.0)  # ln of the pressure [Pa] at DEPTH: free
#: [-] Ranges of the constants that are chosen.
FLOWS = (0.04, 0.12)  # a
GROWTHS = (0.0, 1.0, 1.5)  # p
PEAK = 0.25  # [-] shift of the braked stress peak, which is not chosen
LENGTH = 0.45  # [radii] contact length that K belongs to: that of the sinkage `DEPTH`
FLOW_ERROR = 5e-4  # [-] of a
#: Rigs that constants are chosen on, with their wheels.
CHOSEN_ON = {"continuum": ("continuum",), "CMU": ("CMU smooth", "CMU lugged")}
#: Wheels of `PUBLISHED` on the soil of Ding et al. (2011), J. Terramechanics 48:27-45, Table 2:
#: plates and shear tests. Standard deviations are own assumptions.
DING = ("ding_smooth", "ding_lugged")
DING_SOIL = SoilPriors(
    friction_angle_deg=Prior(31.9, 2.0),
    cohesion=Prior(250.0, 150.0),
    k_c=Prior(15.6e3, 3e3),
    k_phi=Prior(2407.4e3, 500e3),
    sinkage_exponent=Prior(1.10, 0.1),
    density=Prior(1605.0, 0.0),
)
DING_MODULUS = "9.7 to 13.1"  # [mm] K of the shear tests
TEXT = (
    "Eq. (10) and soil that flows along the rim, both with slip-sinkage: a soil fitted to some "
    "rows and others predicted. Rows that were fitted are among the predicted ones where driving "
    "rows were fitted on a rig of one load. `flow, continuum` has the constants chosen on the "
    "continuum, `flow, CMU` those chosen on both wheels of that rig: with them soils from driving "
    "rows predict its rows best; `flow, presets` has those of the presets of soils, whose "
    "K does not grow. What counts are the rows of the other rig. The angle from which soil rises "
    "along a locked rim and the peak's shift were set by hand on the CMU wheels. On the particles "
    "and on the wheels of Ding et al. (2011) soil that flows is worse; friction and exponent are "
    "at their bounds on the particles already with Eq. (10)."
)
STARTS = tuple((phi, math.log(k)) for phi in (28.0, 38.0) for k in (0.05, 0.2))


class Law(NamedTuple):
    """Shear law: Eq. (10), or with soil that flows along the rim, as fields of `SoilState`."""

    rim_flow: float = 0.0
    braked_peak: float = 0.0
    shear_growth: float = 0.0


@dataclass(frozen=True, eq=False)
class Rig:
    """Measured steady points of a wheel, by slip; columns [N]."""

    radius: float  # [m]
    width: float  # [m]
    zero: float  # [m] standard deviation of the zero of its sinkage
    cohesive: bool  # False: the material has no cohesion
    slip: np.ndarray
    load: np.ndarray  # [N]
    measured: np.ndarray  # [N, 3] sinkage [m], pull [N], torque [N m], NaN where not measured

    @property
    def scale(self) -> np.ndarray:
        """Errors [N, 3] of sinkage [m], pull [N] and torque [N m] that weigh 1 in a fit: as one
        standard deviation of a prior does.
        """
        force = FORCE_SD * self.load
        return np.stack(
            [np.full(self.load.size, SINKAGE_SD * self.radius), force, force * self.radius], axis=1
        )


def read_rigs(folder: Path) -> dict[str, Rig]:
    """Rigs by name from a folder of measurements. Raises `ParameterError` where one is missing."""
    cmu = _rows(folder / "cmu_single_wheel" / "cmu_wheel_means_of_3.csv")
    straight = cmu[cmu["slip_angle_deg"] == 0.0]
    rigs = {}
    # Each by radius, width and sd of the zero of its sinkage [m], True if cohesive, columns.
    for name, label in (("smooth", "CMU smooth"), ("grouser", "CMU lugged")):
        rows = straight[straight["wheel"] == name]
        rigs[label] = Rig(
            0.058,
            0.05,
            0.0025,
            True,
            *_columns(
                rows,
                ("slip_mean", 1.0),
                ("Fz_load_N_mean", 1.0),
                ("sinkage_mm_mean", 1e-3),
                ("Fx_drawbar_N_mean", 1.0),
            ),
        )
    plain = tuple((n, 1.0) for n in ("slip", "load", "sinkage", "drawbar_pull", "torque"))
    continuum = _rows(folder / "continuum_3d" / "smooth_wheel.csv")
    rigs["continuum"] = Rig(0.15, 0.1, 0.0, False, *_columns(continuum, *plain))
    particles = _rows(folder / "dem_kyoto" / "lugged_wheel.csv")
    rigs["particles"] = Rig(0.11, 0.1, 0.00125, False, *_columns(particles, *plain))
    for name in sorted(path.stem for path in PUBLISHED.glob("*.csv")):
        table, setup = read_rig(PUBLISHED, name)
        values = np.stack([table.sinkage, table.drawbar_pull, table.torque], axis=1)
        wheel = setup.wheel
        rigs[name] = Rig(wheel.radius, wheel.width, 0.0, True, table.slip, table.load, values)
    return rigs


def _rows(path: Path) -> np.ndarray:
    """Rows of a CSV file, as records with its columns."""
    if not path.is_file():
        raise ParameterError(f"{path}: no such file: expected a folder of measurements, --data DIR")
    return np.genfromtxt(
        path, dtype=None, comments=None, delimiter=",", names=True, encoding="utf-8"
    )


def _columns(rows: np.ndarray, *columns: tuple[str, float]) -> tuple[np.ndarray, ...]:
    """(slip [N], load [N], measured [N, 3]) in SI units from (name, factor) of each column.

    The columns are slip and load, then sinkage, pull and torque as far as there are any; NaN
    without one.
    """
    values = np.stack([rows[name] * factor for name, factor in columns], axis=1)
    measured = np.full((len(values), 3), math.nan)
    measured[:, : values.shape[1] - 2] = values[:, 2:]
    return values[:, 0], values[:, 1], measured


def priors(rig: Rig) -> np.ndarray:
    """Prior mean, standard deviation, lower and upper bound [7, 4] of the unknowns of `soil_of`, in
    its order; the zero of the sinkage is within two of its standard deviations.
    """
    # A zero that is known is given hardly any room, since least squares needs some.
    zero = max(rig.zero, 1e-9)
    return np.array(
        [
            FRICTION,
            LN_MODULUS,
            LN_PRESSURE,
            EXPONENT,
            DIGGING,
            LN_COHESION,
            (0.0, zero, -2.0 * zero, 2.0 * zero),
        ]
    )


def soil_of(x: np.ndarray, rig: Rig, law: Law) -> SoilState:
    """Soil of the unknowns `x` [7] under the wheel of a rig, with the shear law `law`.

    They are phi [deg], ln K/r, ln of the pressure [Pa] at `DEPTH`, n, gain of slip-sinkage, ln of c
    [Pa], and the zero of the sinkage [m]. The last is an error of the rig, for `predict`.
    """
    n = float(x[3])
    return SoilState(
        tan_phi=math.tan(math.radians(x[0])),
        cohesion=math.exp(x[5]) if rig.cohesive else 0.0,
        shear_modulus=math.exp(x[1]) * rig.radius,
        sinkage_coefficient=math.exp(x[2]) / (DEPTH * rig.radius) ** n,
        sinkage_exponent=n,
        dig_gain=float(x[4]),
        dig_recovery=RECOVERY,
        **law._asdict(),
        shear_length=LENGTH * rig.radius,
    )


def predict(x: np.ndarray, rig: Rig, rows: np.ndarray, law: Law) -> np.ndarray:
    """Sinkage [m], pull [N] and torque [N m], [N, 3], of `rows` (N indices) by the unknowns `x` of
    `soil_of`.
    """
    soil = soil_of(x, rig, law)
    out = np.empty((rows.size, 3))
    for k, row in enumerate(rows):
        s = steady_state(rig.slip[row], rig.load[row], soil, rig.radius, rig.width)
        out[k] = s.sinkage + x[6], s.drawbar_pull, s.torque
    return out


def fit(rig: Rig, rows: np.ndarray, law: Law, starts: int) -> np.ndarray:
    """Unknowns [7] of `soil_of` that fit the `rows` (indices) best under their priors, from the
    first `starts` of `STARTS`.
    """
    mean, sd, low, high = priors(rig).T
    scale = rig.scale[rows]

    def residuals(x: np.ndarray) -> np.ndarray:
        """Errors of what was measured over `Rig.scale`, then deviations of the unknowns from their
        prior means over the prior sds.
        """
        misfit = (predict(x, rig, rows, law) - rig.measured[rows]) / scale
        return np.concatenate([misfit[np.isfinite(misfit)], (x - mean) / sd])

    pressure = math.log(np.median(rig.load) / (rig.width * rig.radius))
    # Scales are sds of the priors, at most 1: that of the pressure, which is free, is 1e3.
    found = [
        least_squares(
            residuals, [*start, pressure, *mean[3:]], bounds=(low, high), x_scale=sd.clip(max=1.0)
        )
        for start in STARTS[:starts]
    ]
    return min(found, key=lambda fitted: fitted.cost).x


def splits(rig: Rig) -> list[tuple[str, list[tuple[np.ndarray, np.ndarray]]]]:
    """(label, folds) of a rig; a fold is the rows (indices) that are fitted and those that are
    predicted.

    With loads in and beside `TRAINING_LOADS` the others are predicted, from driving rows and from
    all. Else each row that is not locked is left out in turn. With braked rows, all are predicted
    from driving ones before that.
    """
    every = np.flatnonzero(rig.slip > LOCKED)  # but for locked rows
    rows = np.arange(rig.slip.size)
    driving = rig.slip > BRAKED
    trained = np.isin(rig.load, TRAINING_LOADS)
    if trained.any() and not trained.all():
        others = rows[~trained]
        return [
            ("driving rows of other loads", [(rows[trained & driving], others)]),
            ("rows of other loads", [(rows[trained], others)]),
        ]
    slips = [(every[every != k], every[every == k]) for k in every]
    if driving[every].all():
        return [("rows of other slips", slips)]
    return [("driving rows", [(np.flatnonzero(driving), rows)]), ("rows of other slips", slips)]


def choose(rigs: list[Rig], starts: int, growths: tuple[float, ...]) -> Law:
    """Choose the law with which fitted soils predict the rows of some rigs best.

    Of each rig a soil is fitted to rows of the first fold of its first split (`splits`), and judged
    on the predicted rows of that fold that are not locked. The law's flow is sought within `FLOWS`
    for each of the `growths`; its peak is `PEAK`. `starts` as of `fit`.
    """

    def misfit(flow: float, growth: float) -> float:
        """Sum of the squared errors over `Rig.scale` with a law of these constants."""
        law = Law(flow, PEAK, growth)
        total = 0.0
        for rig in rigs:
            fitted, predicted = splits(rig)[0][1][0]
            predicted = predicted[rig.slip[predicted] > LOCKED]
            x = fit(rig, fitted, law, starts)
            off = (predict(x, rig, predicted, law) - rig.measured[predicted]) / rig.scale[predicted]
            total += float(np.nansum(off * off))
        return total

    found = []
    for growth in growths:
        best = minimize_scalar(
            misfit, bounds=FLOWS, args=(growth,), method="bounded", options={"xatol": FLOW_ERROR}
        )
        found.append((best.fun, Law(float(best.x), PEAK, growth)))
    return min(found)[1]


def figures(name: str, rig: Rig, law: Law, starts: int, folds: int | None) -> list[dict]:
    """Rows (`_row`) of the table of the rig `name`: rms errors of the predictions by channel.

    There is one for each of the `splits` and each motion with rows: driving, braked or locked. Of
    the split "driving rows" the driving ones are those that were fitted.

    `starts` as of `fit`; `folds`: number of folds of each split that are used, None for all.
    """
    out = []
    motions = {
        "driving": rig.slip > BRAKED,
        "braked": (rig.slip <= BRAKED) & (rig.slip > LOCKED),
        "locked": rig.slip <= LOCKED,
    }
    for label, split in splits(rig):
        off = np.full(rig.measured.shape, math.nan)
        seen = np.zeros(rig.slip.size, dtype=bool)
        for fitted, predicted in split[:folds]:
            x = fit(rig, fitted, law, starts)
            off[predicted] = predict(x, rig, predicted, law) - rig.measured[predicted]
            seen[predicted] = True
        for motion, part in motions.items():
            rows = np.flatnonzero(part & seen)
            if rows.size:
                out.append(_row(name, label, motion, off[rows], rig.load[rows]))
    return out


def _row(rig: str, fitted: str, predicted: str, off: np.ndarray, load: np.ndarray) -> dict:
    """Row of the table: names of rig, fitted and predicted rows, and rms of the errors `off` [N, 3]
    at loads [N]; NaN of a channel with a NaN among them.
    """
    sinkage, pull, torque = np.sqrt(np.mean(np.square(off), axis=0))
    share = np.sqrt(np.mean(np.square(off[:, 1] / load)))
    return {
        "rig": rig,
        "fitted": fitted,
        "predicted": predicted,
        "rows": len(off),
        "sinkage_mm": 1e3 * sinkage,
        "pull_N": pull,
        "pull_share_of_load": share,
        "torque_Nm": torque,
    }


def all_figures(
    rigs: dict[str, Rig], laws: dict[str, Law], starts: int, folds: int | None
) -> list[dict]:
    """Rows of the table: those of each rig by `figures`, each under one law after the other, whose
    name is "law".
    """
    out = []
    for name, rig in rigs.items():
        found = [figures(name, rig, law, starts, folds) for law in laws.values()]
        for same in zip(*found, strict=True):
            out += [{"law": law, **row} for law, row in zip(laws, same, strict=True)]
        print(f"{name}: done", flush=True)
    return out


def moduli(laws: dict[str, Law]) -> list[dict]:
    """K [mm] with its 95 % interval, as `identify` finds it on the wheels of `DING` by each law,
    without slip-sinkage: rows {wheel, law, K_mm, low, high}.
    """
    out = []
    for name in DING:
        table, setup = read_rig(PUBLISHED, name)
        for label, law in laws.items():
            flow = {key: Prior(value, 0.0) for key, value in law._asdict().items()}
            known = setup.changed(soil=replace(DING_SOIL, **flow))
            found = identify_table(table, known).parameters["shear_modulus"]
            k, low, high = (1e3 * x for x in (found.value, found.low, found.high))
            out.append({"wheel": name, "law": label, "K_mm": k, "low": low, "high": high})
    return out


def moduli_of(rows: list[dict]) -> Table:
    """The rows of `moduli` as a page shows them."""
    cells = [
        [r["wheel"], r["law"], f"{r['K_mm']:.1f} [{r['low']:.1f}, {r['high']:.1f}]", DING_MODULUS]
        for r in rows
    ]
    return Table(["wheel", "law", "K [mm] from the drive", "K [mm] from shear tests"], cells)


def constants_of(laws: dict[str, Law]) -> Table:
    """Constants of the laws as a page shows them."""
    head = ["law", "rim_flow", "braked_peak", "shear_growth"]
    return Table(head, [[name, *(f"{x:.3g}" for x in law)] for name, law in laws.items()])


def table_of(rows: list[dict]) -> Table:
    """The rows of `all_figures` as a page shows them."""
    cells = [
        [
            r["rig"],
            r["fitted"],
            r["predicted"],
            r["law"],
            f"{r['sinkage_mm']:.1f}",
            f"{r['pull_N']:.1f}",
            f"{100.0 * r['pull_share_of_load']:.0f}",
            "-" if math.isnan(r["torque_Nm"]) else f"{r['torque_Nm']:.2f}",
        ]
        for r in rows
    ]
    head = [
        "wheel",
        "fitted to",
        "predicted",
        "law",
        "sinkage [mm]",
        "pull [N]",
        "pull [% of load]",
        "torque [N m]",
    ]
    return Table(head, cells)


@click.command(NAME)
@study_options(NAME)
@data_option
def command(data: Path, smoke: bool, out: Path) -> None:
    """Errors of the base model and of soil that flows along the rim on measured and finely
    simulated wheels.
    """
    path = ready(out, NAME)
    rigs = read_rigs(data)
    laws = {"Eq. (10)": Law()}
    for on, names in CHOSEN_ON.items():
        on_these = [rigs[name] for name in names]
        # One start: many constants are tried, and the figures below have all starts.
        laws[f"flow, {on}"] = choose(on_these, 1, GROWTHS[:1] if smoke else GROWTHS)
    preset = soils()["dry_sand"]
    laws["flow, presets"] = Law(preset.rim_flow, preset.braked_peak, preset.shear_growth)
    starts, folds = (1, 1) if smoke else (len(STARTS), None)
    rows = all_figures(rigs, laws, starts, folds)
    found_moduli = moduli({name: laws[name] for name in ("Eq. (10)", "flow, presets")})
    constants = {name: law._asdict() for name, law in laws.items()}
    content = {
        "command": f"python -m benchmarks.{NAME}",
        "laws": constants,
        "rows": rows,
        "moduli": found_moduli,
    }
    write_json(path, short(content))
    tables = {
        "Constants": constants_of(laws),
        "Root mean square of predicted less measured": table_of(rows),
        "Shear deformation modulus on the soil of Ding et al. (2011)": moduli_of(found_moduli),
    }
    write(out, NAME, "Rigs", TEXT, tables)


if __name__ == "__main__":
    leave(run(command, None, f"benchmarks.{NAME}"))
