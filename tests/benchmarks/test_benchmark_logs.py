"""The benchmark of the logs on a small bag."""

import re

import pytest

from benchmarks.logs import main

pytest.importorskip("mcap")
pytest.importorskip("rosbags")


def test_a_small_bag(importable, capsys):
    assert main(["--gigabytes", "0.01"]) == 0
    said = capsys.readouterr().out
    for method in ("filter", "window"):
        assert re.search(rf"update, {method}, 7 rounds of 2000: median \d+\.\d \(", said)
    assert re.search(r"^0\.01 GB +260 +11 ", said, re.MULTILINE)  # one second, ten images in it
