"""Rows that stand alone in their conditions and decide what is named are reported."""

from soil_env.discovery import doubts
from soil_env.discovery.calibrate import calibrate
from soil_env.discovery.search import search
from tests.discovery.files import PLANTED, data_of, table_text, with_column


def test_a_table_whose_rows_check_each_other_raises_no_doubt(planted, nothing):
    for report in (planted, nothing):
        assert report.doubts == () and not report.noise.alone.any()


def test_a_mistyped_slip_that_decides_is_told(tmp_path):
    text = with_column(
        table_text(PLANTED, (100, 120, 150, 180)),
        "slip",
        lambda row: 1.0 if row["load"] == 100.0 and row["slip"] == 0.3 else row["slip"],
    )
    problem, noise = calibrate(data_of(tmp_path, text))
    found = doubts.of_lone_rows(problem, noise, search(problem), lambda text: None)
    assert noise.alone.tolist().count(True) == 1 and noise.alone[3]
    (doubt,) = found
    assert (
        doubt.startswith("Row 5 (slip 1, load 100 N): no other row comes near its conditions.")
        and "without it that is slip-sinkage." in doubt
    )
