"""The example that converts the CMU single-wheel data: a made file, the data themselves where they
are, bad input.
"""

import csv
import os
from pathlib import Path

import numpy as np
import pytest
from scipy.io import savemat

from examples.cmu_rig import convert, main
from soil_env.measurement.setup import read_setup
from soil_env.measurement.table import read_table

DATA = Path(
    os.environ.get("SOIL_ENV_DATA") or Path(__file__).resolve().parents[3] / "shared" / "data"
)
CMU = DATA / "cmu_single_wheel"
measured = pytest.mark.skipif(not CMU.is_dir(), reason=f"no measured data in {CMU}")
WHEELS = {"smooth": "all_smooth_data.mat", "grouser": "all_grouser_data.mat"}

# slip angle, commanded and measured rim speed [mm/s], forces along, across and up in the sensor's
# frame, Z [mm]
TRIALS = (
    (0, 20, 20.0, 0.5, -0.8, -25.0, -22.5),
    (30, 20, 20.0, 9.0, 3.0, -25.0, -30.0),
    (0, 5, 5.0, 0.0, 17.0, -23.0, -24.0),
    (0, 10, 9.99, 0.1, 1.4, -24.0, -14.0),
    (0, 20, 20.02, 0.4, -1.3, -24.5, -22.0),
)


def saved(folder):
    """Write .mat files of the repository's structure into a folder: a column of structs of 1 x 1
    cells of mixed types.
    """
    folder.mkdir(parents=True, exist_ok=True)
    cells = [
        {
            "avg_Fx": fx,
            "avg_Fy": fy,
            "avg_Fz": fz,
            "avg_Vx": 9.99,
            "avg_Vry": rim,
            "avg_Z": np.float32(z),
            "polyx": np.ones((1, 2), np.float32),
            "Vry": np.uint8(command),
            "beta": np.uint8(beta),
            "trial_num": np.uint8(1),
            "slip": (rim - 10) / max(10, rim),
        }
        for beta, command, rim, fx, fy, fz, z in TRIALS
    ]
    results = np.array([tuple(row.values()) for row in cells], [(name, "O") for name in cells[0]])
    for name in WHEELS.values():
        savemat(folder / name, {"all_results": results[:, None]})


def test_tables_and_setups_of_a_made_file(tmp_path, capsys):
    saved(tmp_path / "clone" / "raw-data-processing")
    assert main([str(tmp_path / "clone"), "--out", str(tmp_path / "out" / "deep")]) == 0
    assert capsys.readouterr().out.count("3 runs") == 2
    out = tmp_path / "out" / "deep"
    setup = read_setup(out / "smooth.setup.yaml")
    table = read_table(out / "smooth.csv", setup.wheel)
    assert list(table.run) == [
        "smooth rim 10 mm/s #1",
        "smooth rim 20 mm/s #1",
        "smooth rim 20 mm/s #2",
    ]
    np.testing.assert_allclose(table.slip, [-0.001, 0.5, 10.02 / 20.02], atol=1e-7)
    np.testing.assert_allclose(table.load, [24.0, 25.0, 24.5])
    np.testing.assert_allclose(table.sinkage, [0.014, 0.0225, 0.022])
    np.testing.assert_allclose(table.drawbar_pull, [-1.4, 0.8, 1.3])
    # time: the middle [s] of the interval that the rig averages over, `examples.cmu_rig.WINDOW`
    assert set(table.speed) == {0.01} and set(table.time) == {72.5}
    assert np.all(np.isnan(table.torque))
    assert (setup.wheel.radius, setup.wheel.width, setup.wheel.grouser_height) == (0.058, 0.05, 0.0)
    assert read_setup(out / "grouser.setup.yaml").wheel.grouser_height == 0.005
    assert (setup.soil.sinkage_coefficient.value, setup.soil.sinkage_exponent.value) == (
        7.63e6,
        1.44,
    )
    assert (
        setup.soil.cohesion is None
        and setup.soil.shear_modulus is None
        and setup.noise.sinkage is None
    )
    assert setup.soil.friction_angle_deg.value == 29 and setup.soil.density.known


@measured
@pytest.mark.parametrize("wheel", WHEELS)
def test_the_measured_rows_are_those_of_the_derived_table(tmp_path, wheel):
    """Against cmu_wheel_steady.csv, derived from the same files by another program (five
    digits).
    """
    convert(CMU, tmp_path)
    table = read_table(
        tmp_path / f"{wheel}.csv", read_setup(tmp_path / f"{wheel}.setup.yaml").wheel
    )
    with (CMU / "cmu_wheel_steady.csv").open(newline="") as stream:
        rows = [
            row
            for row in csv.DictReader(stream)
            if row["wheel"] == wheel and float(row["slip_angle_deg"]) == 0
        ]
    rows = [row for row in rows if float(row["slip"]) > -0.01]  # driven
    assert len(table) == len(rows) == 15 and len(set(table.run)) == 15
    keys = {"slip": 1.0, "Fz_load_N": 1.0, "sinkage_mm": 1e-3, "Fx_drawbar_N": 1.0}
    expected = np.array(
        [[factor * float(row[key]) for key, factor in keys.items()] for row in rows]
    )
    got = np.column_stack([table.slip, table.load, table.sinkage, table.drawbar_pull])
    order = [values[np.lexsort(values[:, :2].round(3).T)] for values in (expected, got)]
    np.testing.assert_allclose(order[1], order[0], rtol=1e-4, atol=1e-6)
