"""The discrepancy workflow on measured data: the smooth and the grousered wheel of the CMU single-wheel rig.

    python -m benchmarks.cmu [--data FOLDER] [--out docs]

The smooth wheel comes first, with the soil that the plate tests suggest; then the grousered wheel, once with that soil
and once with the soil as calibrated on the smooth wheel. Each is repeated with the wheel sizes of the other publication
of the same trials (62.5 mm and 60 mm instead of 58 mm and 50 mm), since the radius is in doubt. Whole slips are held
out. Data: github.com/robomechanics/3d-terramechanics (Pavlov & Johnson), folder raw-data-processing; --data, else
$SOIL_ENV_DATA/cmu_single_wheel, else ../shared/data/cmu_single_wheel. Writes discrepancy_cmu.json and .md.
"""

from __future__ import annotations

import dataclasses
import json
import os
import tempfile
from pathlib import Path

from examples import cmu_rig as cmu
from soil_env._io.commands import command_line, command_parser, folder, leave
from soil_env._io.document import Table, render
from soil_env._io.files import make_folder, replace_files
from soil_env._io.loading import ParameterError
from soil_env.discrepancy import run
from soil_env.discrepancy.report import content
from soil_env.measurement.table import Prior, Setup, SetupWheel, read_setup

OTHER_SIZE = (0.0625, 0.060)  # [m] radius, width in qishuny/3D-RFT-wheel
SOIL = ("friction_angle_deg", "cohesion", "shear_modulus", "sinkage_coefficient", "sinkage_exponent")
CAUTIONS = (
    "Radius and width are in doubt by 4 and 10 mm; the rows `62.5 mm` show what the other figures give.",
    "The zero of the sinkage is in doubt by a few mm, the same for all slips; `sinkage_offset` stands for it.",
    "There is no torque, one load (about 24 N) and one travel speed (10 mm/s): effects that need more are untestable.",
    "Five slips from 0 to 0.9, three runs each: few enough that several effects can look alike.",
    "The plate tests were made on another day than the runs.",
)


@command_line("benchmarks.cmu")
def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    p = command_parser("python -m benchmarks.cmu", __doc__)
    p.add_argument(
        "--data", metavar="FOLDER", type=Path, help="folder with all_smooth_data.mat and all_grouser_data.mat"
    )
    p.add_argument("--out", metavar="OUT", type=folder, default=Path("docs"), help="folder of the page (default: docs)")
    options = p.parse_args(arguments)
    home = Path(os.environ.get("SOIL_ENV_DATA", Path(__file__).parents[2] / "shared" / "data"))
    make_folder(options.out)
    result = study(options.data or home / "cmu_single_wheel")
    files = {"discrepancy_cmu.json": json.dumps(result, indent=1) + "\n", "discrepancy_cmu.md": page(result)}
    replace_files(options.out, files)
    print(f"written: {options.out / 'discrepancy_cmu.json'} and .md")
    return 0


def study(data: Path) -> list[dict]:
    """What the workflow says of each table: one dict a run, with the keys of report.json."""
    out = []

    def judged(wheel: str, prior: str, size, table: Path, setup: Setup) -> dict:
        found = content(run(table, setup, seed=0))
        out.append({"wheel": wheel, "prior": prior, "size": size, **found})
        return found

    with tempfile.TemporaryDirectory() as folder:
        if cmu.main([str(data), "--out", folder]) != 0:
            raise ParameterError(f"{data}: expected the CMU data (see --help)")
        folder = Path(folder)
        for size in (None, OTHER_SIZE):
            smooth, grousered = (
                resized(read_setup(folder / f"{name}.setup.yaml"), size) for name in ("smooth", "grouser")
            )
            found = judged("smooth", "plate tests", size, folder / "smooth.csv", smooth)
            judged("grousered", "plate tests", size, folder / "grouser.csv", grousered)
            own = with_soil(grousered, found["soil"])
            judged("grousered", "of the smooth wheel", size, folder / "grouser.csv", own)
    return out


def resized(setup: Setup, size: tuple[float, float] | None) -> Setup:
    """The setup with another wheel radius and width."""
    if size is None:
        return setup
    return dataclasses.replace(setup, wheel=SetupWheel(*size, setup.wheel.grouser_height))


def with_soil(setup: Setup, soil: dict) -> Setup:
    """The setup with the soil of an earlier calibration as its prior."""
    priors = {
        name: Prior(soil[name]["value"], max((soil[name]["high"] - soil[name]["low"]) / 3.92, 1e-9)) for name in SOIL
    }
    return dataclasses.replace(setup, soil=dataclasses.replace(setup.soil, **priors))


def radius(result: dict) -> float:
    """Wheel radius of a result [mm]."""
    return 1e3 * (result["size"] or (0.058,))[0]


def page(result: list[dict]) -> str:
    """The results in Markdown."""
    head = ("wheel", "radius [mm]", "soil prior", "verdict", "effects (alternatives)", "sinkage, held-out rms [mm]",
            "drawbar pull, held-out rms [N]", "gap closed")  # fmt: skip
    rows = []
    for r in result:
        named = "; ".join(
            e["name"] + (f" ({', '.join(e['alternatives'])})" if e["alternatives"] else "") for e in r["effects"]
        )
        gaps = [
            f"{scale * g['before']:.2f} -> {scale * g['after']:.2f} (noise {scale * g['noise_floor']:.2f})"
            for g, scale in ((r["gap"]["sinkage"], 1e3), (r["gap"]["drawbar_pull"], 1.0))
        ]
        closed = "-" if r["closed"] is None else format(r["closed"], ".0%")
        rows.append((r["wheel"], f"{radius(r):g}", r["prior"], r["verdict"], named or "-", *gaps, closed))
    return render(
        "benchmarks:discrepancy_cmu.md", result=result, table=Table(head, rows), cautions=CAUTIONS,
        radius=lambda r: f"{radius(r):g}",
    ) + "\n"  # fmt: skip


if __name__ == "__main__":
    leave(main())
