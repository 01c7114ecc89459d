"""Measurement tables and setups: what is read, and the message for each thing that cannot be
right.
"""

import math

import numpy as np
import pytest

from soil_env._io.loading import ParameterError
from soil_env.measurement.setup import (
    NoiseLevels,
    Prior,
    Setup,
    SetupWheel,
    SoilPriors,
    read_setup,
)
from soil_env.measurement.table import look_like_radians, read_table
from tests.refusals import refused

HEADER = "slip,load,sinkage,drawbar_pull"
GOOD = (HEADER, "0.1,100,0.02,5", "0.2,100,0.021,9", "0.3,120,0.022,12.5")
SETUP = "wheel: {radius: 0.15, width: 0.12}\n"


def written(tmp_path, *lines, name="data.csv", encoding="utf-8"):
    """Path of a file `name` in `tmp_path` with these lines."""
    path = tmp_path / name
    path.write_bytes("\n".join(lines).encode(encoding))
    return path


def refusal(read, *arguments, parts=()):
    """Return the one-line message with which a reader refuses; it holds all `parts`."""
    return refused(lambda: read(*arguments), *parts)


def test_reads_a_full_table(tmp_path):
    path = written(
        tmp_path,
        "\ufeffrun, slip "
        ",load,speed,pass,grade_deg,time,wheel_radius,wheel_width,grouser_height,sinkage,torque",
        "a b,-1,100,0.1,2,-8.5,0,0.2,,0.01,0.02,1e1",
        "",
        '"x, y",1,1e2,,,,,,,,,-4',
    )
    t = read_table(path)
    wheel = SetupWheel(0.15, 0.12)
    nan = math.nan
    for found, expected in (
        (t.row, [2, 4]),
        (t.passes, [2, 1]),
        (t.slip, [-1.0, 1.0]),
        (t.speed, [0.1, nan]),
        (t.grade_deg, [-8.5, nan]),
        (t.sinkage, [0.02, nan]),
        (t.drawbar_pull, [nan, nan]),
        (t.torque, [10.0, -4.0]),
        (t.radius(wheel), [0.2, 0.15]),
        (t.width(wheel), [0.12, 0.12]),
    ):
        np.testing.assert_array_equal(found, expected)
    assert list(t.run) == ["a b", "x, y"]
    with pytest.raises(ValueError, match="read-only"):
        t.slip[0] = 0.0


def test_a_sinkage_beyond_the_radius_is_a_wrong_cell_or_a_wrong_unit(tmp_path):
    """The wheel has a radius of 0.15 m; of three sinkages one is beyond it, or all are."""
    for deep, words in (
        (["0.03", "0.31", "0.029"], "row 3, sinkage = 0.31: .* (it is 11 times the others)"),
        (["0.3", "0.31", "0.29"], "row 2, sinkage = 0.3: .* (if it is millimetres, .*)"),
    ):
        rows = [f"0.{k + 1},100,{z},5" for k, z in enumerate(deep)]
        (tmp_path / "data.csv").write_text("\n".join([HEADER, *rows]) + "\n")
        with pytest.raises(ParameterError, match=words.replace("(", r"\(").replace(")", r"\)")):
            read_table(tmp_path / "data.csv", SetupWheel(0.15, 0.12))


def test_a_table_with_a_date_and_rows_without_a_value(tmp_path):
    """As a spreadsheet in German writes it: neither date nor run is a number, and rows that say
    nothing may be alike.
    """
    lines = ("date;run;slip;load;torque", "12.03.2024;1,5;0,1;100;2,5", "1.2;2.5;0,2;100;3")
    (tmp_path / "data.csv").write_text("\n".join([*lines, ";;0,3;90;", ";;0,3;90;"]) + "\n")
    t = read_table(tmp_path / "data.csv", SetupWheel(0.15, 0.12), ("date",))
    assert list(t.slip) == [0.1, 0.2] and list(t.torque) == [2.5, 3.0]
    assert list(t.run) == ["1,5", "2.5"]
    rows = ("0,1;100;2,5;21.03.2026", "0,2;100;3;22.03.2026")
    note = written(
        tmp_path, "slip,load,torque,note", "0.1,100,2,nan", "0.1,100.0,2,nan", "0.2,100,3,"
    )
    refused = refusal(read_table, note, SetupWheel(0.15, 0.12), ("note",))
    assert "row 3 repeats row 2 in every column" in refused
    named_as_ours = written(tmp_path, "slip;load;torque;time", *rows)
    assert list(read_table(named_as_ours, SetupWheel(0.15, 0.12), ("time",)).torque) == [2.5, 3.0]


@pytest.mark.parametrize(
    "lines, words",
    [
        (["slip,sinkage", "0.1,0.02"], ["missing column 'load'"]),
        (
            ["slip;load;torque", "0,1;100;2,5", "0,2;1.000;3"],
            ["row 3, '1.000' has a point, row 2, '0,1' a comma", "one decimal mark"],
        ),
        (["slip;load;torque", "0,1;1,234,500;2"], ["load = '1,234,500'"]),
        (["slip;load;torque", "0,1;n,a;2"], ["load = 'n,a'"]),
        (
            ["slip,load,torque", '0.1,"1,000",2', '0.2,"1,000",3'],
            ["row 2, load = '1,000'", "without separators of thousands"],
        ),
        (["slip,load,torque", "0.1,1 000,2"], ["'1 000'", "without separators of thousands"]),
        (["slip,load,torque,", "0.1,100,2,7"], ["column 4 has no name"]),
        ([HEADER, "0.1,100,0.02,5", "1.5,100,0.02,6"], ["slip = 1.5", "(r w - V)/V"]),
        (
            [HEADER, "0.1,100,0.02,5", "-1.5,100,0.02,-6"],
            ["slip = -1.5", "(r w - V)/(r w) where the wheel is braked"],
        ),
        (["slip,load,torque", '"0,1",100,2'], ["slip = '0,1'", "with a decimal point"]),
        (["slip,load,torque", "0.1,1_0,2"], ["row 2, load = '1_0'", "a finite number in N"]),
        (["slip,load,torque", "0.1,\u0661,2"], ["row 2, load = ", "a finite number in N"]),
        (
            [HEADER, "0.1,100,deep,5"],
            ["row 2", "sinkage = 'deep'", "expected a finite number in m ("],
        ),
        (
            [HEADER, "-,N,m,N", *GOOD[1:]],
            ["row 2 has no number, slip = '-'", "a row of units begins with #"],
        ),
        ([HEADER, GOOD[1], "0.1,nan,0.02,5"], ["row 3", "load = 'nan'", "finite number in N ("]),
        ([HEADER, ",100,0.02,5"], ["row 2", "slip is empty"]),
        ([HEADER, "10,100,0.02,5", "20,100,0.02,6"], ["row 2", "slip = 10", "[-1, 1]", "percent"]),
        ([HEADER, "0.1,100,20,5"], ["row 2", "sinkage = 20", "can only be millimetres"]),
        ([HEADER + ",pass", "0.1,100,0.02,5,1.5"], ["row 2", "pass = 1.5", "whole number"]),
        (
            [HEADER, GOOD[1], "0.2,1e300,0.02,5"],
            ["row 3, load = 1e300: expected newtons, at most 1e+06\n"],
        ),
        ([HEADER + ",grade_deg", "0.1,100,0.02,5,75"], ["row 2", "grade_deg = 75", "[-60, 60]"]),
        (
            [HEADER + ",grade_deg", "0.1,100,0.02,5,-0.0873", "0.2,100,0.02,5,0.1745"],
            ["row 2", "radians", "57.3"],
        ),
        (
            [HEADER + ",wheel_radius", "0.1,100,0.2,5,0.15"],
            ["row 2", "sinkage = 0.2", "wheel radius 0.15 m"],
        ),
        (
            [HEADER + ",wheel_radius,sinkage_sd", "0.1,100,0.02,5,0.15,0.5"],
            ["row 2, sinkage_sd = 0.5", "if it is millimetres, divide by 1000"],
        ),
        ([*GOOD, "0.10,100,0.02,5"], ["row 5 repeats row 2"]),
        ([HEADER, "0.1,100,0.02,5", "0.1,120,0.02,6"], ["slip = 0.1 in every row"]),
        ([HEADER, "0.1,100,0.02"], ["row 2 has 3 cells: expected 4"]),
        ([HEADER, "0.1"], ["row 2 has 1 cell: expected 4"]),
        (["Wheel test,,,", "", *GOOD], ["the header stands below the line 'Wheel test'"]),
        (
            ["Tests; June", *(line.replace(",", ";") for line in GOOD)],
            ["the header stands below the line 'Tests June'"],
        ),
        (["# " + GOOD[0], *GOOD[1:]], ["the first line has numbers", "without # before it"]),
        (
            [HEADER + ",torqe_sd", GOOD[1] + ",1"],
            ["unknown column 'torqe_sd'; did you mean 'torque_sd'?", "ignore_"],
        ),
        (
            [HEADER + ",torqe,note", GOOD[1] + ",1,2"],
            ["unknown columns 'torqe'; did you mean 'torque'?, 'note' (known"],
        ),
    ],
)
@pytest.mark.filterwarnings("error")
def test_refuses_a_bad_table(tmp_path, lines, words):
    """`words`: parts of the message; the last may end in a line break, the end of the message."""
    message = refusal(read_table, written(tmp_path, *lines), parts=["data.csv", *words[:-1]])
    assert words[-1] in message + "\n"


@pytest.mark.parametrize(
    ("name", "column", "also"),
    [
        ("pull", "drawbar_pull", "N"),
        ("Pull [kN]", "drawbar_pull", "N at"),
        ("fx", "drawbar_pull", "N"),
        ("dp", "drawbar_pull", "N"),
        ("thrust", "drawbar_pull", "less resistance"),
        ("force", "drawbar_pull", "N at"),
        ("fz", "load", "N"),
        ("Normal_Load", "load", "N"),
        ("load_kg", "load", "9.81"),
        ("w", "load", "'speed'"),
        ("mass", "load", "9.81"),
        ("sinkage_mm", "sinkage", "(m below"),
        ("Sinkage (mm)", "sinkage", "(m below"),
        ("depth", "sinkage", "m below"),
        ("slip_ratio", "slip", "1 - V/(r w)"),
        ("slip_pct", "slip", "a share"),
        ("i", "slip", "1 - V/(r w)"),
        ("omega", "speed", "rim is in the slip"),
        ("v", "speed", "m/s"),
        ("mx", "torque", "axle"),
        ("F_z", "load", "on the wheel"),
        ("My [N m]", "torque", "axle"),
        ("moment", "torque", "N m"),
        ("slope", "grade_deg", "degrees"),
        ("diameter", "wheel_radius", "half"),
    ],
)
def test_a_usual_name_of_a_column_gets_a_hint_to_the_known_one(tmp_path, name, column, also):
    """With what that column holds; no hint where the table has it already."""
    others = [c for c in ("slip", "load", "sinkage", "run") if c != column]
    header = [*others, name]
    row = ",".join("1" * len(header))
    said = refusal(read_table, written(tmp_path, ",".join(header), row)).partition(" (known: ")[0]
    assert "did you mean" in said and f"'{column}'" in said and also in said
    given = written(tmp_path, f"slip,load,{column},{name}", "1,1,1,1")
    assert f"did you mean '{column}'" not in refusal(read_table, given)


def test_refuses_other_files(tmp_path):
    assert "cannot be read" in refusal(read_table, tmp_path / "absent.csv")
    assert "cannot be read" in refusal(read_table, tmp_path)
    assert "save as CSV UTF-8" in refusal(
        read_table, written(tmp_path, "slip,load,sinkage,\u00e9", encoding="latin-1")
    )
    binary = written(tmp_path, "PAR1\xff", name="data.parquet", encoding="latin-1")
    assert "expected a CSV file" in refusal(read_table, binary)


def test_sinkage_and_lugs_are_held_against_the_wheel_of_the_setup(tmp_path):
    path = written(tmp_path, HEADER, "0.1,100,0.2,5", "0.2,100,0.1,5")
    assert len(read_table(path)) == 2
    assert "sinkage = 0.2" in refusal(read_table, path, SetupWheel(0.15, 0.12))
    lugs = written(tmp_path, HEADER + ",grouser_height", "0.1,100,0.02,5,0.12", "0.2,100,0.02,5,")
    assert "row 2, grouser_height = 0.12: " in refusal(read_table, lugs, SetupWheel(0.1, 0.1))
    radii = written(tmp_path, HEADER + ",wheel_radius", "0.1,100,0.02,5,", "0.2,100,0.02,5,0.1")
    assert "row 3, wheel_radius = 0.1: " in refusal(read_table, radii, SetupWheel(0.3, 0.1, 0.12))


def test_grades_that_are_degrees_stay_degrees(tmp_path):
    """Grades with fewer digits than 3, one that is too steep in radians, and a single steepness:
    0.6458 is 37 deg in radians, and so may be chance.
    """
    for grades in (
        ("0", "0.75"),
        ("0.5", "-0.31"),
        ("0.1745", "12"),
        ("", "0.5"),
        ("-0.6458", "0.6458"),
    ):
        rows = [f"0.{k + 1},100,0.02,5,{g}" for k, g in enumerate(grades)]
        read_table(written(tmp_path, HEADER + ",grade_deg", *rows))


def test_grades_without_a_number_are_no_radians():
    """A table that identification has thinned has NaN in its text."""
    assert look_like_radians(["0.0873", "-0.1745"]) and not look_like_radians(["0.0873", "nan"])


@pytest.mark.parametrize("kind", [float, np.float32])
def test_grades_in_radians_of_full_precision_look_like_it(kind):
    for degrees in range(1, 31):
        assert look_like_radians([repr(float(kind(degrees * math.pi / 180.0)))]), degrees
        assert not look_like_radians([repr(float(kind((degrees + 0.01) * math.pi / 180.0)))])


def test_reads_a_setup(tmp_path):
    """All that it may say, the numbers that look like another unit, and what is left out."""
    s = read_setup(
        written(
            tmp_path,
            "wheel: {radius: 0.1, width: 0.1, grouser_height: 0.01, grouser_count: 18}",
            "slip_reference: tip\n"
            "load: vertical\n"
            "tilt_deg: {value: 0, sd: 1}\n"
            "ignore_columns: [note, x]",
            "soil: {friction_angle_deg: {value: 30, sd: 1.5}, cohesion: 3700, k_c: 1000, k_phi: "
            "{value: 7e5, sd: 8e4}}",
            "noise: {sinkage: 0.001}",
        )
    )
    priors = {"friction_angle_deg": Prior(30.0, 1.5), "cohesion": Prior(3700.0, 0.0)}
    priors |= {"k_c": Prior(1000.0, 0.0), "k_phi": Prior(7e5, 8e4)}
    assert s == Setup(
        SetupWheel(0.1, 0.1, 0.01, 18),
        SoilPriors(**priors),
        NoiseLevels(sinkage=0.001),
        load="vertical",
        slip_reference="tip",
        tilt_deg=Prior(0.0, 1.0),
        ignore_columns=("note", "x"),
    )
    assert s.soil.cohesion.known and not s.soil.friction_angle_deg.known
    assert s.soil.lumped(0.1) == Prior(1e4 + 7e5, 8e4)
    other_units = (
        "soil: {friction_angle_deg: 0.52, cohesion: 1.5, sinkage_coefficient: {value: 900, sd: 90}}"
    )
    words = read_setup(written(tmp_path, SETUP + other_units)).doubts()
    for word, part in zip(
        words, ("0.52 deg looks like radians", "1.5 Pa looks like kPa", "kN/m^(n+2)"), strict=True
    ):
        assert part in word
    weak = "soil: {friction_angle_deg: {value: 1.2, sd: 3}}"  # 69 deg if these were radians
    assert not read_setup(written(tmp_path, SETUP + weak)).doubts()
    usual = "soil: {friction_angle_deg: 6, cohesion: 0, k_c: 770, k_phi: 43120}"
    assert read_setup(written(tmp_path, SETUP + usual)).doubts() == []
    s = read_setup(written(tmp_path, SETUP + "soil:\nnoise:\ntilt_deg: -1.5\n"))
    assert s == Setup(SetupWheel(0.15, 0.12), tilt_deg=Prior(-1.5, 0.0))
    assert s.soil.lumped(0.1) is None


@pytest.mark.parametrize(
    "text, words",
    [
        ("nois: {}", ["unknown key 'nois'", "'noise'"]),  # before the wheel, which is missing too
        (SETUP + "rig: {loads: []}", ["rig.loads = []: expected at least one value"]),
        ("wheel: {radius: 150, width: 0.12}", ["radius = 150", "[0.01, 3] m"]),
        (SETUP + "noise: {sinkage: 0}", ["sinkage = 0", "> 0 m"]),
        (SETUP + "noise: {slip: 2}", ["noise: slip = 2", "if it is percent, divide by 100"]),
        (SETUP + "soil: {cohesion: {value: 10, sd: 0}}", ["cohesion: sd = 0", "plain number"]),
        (
            SETUP + "soil: {cohesion: much}",
            ["soil.cohesion = 'much': expected a number or {value: ..., sd: ...}"],
        ),
        (SETUP + "soil: {k_c: 1000}", ["both k_c and k_phi"]),
        (
            SETUP + "soil: {k_c: 1, k_phi: 1e5, sinkage_coefficient: 1e5}",
            ["either sinkage_coefficient"],
        ),
        ("wheel: {radius: 1", ["not valid YAML", "in line 1"]),
        ("soil: {}", ["missing wheel: expected wheel: {radius: ..., width: ...}"]),
        (
            SETUP + "soil: {cohesion: {value: 10, sd: 1e-300}}",
            ["sd = 1e-300", "at least 1e-05", "plain number"],
        ),
        (
            SETUP + "soil: {density: {value: 1600, sd: 100}}",
            ["density: expected a plain number; it is given"],
        ),
        (SETUP + "load: vertcal", ["load = 'vertcal'", "'normal', 'vertical'"]),
        (SETUP + "tilt_deg: 40", ["tilt_deg = 40", "[-20, 20]"]),
        (
            SETUP + "ignore_columns: [note, load]",
            ["ignore_columns: 'load'", "every table needs this one"],
        ),
        (
            "wheel: {radius: 0.1, width: 0.1, grouser_height: 0.2}",
            ["grouser_height = 0.2", "wheel radius 0.1 m"],
        ),
    ],
)
def test_refuses_a_bad_setup(tmp_path, text, words):
    path = written(tmp_path, text, name="setup.yaml")
    refusal(read_setup, path, parts=["setup.yaml", *words])


@pytest.mark.parametrize(
    "lines",
    [
        ["slip;load;torque", "0,1;100;2,5", "0,2;1e2;-3"],
        ["slip;load;torque", "0.1;100;2.5", "0.2;100;-3"],
        ["slip\tload\ttorque", "0,1\t100\t2,5", "0,2\t100\t-3"],
        ["sep=|", "slip|load|torque", "0,1|100|2,5", "0,2|100|-3"],
        ["slip,load,torque,,", "0.1,100,2.5,,", "0.2,100,-3,,", ",,,,"],
        ["slip,load,torque", "0.1,100,2.5,", "0.2,100,-3"],
        ["sep=;", "slip;load;torque", "0,1;100;2,5", "0,2;100;-3"],
        ["slip,load,torque", "0.1,100,2.5", "0.15,100,", "0.2,100,-3"],
    ],
    ids=[
        "european",
        "semicolons",
        "tabs",
        "bars",
        "trailing commas",
        "trailing commas of rows",
        "separator named",
        "a row without a value",
    ],
)
def test_reads_what_spreadsheets_write(tmp_path, lines):
    t = read_table(written(tmp_path, *lines))
    assert list(t.slip) == [0.1, 0.2] and list(t.load) == [100.0] * 2
    assert list(t.torque) == [2.5, -3.0]


def test_comments_and_ignored_columns_are_passed_over(tmp_path):
    lines = (
        '# rig 3, "wheel B", 5;6',
        HEADER + ",torque_sd,note,torque",
        "0.1,100,0.02,5,0.1,first,1",
        "  # the belt was tightened",
        "0.1,100,0.02,5,,again,1",
        "0.2,100,0.02,6,,,1.5",
    )
    path = written(tmp_path, *lines)
    assert "unknown column 'note'" in refusal(read_table, path)
    t = read_table(path, ignore=("note", "torque"))
    assert list(t.row) == [3, 5, 6] and np.all(np.isnan(t.torque))
    assert t.torque_sd[0] == 0.1 and np.isnan(t.torque_sd[1:]).all()
    path = written(tmp_path, *lines, "0.2,100,0.02,x,,,1")
    assert "row 7, drawbar_pull" in refusal(read_table, path, None, ("note",))


def test_slip_by_the_lug_tips_is_turned_into_slip_by_the_rim(tmp_path):
    """Speeds of an 18-lug wheel, r 0.1 m, h 0.01 m: V and w give both slips, driving and
    braking.
    """
    omega = 3.0
    travel = np.array([0.1, 0.25, 0.32, 0.4])

    def slip(r):
        """Slip [-] at the four travel speeds by the radius `r` [m]: driving, else braked."""
        return np.where(r * omega > travel, 1.0 - travel / (r * omega), r * omega / travel - 1.0)

    rows = [f"{float(i)!r},20,1" for i in slip(0.11)]
    table = read_table(written(tmp_path, "slip,load,torque", *rows))
    wheel = SetupWheel(0.1, 0.1, 0.01)
    assert table.rim_slip(Setup(wheel, slip_reference="tip")) == pytest.approx(slip(0.1), abs=1e-12)
    assert np.array_equal(table.rim_slip(Setup(wheel)), table.slip)
    assert "grouser_height" in refusal(
        table.rim_slip, Setup(SetupWheel(0.1, 0.1), slip_reference="tip")
    )


def test_a_file_that_is_too_large_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("soil_env.measurement.table.MOST_BYTES", 20)
    (tmp_path / "a.csv").write_text("slip,load,torque\n0.1,80,4\n")
    with pytest.raises(ParameterError, match=r"a\.csv: larger than .* soil-env logs"):
        read_table(tmp_path / "a.csv")
