"""Rigs: a wheel of the model itself is predicted to its noise; the measured ones give every row."""

import itertools
import math
from functools import partial

import numpy as np
import pytest

from benchmarks import rigs
from benchmarks.common import read_json
from soil_env.cli.running import run
from soil_env.parameters import soils
from tests.refusals import refused

measured = pytest.mark.skipif(not rigs.DATA.is_dir(), reason=f"no measured data in {rigs.DATA}")


def own_rig(law: rigs.Law = rigs.Law()) -> rigs.Rig:  # noqa: B008 (a tuple)
    """Rig of six slips under 60 N whose measurements are predictions of the model with `law`."""
    slip = np.array([-0.5, -0.2, 0.0, 0.2, 0.4, 0.7])
    rig = rigs.Rig(0.12, 0.1, 0.0, False, slip, np.full(6, 60.0), np.empty((6, 3)))
    # The unknowns of `rigs.soil_of`.
    truth = np.array([34.0, math.log(0.12), 8.5, 1.1, 1.2, 0.0, 0.0])
    rig.measured[:] = rigs.predict(truth, rig, np.arange(6), law)
    return rig


def test_a_wheel_of_the_model_is_predicted():
    rows = rigs.figures("own", own_rig(), rigs.Law(), starts=2, folds=None)
    fitted = ("driving rows", "rows of other slips")
    expected = [*itertools.product(fitted, ("driving", "braked"))]
    assert [(r["fitted"], r["predicted"]) for r in rows] == expected
    for r in rows:
        assert r["pull_share_of_load"] < 0.01 and r["sinkage_mm"] < 1.0


def test_the_law_of_a_wheel_is_chosen():
    law = rigs.Law(0.08, rigs.PEAK, 1.0)
    found = rigs.choose([own_rig(law)], 1, (0.0, 1.0))
    assert found.shear_growth == 1.0 and abs(found.rim_flow - 0.08) < 0.005


def test_a_missing_folder_is_one_line(tmp_path):
    asked = partial(rigs.read_rigs, tmp_path)
    refused(asked, "cmu_wheel_means_of_3.csv: no such file: ", " --data")


@measured
def test_every_rig_has_its_rows(tmp_path):
    assert run(rigs.command, ["--smoke", "--out", str(tmp_path)], "rigs") == 0
    found = read_json(tmp_path / "rigs.json")
    rows = found["rows"]
    laws = {"Eq. (10)", "flow, continuum", "flow, CMU", "flow, presets"}
    assert {r["law"] for r in rows} == laws
    computed = {"CMU smooth", "CMU lugged", "continuum", "particles"}
    of_papers = {"ding_lugged", "ding_smooth", "kls1_lugged", "kls1_smooth", "rashid_lugged"}
    assert {r["rig"] for r in rows} == computed | of_papers
    assert all(0.0 < r["sinkage_mm"] < 50.0 for r in rows)
    assert (tmp_path / "rigs.md").exists()
    assert [r["wheel"] for r in found["moduli"]] == [w for w in rigs.DING for _ in range(2)]


def test_the_modulus_of_a_shear_test_is_found_from_the_drive():
    """9.7 to 13.1 mm by shear tests (Ding et al. 2011); with soil that flows, from both wheels."""
    preset = soils()["dry_sand"]
    flow = rigs.Law(preset.rim_flow, preset.braked_peak, preset.shear_growth)
    for found in rigs.moduli({"flow": flow}):
        assert 9.7 < found["K_mm"] < 13.1 and found["low"] < 9.7 < 13.1 < found["high"]
