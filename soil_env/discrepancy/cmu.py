"""Convert the single-wheel measurements of Pavlov and Johnson (Carnegie Mellon University) into measurement tables.

PATH is a clone of github.com/robomechanics/3d-terramechanics (MIT licence, 2022 Catherine Pavlov), its folder
raw-data-processing, or any folder with all_smooth_data.mat and all_grouser_data.mat. Written into DIR: smooth.csv,
grouser.csv and beside each the setup, smooth.setup.yaml and grouser.setup.yaml.

A row is one run: the mean over 70 to 75 s after its start, about 0.7 m of travel at 10 mm/s; the rim speed sets the
slip. Only straight running (slip angle 0) is taken, and of it the runs commanded at a rim speed of 10 mm/s or more; at
10 mm/s the measured slip is 0 to within 0.006 and may be just below it. Signs are those of the repository's
average_data_to_model.m: drawbar pull is -avg_Fy, load -avg_Fz (of each run), sinkage -avg_Z, and slip is
(rim - 10)/max(10, rim) with the measured rim speed and the nominal travel speed. `run` names wheel, commanded rim speed
and repeat; the repository's trial_num counts the trials of one day and does not tell repeats apart. `time` is the
middle of the window, the same in every row: it tells the age of a run, not the order of the runs.

Cautions
- Radius and width are in conflict: 58 mm and 50 mm in this repository, 62.5 mm and 60 mm in the meshes of
  qishuny/3D-RFT-wheel for the smooth wheel of the same trials, whose grousered wheel has 62.7 mm to the tips. 58 mm
  and 5 mm of grouser fit the latter; the smooth wheel may be 62.5 mm. Nothing in the logs decides it.
- Sinkage is the travel of the carriage from a start put at 31.5 mm above the sand for both wheels
  (read_ft_speed_data.m), without the deflection of the rig (about 0.3 mm): a common offset of a few mm is possible,
  and whether the grousered wheel's counts from its rim or its tips is not said. The change with slip is safe.
- No torque, one load (22 to 28 N, not controlled: it differs between repeats), one travel speed: load and rate effects
  cannot be told, and rim speed goes with slip.
- Runs commanded at a rim speed of 12 mm/s turned at 13 mm/s, but for one of the grousered wheel, at 12.
- The mean of 5 s covers less than a turn of the wheel up to a rim speed of 40 mm/s.
- The plate tests are of another day than the runs, and their stiffness grows with the plate (see `plate_prior`).
- The values of cohesion (1 kPa), K (10 mm smooth, 21 mm grousered) and of n against slip in set_soil_params.m were
  tuned by hand to these same runs: they are no prior knowledge and are not in the setup.
"""

from __future__ import annotations

import csv
import io
import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from soil_env._io.commands import command_line, command_parser, folder, leave
from soil_env._io.files import check_outputs, replace_files
from soil_env._io.loading import ParameterError

REPOSITORY = "github.com/robomechanics/3d-terramechanics"
FILES = {"smooth": "all_smooth_data.mat", "grouser": "all_grouser_data.mat"}
FITS = "cmu_pressure_sinkage_fits.csv"
FIELDS = ("beta", "Vry", "avg_Vry", "slip", "avg_Fy", "avg_Fz", "avg_Z")
HEADER = ("run", "time", "slip", "load", "speed", "sinkage", "drawbar_pull")

RADIUS, WIDTH = 0.058, 0.05  # [m] set_rover_params.m
GROUSER_HEIGHT = {"smooth": 0.0, "grouser": 0.005}  # [m] the same
TRAVEL = 10.0  # [mm/s] nominal
WINDOW = 72.5  # [s] middle of the averages, plot_all_raw_data.m
REFERENCE_SINKAGE = 0.02  # [m] where the pressure of the plates is taken over, amid the wheels' 14 to 26 mm


# --- the runs ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Run:
    """One straight run in SI units."""

    name: str
    rim_command: float  # [mm/s]
    slip: float  # [-]
    load: float  # [N]
    sinkage: float  # [m]
    drawbar_pull: float  # [N]


def read_runs(path: Path, wheel: str, braking: bool = False) -> list[Run]:
    """Straight runs of an `all_*_data.mat`, by slip; without `braking` those commanded at slip >= 0.

    Raises `ParameterError` with one line for a file of other content, and where no run is left.
    """
    entries = _results(path)
    runs, repeats = [], {}
    for number, entry in enumerate(entries, start=1):
        value = {field: _number(path, number, field, entry[field]) for field in FIELDS}
        if value["beta"] != 0.0 or (value["Vry"] < TRAVEL and not braking):
            continue
        rim = value["avg_Vry"]
        expected = (rim - TRAVEL) / max(TRAVEL, rim)
        if abs(value["slip"] - expected) > 1e-3:
            raise ParameterError(
                f"{path}: all_results({number}), slip = {value['slip']:g}: expected (rim - 10)/max(10, rim) = "
                f"{expected:g} for avg_Vry = {rim:g} mm/s"
            )
        load, sinkage = -value["avg_Fz"], -value["avg_Z"] / 1000.0
        if not load > 0.0:
            raise ParameterError(
                f"{path}: all_results({number}), avg_Fz = {-load:g}: expected < 0 N, the load downward"
            )
        if not abs(sinkage) < RADIUS:
            raise ParameterError(
                f"{path}: all_results({number}), avg_Z = {value['avg_Z']:g}: expected mm within the wheel"
            )
        repeats[value["Vry"]] = repeats.get(value["Vry"], 0) + 1
        name = f"{wheel} rim {value['Vry']:g} mm/s #{repeats[value['Vry']]}"
        runs.append(Run(name, value["Vry"], value["slip"], load, sinkage, -value["avg_Fy"]))
    if not runs:
        least = "" if braking else f" at a rim speed >= {TRAVEL:g} mm/s"
        raise ParameterError(f"{path}: none of its {len(entries)} runs is left: expected some with beta = 0{least}")
    return sorted(runs, key=lambda run: (run.rim_command, run.name))


def _results(path: Path) -> np.ndarray:
    """The structs of `all_results` in a .mat file, with every field of `FIELDS`."""
    try:
        content = loadmat(path, variable_names=["all_results"])
    except Exception as error:  # a damaged file leads the reader into errors of any kind
        if isinstance(error, OSError) and error.strerror:
            raise ParameterError(f"{path}: cannot be read ({error.strerror})") from None
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise ParameterError(f"{path}: not a whole MATLAB 5 file ({reason[:100]})") from None
    results = content.get("all_results")
    if results is None:
        raise ParameterError(f"{path}: no variable all_results: expected the file of {REPOSITORY}")
    missing = [field for field in FIELDS if field not in (results.dtype.names or ())]
    if missing:
        raise ParameterError(f"{path}: all_results has no field {', '.join(missing)}: expected {', '.join(FIELDS)}")
    return results.ravel()


def _number(path: Path, number: int, field: str, value) -> float:
    """A 1 x 1 cell as a float."""
    array = np.asarray(value)
    if array.size != 1 or array.dtype.kind not in "iufb" or not math.isfinite(array.item()):
        raise ParameterError(f"{path}: all_results({number}), {field} is no finite number: expected one for each run")
    return float(array.item())


# --- the soil ---------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class PlatePrior:
    """Sinkage coefficient S [N/m^(n+2)] and exponent n as independent priors, and where they come from."""

    coefficient: float
    coefficient_sd: float
    exponent: float
    exponent_sd: float
    source: tuple[str, ...]


PUBLISHED = PlatePrior(
    8.0e6,
    1.9e6,
    1.46,
    0.03,
    (
        "Plate tests as the repository rounds them (set_soil_params.m): k = 8e3 kN/m^(n+2), n = 1.46. The sd are those",
        "of its 18 flat plates refitted (k 3.7e3 to 11.5e3, n 1.27 to 1.61): ln k at a given n scatters by 0.24.",
    ),
)


def plate_prior(path: Path) -> PlatePrior:
    """Priors of S and n from the fits p = k z^n of the flat-plate tests in a table of tests.

    k and n go together from plate to plate (k has the unit N/m^(n+2), and a steeper curve has a larger k), which
    independent priors cannot say: their scatters taken as two priors would make ln p at 20 mm uncertain by 0.45 where
    the plates scatter by 0.26. The value of S is the median of p(20 mm)/z^n at the median n. Its sd is the scatter of
    ln k about its line over n, which is the scatter at a given n; the sd of n is so small (0.03, not the plates' 0.08)
    that both together give the scatter of ln p at 20 mm that the plates have. Little is lost by that: a change of n by
    0.08 bends the curve by 5 % between 14 and 26 mm.

    Most of the scatter is plate size: at n = 1.46, S is 5.9e6 for 60 mm, 8.3e6 for 80 mm, 10.9e6 for 100 mm, each to
    within 9 %. The contact of the wheel (50 mm wide, 40 to 55 mm long ahead of the axle) is no plate of the series, so
    the sd has to cover the sizes. Static indentation of the smooth wheel itself (9 tests), read by Eq. (7) with
    r = 58 mm, b = 50 mm, gives 7.3e6 with 5 % scatter at n = 1.46, the same from 10 to 26 mm.
    """
    try:
        with path.open(encoding="utf-8", newline="") as stream:
            plates = [row for row in csv.DictReader(stream) if row["kind"] == "plate"]
        k = np.array([1e3 * float(row["k_kN_m_n2"]) for row in plates])
        n = np.array([float(row["n"]) for row in plates])
    except OSError as error:
        raise ParameterError(f"{path}: cannot be read ({error.strerror})") from None
    except (KeyError, TypeError, ValueError, csv.Error):
        raise ParameterError(f"{path}: expected columns kind, k_kN_m_n2, n with numbers for each plate") from None
    if k.size < 4 or not (np.all(np.isfinite(k * n)) and np.all(k > 0.0) and np.ptp(n) > 1e-3):
        raise ParameterError(f"{path}: {k.size} plate tests: expected 4 or more with k > 0 and different n")
    log_k, depth = np.log(k), math.log(REFERENCE_SINKAGE)
    exponent = float(f"{np.median(n):.3g}")
    log_pressure = log_k + n * depth
    coefficient = math.exp(float(np.median(log_pressure)) - exponent * depth)
    slope, intercept = np.polyfit(n, log_k, 1)
    spread = math.sqrt(float(np.sum((log_k - slope * n - intercept) ** 2)) / (k.size - 2))
    exponent_sd = float(np.std(n, ddof=1)) * abs(slope + depth) / abs(depth)
    together = math.hypot(spread, depth * exponent_sd)
    correlation = np.corrcoef(log_k, n)[0, 1]
    return PlatePrior(
        float(f"{coefficient:.3g}"),
        float(f"{coefficient * spread:.2g}"),
        exponent,
        float(f"{exponent_sd:.2g}"),
        (
            f"{k.size} flat plates ({path.name}): n median {np.median(n):.4g}, sd {np.std(n, ddof=1):.2g}; k median "
            f"{np.median(k):.3g}, sd {np.std(k, ddof=1):.2g};",
            f"correlation of n and ln k {correlation:.2f}; ln k at a given n scatters by {spread:.2f}; S: the median "
            f"p/z^n at 20 mm, at this n;",
            f"its sd: that scatter; sd of n: what makes the two together {together:.2f} in ln p at 20 mm, where the "
            f"plates have {np.std(log_pressure, ddof=1):.2f}.",
        ),
    )


# --- what is written --------------------------------------------------------------------------------------------------


def table_text(runs: list[Run]) -> str:
    """The measurement table as CSV."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow(HEADER)
    for run in runs:
        numbers = (WINDOW, run.slip, run.load, TRAVEL / 1000.0, run.sinkage, run.drawbar_pull)
        writer.writerow([run.name, *(f"{x:.7g}" for x in numbers)])
    return stream.getvalue()


def setup_text(wheel: str, prior: PlatePrior) -> str:
    """The setup as YAML, with the source of every number."""
    height = GROUSER_HEIGHT[wheel]
    grouser = f", grouser_height: {height:g}"
    source = "\n".join(f"  # {line}" for line in prior.source)
    return f"""\
# {wheel} wheel of the CMU single-wheel rig (Pavlov and Johnson), {REPOSITORY}, MIT licence.
# Cautions:
# - radius and width as in set_rover_params.m; the meshes of the same trials in qishuny/3D-RFT-wheel have 62.5 mm and
#   60 mm (smooth) and 62.7 mm to the grouser tips: r is uncertain by 4 mm, b by 10 mm;
# - the zero of the sinkage is a fixed start 31.5 mm above the sand for both wheels: a common offset of a few mm is
#   possible, its change with slip is safe;
# - no torque, one load (about 24 N), one travel speed (10 mm/s): rim speed and slip go together;
# - the plate tests are of another day than the runs.
wheel: {{radius: {RADIUS:g}, width: {WIDTH:g}{grouser}}}
soil:
{source}
  # Most of that scatter is plate size (60, 80, 100 mm: the larger the stiffer at one depth); the wheel is 50 mm wide.
  sinkage_coefficient: {{value: {prior.coefficient:.0f}, sd: {prior.coefficient_sd:.0f}}}   # N/m^(n+2), at this n
  sinkage_exponent: {{value: {prior.exponent:g}, sd: {prior.exponent_sd:g}}}
  # Angle of repose, 29 deg (set_soil_params.m). It is near the friction angle of loose dry sand; denser sand has more,
  # and how the sand was prepared is not stated: hence 3 deg.
  friction_angle_deg: {{value: 29, sd: 3}}
  density: 1330   # kg/m3, set_soil_params.m
  # cohesion and shear_modulus left out: fitted. The repository's 1 kPa and 10 or 21 mm are tuned to these same runs.
# noise left out: from the repeats, three of each rim speed, where they are at one slip.
"""


def convert(path: Path, out: Path, braking: bool = False) -> dict[str, list[Run]]:
    """Read the files under `path`, write tables and setups into `out`; the runs by wheel.

    Raises `ParameterError` for what cannot be read and `OSError` for what cannot be written, with nothing written.
    """
    names = [f"{wheel}{ending}" for wheel in FILES for ending in (".csv", ".setup.yaml")]
    check_outputs(out, names)
    folder = _folder(Path(path))
    runs = {wheel: read_runs(folder / name, wheel, braking) for wheel, name in FILES.items()}
    fits = folder / FITS
    prior = plate_prior(fits) if fits.exists() else PUBLISHED
    texts = [text for wheel in FILES for text in (table_text(runs[wheel]), setup_text(wheel, prior))]
    replace_files(out, dict(zip(names, texts, strict=True)))
    return runs


def _folder(path: Path) -> Path:
    """The folder with the two .mat files: `path`, or raw-data-processing in it."""
    if not path.is_dir():
        raise ParameterError(f"{path}: {'is a file' if path.exists() else 'not found'}: expected a folder")
    for place in (path, path / "raw-data-processing"):
        missing = [name for name in FILES.values() if not (place / name).is_file()]
        if not missing:
            return place
        if len(missing) < len(FILES):
            raise ParameterError(f"{place}: {missing[0]} not found: expected {' and '.join(FILES.values())}")
    raise ParameterError(f"{path}: expected {' and '.join(FILES.values())} there or in raw-data-processing/")


# --- command line -----------------------------------------------------------------------------------------------------


_EPILOG = """files:
  all_smooth_data.mat, all_grouser_data.mat    read, in PATH or PATH/raw-data-processing
  cmu_pressure_sinkage_fits.csv                read where it is beside them: plate tests, for the prior of the soil
  DIR/{smooth,grouser}.csv                     measurement tables, SI units
  DIR/{smooth,grouser}.setup.yaml              wheel, soil as the plate tests suggest, cautions

examples:
  python -m soil_env.discrepancy.cmu 3d-terramechanics --out tables
  python -m soil_env.discrepancy tables/smooth.csv --setup tables/smooth.setup.yaml --out smooth"""


@command_line("soil_env.discrepancy.cmu", interrupted="nothing written")
def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    parser = command_parser("python -m soil_env.discrepancy.cmu", __doc__, _EPILOG)
    parser.add_argument(
        "path", metavar="PATH", type=Path, help="clone of the repository, or the folder of its .mat files"
    )
    parser.add_argument(
        "--out",
        metavar="DIR",
        type=folder,
        required=True,
        help="folder for tables and setups, made if need be; required",
    )
    parser.add_argument(
        "--braking", action="store_true",
        help="also the runs with a rim slower than the travel, slip < 0 (default: driving only)",
    )  # fmt: skip
    options = parser.parse_args(arguments)
    runs = convert(options.path, options.out, options.braking)
    for wheel, of_wheel in runs.items():
        slips = len({run.rim_command for run in of_wheel})
        print(f"written: {options.out / wheel}.csv ({len(of_wheel)} runs, {slips} rim speeds) and {wheel}.setup.yaml")
    return 0


if __name__ == "__main__":
    leave(main())
