"""Make measurement tables of the single-wheel runs of Pavlov and Johnson (Carnegie Mellon
University).

    git clone https://github.com/robomechanics/3d-terramechanics
    python examples/cmu_rig.py 3d-terramechanics --out tables
    soil-env discover tables/smooth.csv --setup tables/smooth.setup.yaml --out smooth

Writes smooth.csv, grouser.csv and beside each its setup. A row is one straight run: the mean over
70 to 75 s at a travel speed of 10 mm/s; the rim speed sets the slip. Signs are those of the
repository's average_data_to_model.m.

Cautions: radius and width are uncertain by 4 and 10 mm, and the zero of the sinkage by a few mm,
the same for all slips. There is no torque, one load (about 24 N) and one travel speed. Cohesion and
K of set_soil_params.m were tuned to these runs, so they are no prior knowledge and are not in the
setup.
"""

import argparse
import csv
import sys
from pathlib import Path

import numpy as np
from scipy.io import loadmat

from soil_env import ParameterError

FILES = {"smooth": "all_smooth_data.mat", "grouser": "all_grouser_data.mat"}
FIELDS = ("beta", "Vry", "avg_Vry", "slip", "avg_Fy", "avg_Fz", "avg_Z")
HEADER = ("run", "time", "slip", "load", "speed", "sinkage", "drawbar_pull")
RADIUS = 0.058  # [m] set_rover_params.m
WIDTH = 0.05  # [m] the same
GROUSER_HEIGHT = {"smooth": 0.0, "grouser": 0.005}  # [m] the same
TRAVEL = 10.0  # [mm/s] nominal
WINDOW = 72.5  # [s] middle of the averages
#: Sinkage coefficient [N/m^(n+2)] and exponent with their sd, from p = k z^n of the 18 flat plates
#: of the repository: the median n, and the median pressure at 20 mm, amid the wheels' 14 to 26 mm.
#: k and n are correlated from plate to plate: the sd of S is the scatter of ln k at a given n, and
#: that of n what the scatter of ln p at 20 mm leaves.
PLATES = (7.63e6, 1.9e6, 1.44, 0.029)


def read_runs(path: Path, wheel: str) -> list[tuple]:
    """Rows of `HEADER` in SI units, a row for each straight run of an `all_*_data.mat` whose rim is
    no slower than the travel, by rim speed.

    `wheel` begins the names of the runs. Raises `ParameterError` for a file that is not whole, for
    impossible values in such a run, and where no such run is there.
    """
    try:
        results = loadmat(path, variable_names=["all_results"]).get("all_results")
    except Exception as error:  # a damaged file leads the reader into errors of any kind
        raise ParameterError(f"{path}: not a whole MATLAB 5 file ({error})") from None
    if results is None or set(FIELDS) - set(results.dtype.names or ()):
        raise ParameterError(
            f"{path}: expected a variable all_results with the fields {', '.join(FIELDS)}"
        )
    rows = []
    repeats = {}
    for number, entry in enumerate(results.ravel(), start=1):
        try:
            run = {field: float(np.asarray(entry[field]).item()) for field in FIELDS}
        except (TypeError, ValueError):
            raise ParameterError(
                f"{path}: all_results({number}): expected one number in each of {', '.join(FIELDS)}"
            ) from None
        if run["beta"] != 0.0 or run["Vry"] < TRAVEL:
            continue
        rim = run["avg_Vry"]
        load = -run["avg_Fz"]
        sinkage = -run["avg_Z"] / 1000.0
        expected = (rim - TRAVEL) / max(TRAVEL, rim)
        if not (abs(run["slip"] - expected) <= 1e-3 and load > 0.0 and abs(sinkage) < RADIUS):
            raise ParameterError(
                f"{path}: all_results({number}): slip = {run['slip']:g}, avg_Fz = {-load:g}, avg_Z "
                f"= {run['avg_Z']:g}: expected slip {expected:.4g} of that rim speed, the load "
                "downward in N and mm within the wheel"
            )
        repeats[run["Vry"]] = repeats.get(run["Vry"], 0) + 1
        name = f"{wheel} rim {run['Vry']:g} mm/s #{repeats[run['Vry']]}"
        numbers = (WINDOW, run["slip"], load, TRAVEL / 1000.0, sinkage, -run["avg_Fy"])
        rows.append((run["Vry"], (name, *(f"{x:.7g}" for x in numbers))))
    if not rows:
        raise ParameterError(
            f"{path}: none of its {results.size} runs is left: expected some with beta = 0"
        )
    return [row for _, row in sorted(rows, key=lambda of_rim: of_rim[0])]


def setup_text(wheel: str) -> str:
    """Text of the setup file of a wheel of `FILES`, "smooth" or "grouser", as YAML."""
    coefficient, coefficient_sd, exponent, exponent_sd = PLATES
    size = f"radius: {RADIUS:g}, width: {WIDTH:g}, grouser_height: {GROUSER_HEIGHT[wheel]:g}"
    plates = f"value: {coefficient:.0f}, sd: {coefficient_sd:.0f}"
    return f"""\
# {wheel} wheel of Pavlov and Johnson, github.com/robomechanics/3d-terramechanics, MIT licence
wheel: {{{size}}}   # set_rover_params.m
soil:
  sinkage_coefficient: {{{plates}}}   # N/m^(n+2), flat plates
  sinkage_exponent: {{value: {exponent:g}, sd: {exponent_sd:g}}}
  friction_angle_deg: {{value: 29, sd: 3}}   # angle of repose of loose dry sand, set_soil_params.m
  density: 1330   # kg/m3, set_soil_params.m
  # cohesion and shear_modulus left out: fitted
# noise left out: from the repeats, three of each rim speed, where they are at one slip
"""


def convert(path: Path, out: Path) -> dict[str, int]:
    """Read the files in `path`, or in its raw-data-processing, write tables and setups into `out`,
    and return {wheel: number of runs}. Raises `ParameterError` where the files are not there.
    """
    home = next(
        (p for p in (path, path / "raw-data-processing") if (p / FILES["smooth"]).is_file()), None
    )
    if home is None or not (home / FILES["grouser"]).is_file():
        raise ParameterError(
            f"{path}: expected {' and '.join(FILES.values())} there or in raw-data-processing/"
        )
    runs = {wheel: read_runs(home / name, wheel) for wheel, name in FILES.items()}
    out.mkdir(parents=True, exist_ok=True)
    for wheel, rows in runs.items():
        with (out / f"{wheel}.csv").open("w", encoding="utf-8", newline="") as stream:
            csv.writer(stream, lineterminator="\n").writerows([HEADER, *rows])
        (out / f"{wheel}.setup.yaml").write_text(setup_text(wheel), encoding="utf-8")
    return {wheel: len(rows) for wheel, rows in runs.items()}


def main(arguments: list[str] | None = None) -> int:
    """Convert and print what was written; return the exit status, 2 where files are no use."""
    p = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument(
        "path", type=Path, help="clone of the repository, or the folder of its .mat files"
    )
    p.add_argument(
        "--out", type=Path, required=True, metavar="DIR", help="folder for tables and setups"
    )
    options = p.parse_args(arguments)
    try:
        runs = convert(options.path, options.out)
    except (ParameterError, OSError) as error:
        print(f"cmu_rig.py: error: {error}", file=sys.stderr)
        return 2
    for wheel, count in runs.items():
        print(f"written: {options.out / wheel}.csv ({count} runs) and {wheel}.setup.yaml")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
