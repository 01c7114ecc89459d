"""Identification from measurement tables: soils recovered, calibrated intervals, what cannot be told, command line.

The tables come from `tests.reference`, the independent implementation of Eqs. (1)-(3).
"""

import csv
import json
import math
import subprocess
import sys
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import brentq

from soil_env.identification.__main__ import main
from soil_env.identification.table import identify_table
from soil_env.loading import ParameterError
from soil_env.measurement import NoiseLevels, Prior, Setup, SetupWheel, SoilPriors, read_setup, read_table
from tests import reference

WHEEL = SetupWheel(0.15, 0.12)
SAND = reference.Ground(31.0, 1500.0, 0.018, 9e5, 0.9)
CLAY = reference.Ground(20.0, 68950.0, 0.006, 1861609.0, 0.2)  # Wong: lean clay, 22 % moisture
SD = {"sinkage": 3e-4, "drawbar_pull": 0.7, "torque": 0.1}
SLIPS, LOADS = tuple(np.round(np.linspace(0.05, 0.7, 8), 3)), (60.0, 120.0, 240.0)
NAMES = ("friction_angle_deg", "cohesion", "shear_modulus", "sinkage_coefficient", "sinkage_exponent")  # as Ground
EXAMPLE = Path(__file__).parent.parent / "examples" / "data"


@cache
def clean(soil=SAND, slips=SLIPS, loads=LOADS, wheel=WHEEL):
    """Rows [N, 5] of slip, load, sinkage, drawbar pull, torque without noise."""
    rows = []
    for load in loads:
        for slip in slips:

            def at(z, slip=slip):
                return reference.forces(soil, slip, math.acos(1.0 - z / wheel.radius), wheel.radius, wheel.width)

            def lacking(z, load=load, at=at):
                return at(z).load - load

            z = brentq(lacking, 1e-6, 0.9 * wheel.radius, xtol=1e-10, rtol=1e-9)
            rows.append((slip, load, z, at(z).drawbar_pull, at(z).torque))
    return np.array(rows)


def table_of(folder, rows, rng=None, sd=SD, leave_out=()):
    """A table read back from a CSV file with `rows` and noise."""
    rows = rows.copy()
    if rng is not None:
        rows[:, 2:] += rng.normal(size=(len(rows), 3)) * [sd["sinkage"], sd["drawbar_pull"], sd["torque"]]
    names = ("slip", "load", "sinkage", "drawbar_pull", "torque")
    keep = [k for k, name in enumerate(names) if name not in leave_out]
    with (folder / "data.csv").open("w", newline="") as stream:
        writer = csv.writer(stream)
        writer.writerow([names[k] for k in keep])
        writer.writerows([[f"{row[k]:.6g}" for k in keep] for row in rows])
    return read_table(folder / "data.csv", WHEEL)


def setup_of(known=(), noise=SD, soil=SAND, **priors):
    """A setup in which some parameters are known, some have priors and the rest are left out."""
    truth = dict(zip(NAMES, soil, strict=True))
    return Setup(WHEEL, SoilPriors(**{k: Prior(truth[k], 0.0) for k in known}, **priors), NoiseLevels(**(noise or {})))


def write_example(path):
    """The synthetic table of examples/data."""
    rows = clean(slips=(0.05, 0.15, 0.25, 0.35, 0.5, 0.65))
    rng = np.random.default_rng(0)
    noisy = rows[:, 2:] + rng.normal(size=(len(rows), 3)) * list(SD.values())
    with Path(path).open("w", newline="") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(["slip", "load", "sinkage", "drawbar_pull", "torque", "run"])
        for (slip, load, *_), (z, pull, torque) in zip(rows, noisy, strict=True):
            writer.writerow([f"{slip:g}", f"{load:g}", f"{z:.5f}", f"{pull:.2f}", f"{torque:.3f}", "synthetic"])


# --- recovery ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("known", [("cohesion", "sinkage_exponent"), ("cohesion",), ()], ids=["3", "4", "5"])
@pytest.mark.parametrize("soil", [SAND, CLAY], ids=["sand", "clay"])
def test_recovers_the_soil_without_noise(tmp_path, known, soil):
    loads = LOADS if soil is SAND else (2e3, 4e3, 8e3)
    noise = {"sinkage": 1e-5, "drawbar_pull": 0.01 * loads[0] / 60, "torque": 0.002 * loads[0] / 60}
    e = identify_table(table_of(tmp_path, clean(soil, loads=loads)), setup_of(known, noise, soil))
    assert e.converged
    for name, truth in zip(NAMES, soil, strict=True):
        assert e.parameters[name].value == pytest.approx(truth, rel=3e-3), name
        assert e.parameters[name].known == (name in known)
    z = e.reference_sinkage
    truth = soil.sinkage_coefficient * z**soil.sinkage_exponent
    assert e.parameters["reference_pressure"].value == pytest.approx(truth, rel=1e-3)


@pytest.mark.parametrize(
    "known, noise",
    [(("cohesion", "sinkage_exponent"), SD), (("cohesion",), SD), ((), SD), ((), None)],
    ids=["3", "4", "5", "5, noise estimated"],
)
def test_intervals_cover_the_truth(tmp_path, known, noise):
    """60 draws, 95 % intervals: fewer than 51 or hits has probability 5e-4 a parameter if they are calibrated."""
    rng, hits, scaled, draws = np.random.default_rng(5), {}, {}, 60
    setup = setup_of(known, noise)
    for _ in range(draws):
        e = identify_table(table_of(tmp_path, clean(), rng), setup)
        assert e.converged and not e.warnings
        for name, truth in zip(NAMES, SAND, strict=True):
            p = e.parameters[name]
            if not p.known:
                hits[name] = hits.get(name, 0) + (p.low <= truth <= p.high)
                scaled.setdefault(name, []).append((p.value - truth) / (p.high - p.low) * 3.92)
    assert len(hits) == 5 - len(known)
    for name, count in hits.items():
        assert count >= 51, (name, count)
        assert 0.7 < np.std(scaled[name]) < 1.35, name
        assert abs(np.mean(scaled[name])) < 0.6, name


def test_large_errors_of_sinkage_do_not_bias(tmp_path):
    """Errors in variables: at 10 % noise of the sinkage the mean of 40 estimates is within half an sd."""
    sd = {"sinkage": 1.5e-3, "drawbar_pull": 2.0, "torque": 0.3}
    rng, setup = np.random.default_rng(6), setup_of(("cohesion", "sinkage_exponent"), sd)
    found = [identify_table(table_of(tmp_path, clean(), rng, sd), setup).parameters for _ in range(40)]
    for name, truth in zip(NAMES, SAND, strict=True):
        if not found[0][name].known:
            values = np.array([p[name].value for p in found])
            assert abs(np.mean(values) - truth) < 0.5 * np.std(values), name


def test_estimates_the_noise_that_is_left_out(tmp_path):
    rng, setup = np.random.default_rng(7), setup_of(("cohesion",), None)
    noise = [
        {name: fit.noise for name, fit in identify_table(table_of(tmp_path, clean(), rng), setup).fits.items()}
        for _ in range(20)
    ]
    for name, truth in SD.items():
        assert np.mean([n[name] for n in noise]) == pytest.approx(truth, rel=0.1), name


def test_wheels_of_two_widths_share_k_c_and_k_phi(tmp_path):
    wide = SetupWheel(0.15, 0.2)
    k_c, k_phi = 2e4, 7e5
    parts = []
    for wheel in (WHEEL, wide):
        soil = SAND._replace(sinkage_coefficient=k_c / wheel.width + k_phi)
        rows = clean(soil, slips=(0.1, 0.3, 0.5), loads=(80.0, 160.0), wheel=wheel)
        parts.append(np.column_stack([rows, np.full(len(rows), wheel.width)]))
    path = tmp_path / "data.csv"
    header = "slip,load,sinkage,drawbar_pull,torque,wheel_width"
    np.savetxt(path, np.concatenate(parts), delimiter=",", header=header, comments="", fmt="%.7g")
    priors = {"k_c": Prior(k_c, 0.0), "k_phi": Prior(k_phi, 2e5)}
    e = identify_table(read_table(path), setup_of(("cohesion", "sinkage_exponent"), **priors))
    assert e.parameters["sinkage_coefficient"].value == pytest.approx(k_c / 0.12 + k_phi, rel=5e-3)
    assert e.parameters["friction_angle_deg"].value == pytest.approx(31.0, rel=5e-3)


# --- what the data cannot tell ----------------------------------------------------------------------------------------


def test_names_what_the_data_cannot_tell(tmp_path):
    """One load and no torque: cohesion cannot be told from friction, and a prior stays what it was."""
    rows = clean()[:8]
    table = table_of(tmp_path, rows, np.random.default_rng(1), leave_out=("torque",))
    e = identify_table(table, setup_of((), sinkage_exponent=Prior(0.9, 0.02)))
    words = " ".join(e.warnings)
    assert "cannot tell the sinkage exponent" in words
    assert "friction angle and cohesion together" in words or "cannot tell the cohesion" in words
    p = e.parameters["sinkage_exponent"]
    assert p.told > 0.7 and p.high - p.low == pytest.approx(2 * 1.96 * 0.02, rel=0.3)
    assert e.condition > identify_table(table_of(tmp_path, clean()), setup_of()).condition


def test_says_that_the_model_does_not_fit(tmp_path):
    rows = clean().copy()
    rows[:, 2] *= 1.0 + 0.8 * rows[:, 0]  # a slip-sinkage that the base model lacks
    e = identify_table(table_of(tmp_path, rows), setup_of(("cohesion", "sinkage_exponent")))
    assert any("does not fit the sinkage" in w for w in e.warnings) and e.converged
    e = identify_table(table_of(tmp_path, rows), setup_of(("cohesion", "sinkage_exponent"), None))
    assert any("follow slip and load" in w for w in e.warnings)


def test_says_that_a_prior_is_contradicted(tmp_path):
    prior = {"friction_angle_deg": Prior(38.0, 1.0)}
    e = identify_table(table_of(tmp_path, clean(), np.random.default_rng(2)), setup_of(("cohesion",), **prior))
    assert any("friction angle came out" in w and "deviations from its prior" in w for w in e.warnings)


def test_says_what_it_takes_for_granted(tmp_path):
    path = tmp_path / "data.csv"
    lines = ["slip,load,sinkage,drawbar_pull,pass,grade_deg,grouser_height,wheel_width"]
    for k, row in enumerate(clean()[:8]):
        sinkage = "" if k == 0 else f"{row[2]:.6g}"
        grade = 2 if k == 3 else ""
        lines.append(f"{row[0]},{row[1]},{sinkage},{row[3]:.6g},{1 + k % 2},{grade},0.005,{0.12 + k / 1e3}")
    path.write_text("\n".join(lines))
    words = " ".join(identify_table(read_table(path), setup_of(("cohesion", "sinkage_exponent"))).warnings)
    for word in ("pass > 1", "grade", "grousers", "several widths", "1 of 8 rows have no sinkage"):
        assert word in words


@pytest.mark.parametrize(
    "leave_out, rows, setup, words",
    [
        (("sinkage",), slice(None), setup_of(), "missing column 'sinkage'"),
        ((), slice(None), setup_of(NAMES), "every soil parameter is known"),
        (("torque",), slice(0, 2), setup_of(), "4 measured values .* 5 parameters: expected at least 5"),
        (("torque",), slice(0, 2), setup_of(("cohesion",), None), "4 parameters .*sinkage noise .* at least 6"),
    ],
)
def test_refuses_what_it_cannot_identify(tmp_path, leave_out, rows, setup, words):
    with pytest.raises(ParameterError, match=words):
        identify_table(table_of(tmp_path, clean()[rows], leave_out=leave_out), setup)


def test_refuses_a_wheel_above_the_ground(tmp_path):
    rows = clean().copy()
    rows[3, 2] = -0.001
    with pytest.raises(ParameterError, match="row 5, sinkage = -0.001: expected metres in"):
        identify_table(table_of(tmp_path, rows), setup_of())


# --- command line -----------------------------------------------------------------------------------------------------


def test_example_is_what_its_setup_says(tmp_path):
    write_example(tmp_path / "again.csv")
    assert (tmp_path / "again.csv").read_bytes() == (EXAMPLE / "single_wheel.csv").read_bytes()
    e = identify_table(read_table(EXAMPLE / "single_wheel.csv"), read_setup(EXAMPLE / "setup.yaml"))
    for name, truth in zip(NAMES, SAND, strict=True):
        p = e.parameters[name]
        assert p.low <= truth <= p.high, name


def test_command_line(tmp_path):
    command = [sys.executable, "-m", "soil_env.identification", str(EXAMPLE / "single_wheel.csv")]
    command += ["--setup", str(EXAMPLE / "setup.yaml"), "--out", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=EXAMPLE.parent.parent)
    assert done.returncode == 0, done.stderr
    for word in ("friction angle", "95 % interval", "Correlation", "drawbar pull", "identification.png"):
        assert word in done.stdout
    assert "\x1b" not in done.stdout and done.stderr == ""
    report = json.loads((tmp_path / "out" / "identification.json").read_text())
    assert set(report["parameters"]) == {*NAMES, "reference_pressure"} and len(report["slip"]) == 18
    assert (tmp_path / "out" / "identification.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert len(list((tmp_path / "out").iterdir())) == 2


def test_command_line_refuses_in_one_line(tmp_path, capsys):
    (tmp_path / "data.csv").write_text("slip,load,sinkage\n0.1,100,30\n")
    out = tmp_path / "out"
    assert main([str(tmp_path / "data.csv"), "--setup", str(EXAMPLE / "setup.yaml"), "--out", str(out)]) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1 and "row 2, sinkage = 30" in said.err and not out.exists()
    file = str(tmp_path / "data.csv")
    assert main([str(EXAMPLE / "single_wheel.csv"), "--setup", str(EXAMPLE / "setup.yaml"), "--out", file]) == 2
    assert "expected a folder" in capsys.readouterr().err
    with pytest.raises(SystemExit) as ended:
        main(["--help"])
    assert ended.value.code == 0 and "slip,load,sinkage" in capsys.readouterr().out
