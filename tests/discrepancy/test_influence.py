"""Rows that stand alone in their conditions and decide what is named."""

import pytest

from soil_env.discrepancy import influence
from soil_env.discrepancy.calibrate import calibrate
from soil_env.discrepancy.data import prepare
from soil_env.discrepancy.search import search
from soil_env.measurement.table import read_setup, read_table
from tests.discrepancy.files import PLANTED, table_text, write_files

LOADS = (100, 120, 150, 180, 220)


def said(folder, text):
    data, setup = write_files(folder, text)
    setup = read_setup(setup)
    problem, noise = calibrate(prepare(read_table(data, setup.wheel), setup))
    return influence.examine(problem, noise, search(problem), lambda text: None), noise


def with_slip(text: str, line: int, slip: str) -> str:
    """The table with another slip in a line of the file; the second column is slip."""
    lines = text.splitlines()
    cells = lines[line - 1].split(",")
    lines[line - 1] = ",".join([cells[0], slip, *cells[2:]])
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("effects", [{}, PLANTED])
def test_a_table_whose_rows_check_each_other_raises_no_doubt(tmp_path, effects):
    doubts, noise = said(tmp_path, table_text(effects, LOADS))
    assert doubts == () and not noise.alone.any()


def test_a_mistyped_slip_that_decides_is_told(tmp_path):
    doubts, noise = said(tmp_path, with_slip(table_text(PLANTED, LOADS), 5, "1.0"))
    assert noise.alone.tolist().count(True) == 1 and noise.alone[3]
    (doubt,) = doubts
    assert doubt.startswith("Line 5 (slip 1, load 100 N) stands alone") and "without it that is slip-sinkage." in doubt


def test_a_row_that_stands_alone_and_is_right_raises_no_doubt(tmp_path):
    """A run at a slip of its own, of the same wheel."""
    rows, alone = table_text(PLANTED, LOADS), table_text(PLANTED, (150,), (0.95,), seed=1).splitlines()[1]
    doubts, noise = said(tmp_path, rows + alone + "\n")
    assert noise.alone[-1] and doubts == ()
