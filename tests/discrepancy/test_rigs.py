"""Tables as rigs make them: two wheels in one table, noise of each row, slip by lug tips, rigs that are not level."""

import numpy as np
import pytest

from soil_env._io.loading import ParameterError
from soil_env.discrepancy.calibrate import calibrate
from soil_env.discrepancy.data import WHEEL, folds, prepare
from soil_env.discrepancy.experiment import conditions
from soil_env.discrepancy.locate import boxes
from soil_env.discrepancy.noise import smooth_basis
from soil_env.measurement.table import read_setup, read_table
from tests.discrepancy.files import NOISE, SETUP, SLIPS, world, write_files

LUGS = {"grousers": {"shear_share": 1.0}}


def two_wheels(effects=LUGS, sizes=((0.15, 0.0), (0.15, 0.02)), loads=(100, 150, 220), seed=0, **columns) -> str:
    """A table with noise of wheels of (radius, grouser height), on the same soil at the same slips and loads."""
    rng, lines = np.random.default_rng(seed), []
    for radius, height in sizes:
        for load in loads:
            at = {"slip": SLIPS, "load": load, "wheel_radius": radius, "grouser_height": height}
            values = np.stack(world(effects).predict(at)[:3], axis=1)
            values += rng.normal(size=values.shape) * list(NOISE.values())
            more = [str(x) for x in columns.values()]
            lines += [",".join([*map(repr, (i, load, radius, height, *map(float, v))), *more])
                      for i, v in zip(SLIPS, values, strict=True)]  # fmt: skip
    names = ("slip", "load", "wheel_radius", "grouser_height", "sinkage", "drawbar_pull", "torque", *columns)
    return "\n".join([",".join(names), *lines]) + "\n"


def data_of(folder, text, setup=SETUP):
    table, setup = write_files(folder, text, setup)
    setup = read_setup(setup)
    return prepare(read_table(table, setup.wheel, setup.ignore_columns), setup)


@pytest.mark.parametrize("seed", range(4))
def test_no_clean_value_of_two_wheels_is_struck_out(tmp_path, seed):
    """Lugs make two curves over slip: neither is noise, nor outliers of the other."""
    for setup in (SETUP, SETUP.split("noise:")[0]):
        problem, noise = calibrate(data_of(tmp_path, two_wheels(seed=seed), setup))
        assert noise.outliers == 0
        assert noise.sd == pytest.approx(list(NOISE.values()), rel=0.6)


def test_wheels_are_a_condition(tmp_path):
    data = data_of(tmp_path, two_wheels())
    assert list(data.varied) == ["slip", "load", "grouser_height"]
    assert [len(way) for way in folds(data)] == [6, 6]  # slips; loads with wheels
    assert data.cell.max() + 1 == 36
    problem = calibrate(data)[0]
    assert any(set(limit) == {"grouser_height"} for limit in boxes(problem).limits)
    grid = conditions(problem, ())
    wheels = np.unique(np.stack([grid.value[name] for name in WHEEL], axis=1), axis=0)
    assert np.array_equal(wheels, np.unique(data.rows.wheels, axis=0)) and "grouser_height" in grid.told


def test_sizes_that_change_together_are_one_condition(tmp_path):
    data = data_of(tmp_path, two_wheels(sizes=((0.15, 0.0), (0.1, 0.01))))
    assert list(data.varied) == ["slip", "load", "wheel_radius"]
    basis = smooth_basis(data)
    assert np.linalg.matrix_rank(basis) == basis.shape[1]
    three = data_of(tmp_path, two_wheels(sizes=((0.15, 0.0), (0.1, 0.01), (0.15, 0.01))))
    assert list(three.varied) == ["slip", "load", "wheel_radius", "grouser_height"]


def test_a_lug_height_that_is_missing_is_refused(tmp_path):
    lines = two_wheels().splitlines()
    lines[5] = lines[5].replace(",0.0,", ",,", 1)
    setup = SETUP.replace(", grouser_height: 0.01", "")
    with pytest.raises(ParameterError, match="row 6, grouser_height is empty: expected it in every row, or wheel.grou"):
        data_of(tmp_path, "\n".join(lines) + "\n", setup)


def test_the_noise_of_a_row_is_its_own(tmp_path):
    """One run ten times as noisy as the others: said so, its values weigh a hundredth and are no outliers."""
    rng = np.random.default_rng(3)
    lines = two_wheels(torque_sd=0.1).splitlines()
    for k in range(7, 13):
        cells = lines[k].split(",")
        cells[-2:] = [repr(float(cells[-2]) + rng.normal()), "1.0"]
        lines[k] = ",".join(cells)
    setup = SETUP.replace(", torque: 0.1", "")
    data = data_of(tmp_path, "\n".join(lines) + "\n", setup)
    problem, noise = calibrate(data)
    assert noise.outliers == 0 and noise.sd[2] == 0.1 and data.relative_sd[8, 2] == 10.0
    whitened = np.full(problem.used.shape, np.nan)
    whitened[problem.used] = problem.whiten(np.ones_like(data.y))
    assert whitened[8, 2] == pytest.approx(1.0) and whitened[0, 2] == pytest.approx(10.0)
