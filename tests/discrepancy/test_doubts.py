"""Rows that stand alone in their conditions and decide what is named are reported."""

import pytest

from soil_env.discrepancy import doubts
from soil_env.discrepancy.calibrate import calibrate
from soil_env.discrepancy.search import search
from tests.discrepancy.files import PLANTED, data_of, table_text

LOADS = (100, 120, 150, 180, 220)


def said(folder, text):
    problem, noise = calibrate(data_of(folder, text))
    return doubts.of_lone_rows(problem, noise, search(problem), lambda text: None), noise


def with_slip(text: str, line: int, slip: str) -> str:
    """The table with another slip in a line of the file; the second column is slip."""
    lines = text.splitlines()
    cells = lines[line - 1].split(",")
    lines[line - 1] = ",".join([cells[0], slip, *cells[2:]])
    return "\n".join(lines) + "\n"


@pytest.mark.parametrize("effects", [{}, PLANTED])
def test_a_table_whose_rows_check_each_other_raises_no_doubt(tmp_path, effects):
    found, noise = said(tmp_path, table_text(effects, LOADS))
    assert found == () and not noise.alone.any()


def test_a_mistyped_slip_that_decides_is_told(tmp_path):
    found, noise = said(tmp_path, with_slip(table_text(PLANTED, LOADS), 5, "1.0"))
    assert noise.alone.tolist().count(True) == 1 and noise.alone[3]
    (doubt,) = found
    assert (
        doubt.startswith("Line 5 (slip 1, load 100 N) stands alone")
        and "without it that is slip-sinkage." in doubt
    )
