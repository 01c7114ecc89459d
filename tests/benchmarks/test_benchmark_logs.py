"""The benchmark of the logs on a small bag and two courses."""

import re

import pytest

from benchmarks import log_grounds
from benchmarks.logs import LOGS, main

pytest.importorskip("mcap")
pytest.importorskip("rosbags")


def test_a_small_bag_and_a_table_of_calibration(importable, tmp_path):
    page = tmp_path / "page.md"
    page.write_text("<!-- calibration -->\n<!-- end -->\n<!-- bag -->\n<!-- end -->\n")
    assert main(["--gigabytes", "0.01", "--courses", "1", "--page", str(page)]) == 0
    said = page.read_text()
    assert all(said.count(f"| {name} |") == 1 for name in LOGS) and said.count("| ln K |") == len(LOGS)
    assert re.search(r"One update takes \d+\.\d \(", said)
    assert "A bag of 0.01 GB with 260 messages (11 steps)" in said  # one second, ten images in it


def test_the_grounds_of_one_course(importable, capsys):
    assert log_grounds.main(["--courses", "1"]) == 0
    said = capsys.readouterr().out
    assert re.search(r"^\d+ steady points on 1 courses; \d+ lie on the soil of their table", said)
    assert re.search(r"^of one ground +\d+ ", said, re.MULTILINE) and "that the filter saw" in said
