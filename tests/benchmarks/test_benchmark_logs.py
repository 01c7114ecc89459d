"""The benchmark of the logs on a small bag."""

import re

import pytest

from benchmarks import log_grounds
from benchmarks.logs import main

pytest.importorskip("mcap")
pytest.importorskip("rosbags")


def test_a_small_bag(importable, capsys):
    assert main(["--gigabytes", "0.01"]) == 0
    said = capsys.readouterr().out
    for method in ("filter", "window"):
        assert re.search(rf"update, {method}, 7 rounds of 2000: median \d+\.\d \(", said)
    assert re.search(r"^0\.01 GB +260 +11 ", said, re.MULTILINE)  # one second, ten images in it


def test_the_grounds_of_one_course(importable, capsys):
    assert log_grounds.main(["--courses", "1"]) == 0
    said = capsys.readouterr().out
    assert re.search(r"^\d+ steady points on 1 courses; \d+ lie on the soil of their table", said)
    assert re.search(r"^of one ground +1 ", said, re.MULTILINE) and "of all points" in said
