"""benchmarks.rover_slopes: rovers of publications on uniform slopes."""

import numpy as np
import pytest

from benchmarks import rover_rigs as rigs, rover_slopes as study
from benchmarks.rover_slopes_page import PARTS
from soil_env._io.loading import ParameterError, load, read_yaml
from soil_env.parameters import Soil

ROVERS = rigs.published()
PLACE = (0.5, 0.0, 0.5, 0.5, 0.5, 0.5)


@pytest.mark.parametrize("name", ["mgru3", "ex1"])
def test_slip_and_the_rear_wheels_load_rise_with_the_slope(name):
    of, slopes = ROVERS[name], [0.0, 4.0, 8.0, 12.0]
    soil = Soil(36.0, 200.0, 0.004, 1.0, sinkage_coefficient=1e7, dig_gain=1.0)
    d = rigs.Driven(*(a[0] for a in rigs.curves(of, None, [soil], slopes)))
    assert d.steady.all()
    assert abs(d.slip[0]) < 0.1
    assert np.all(np.diff(d.slip) > 0.005)
    assert np.all(np.diff(d.load[:, 0]) < 0.0) and np.all(np.diff(d.load[:, 1]) > 0.0)
    vehicle = rigs.Rig(of).scenario.vehicle
    normal = 0.5 * vehicle.mass * 9.81 * np.cos(np.radians(slopes))
    assert np.allclose(d.load.sum(axis=1), normal, rtol=2e-3)  # the body pitches a little as its wheels sink
    assert np.ptp(d.axle_slip, axis=1).max() < 0.02  # both axles turn at one speed


def test_too_steep_a_slope_is_slip_of_one_and_not_steady():
    of = ROVERS["mgru3"]
    rig = rigs.Rig(of)
    d = rig.drive([of.soil.soil(PLACE)], [40.0], 6.0)
    assert d.slip[0] > 0.95
    assert not d.steady[0]


def test_on_fresh_soil_the_rover_slips_as_wheels_with_its_loads():
    """Before the rear wheels come to the ruts nothing couples the axles but their loads."""
    of, slopes = ROVERS["mgru3"], [3.0, 8.0]
    soil = of.soil.soil(PLACE)
    d = rigs.Rig(of, None, 2).drive([soil] * 2, slopes, rigs.BETWEEN)
    alone = rigs.wheels_alone(of, soil, slopes, d.load)
    assert np.allclose(d.early, alone, atol=0.02)


def test_law_of_ex1_is_the_printed_one_cut_at_one():
    law = ROVERS["ex1"].law
    found = law.uncut(0.35, np.array([0.0, 9.0, 12.0, 15.0]))
    assert np.allclose(found, [0.034875, 0.2679, 0.4492, 0.6822], atol=2e-4)
    assert law.uncut(0.47, 18.0) > 1.1
    assert law.slip(0.47, np.array([18.0])) == 1.0


def test_soils_are_drawn_within_their_ranges():
    ranges = ROVERS["mgru3"].soil
    for place, side in (([0.0] * 6, 0), ([1.0] * 6, 1)):
        named = ranges.named(ranges.soil(place))
        assert all(value == pytest.approx(getattr(ranges, name)[side]) for name, value in named.items())


def test_pull_that_points_ask_for_is_the_tangent_of_the_slope():
    found = rigs.pulls_asked(np.array([0.0, 45.0]), np.array([0.1, 0.6]))
    assert found[1] == pytest.approx(0.0) and found[4] == pytest.approx(1.0)
    assert found[0] is None and found[-1] is None


def test_half_is_where_slip_first_passes_a_half():
    assert rigs.half([0.0, 10.0, 20.0], [0.1, 0.4, 0.6]) == pytest.approx(15.0)
    assert rigs.half([0.0, 10.0], [0.1, 0.4]) is None


@pytest.mark.parametrize(
    ("change", "expected"),
    [({"sped": 0.2}, "sped"), ({"fitted": ["2023"]}, "2023"), ({"speed": -1.0}, "speed = -1")],
)
def test_mistakes_in_the_data_are_named_in_one_line(change, expected):
    entry = read_yaml(rigs.DATA)["mgru3"] | change
    with pytest.raises(ParameterError, match=expected) as error:
        load(rigs.Published, entry, "rover_slopes.yaml: mgru3")
    assert "\n" not in str(error.value)


def test_wrong_options_end_with_one_line(tmp_path, capsys):
    with pytest.raises(SystemExit) as error:
        study.main(["--fast"])
    assert error.value.code == 2
    assert len(capsys.readouterr().err.splitlines()) == 1
    assert study.main(["--page", "--out", str(tmp_path)]) == 2
    assert len(capsys.readouterr().err.splitlines()) == 1


@pytest.mark.slow
@pytest.mark.benchmarks
def test_smoke_run_writes_page_figure_and_result(tmp_path):
    assert study.main(["--smoke", "--out", str(tmp_path)]) == 0
    page = (tmp_path / "rover_measured.md").read_text(encoding="utf-8")
    assert all(f"<!-- {part} -->\n|" in page or f"<!-- {part} -->\n-" in page or part == "made" for part in PARTS)
    assert "Bands of 3 drawn soils a rover" in page and "fits from 2 (MGRU3) and 2 (EX1) others" in page
    files = {path.name: path.read_bytes() for path in tmp_path.iterdir()}
    assert set(files) == {"rover_measured.md", "rover_measured.json", "rover_slopes.svg"}
    assert study.main(["--page", "--out", str(tmp_path)]) == 0
    assert {path.name: path.read_bytes() for path in tmp_path.iterdir()} == files
