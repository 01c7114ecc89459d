"""The benchmark of the time step and of the quadrature runs and prints its tables."""

import re

from benchmarks import accuracy


def test_smoke_run_prints_every_table(capsys):
    assert accuracy.main(["--smoke"]) == 0
    step, halved, arcs = capsys.readouterr().out.split("\n\n")
    for table in (step, halved, arcs):
        header, rule, *rows = table.strip().splitlines()
        columns = header.count("|")
        assert rule.count("---") == columns - 1 and rows
        assert all(row.count("|") == columns and "nan" not in row for row in rows)
    courses = [int(number) for number in re.findall(r", (\d+) courses", step)]
    assert len(courses) == 8 and min(courses) > 0
