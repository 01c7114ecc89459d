"""Progress bars: remaining times of parts of different speed."""

import io

import pytest
from rich.console import Console

from soil_env_agents import progress


@pytest.fixture
def clock(monkeypatch):
    """Seconds, in a list, that a terminal's bars go by."""
    now = [0.0]
    terminal = Console(file=io.StringIO(), force_terminal=True, get_time=lambda: now[0])
    monkeypatch.setattr(progress, "console", terminal)
    return now


def test_each_part_has_its_own_remaining_time(clock):
    """Blocks take 10 s, of the oracle 1000 s; a resumed evaluation had half of the quick ones."""
    with progress.Bar("Driving", {"quick": 800, "oracle": 30}, "courses") as bar:
        left = {name: lambda row=row: bar.live.tasks[row] for name, row in bar.rows.items()}
        for _ in range(4):
            bar.found(100, "quick")
        assert left["quick"]().completed == 400
        for _ in range(2):
            assert left["quick"]().time_remaining is None
            clock[0] += 10.0
            bar.update(advance=100, part="quick")
        assert left["quick"]().time_remaining == pytest.approx(20.0)
        assert left["oracle"]().time_remaining is None
        for _ in range(2):
            clock[0] += 1000.0
            bar.update(advance=10, part="oracle")
        assert left["oracle"]().time_remaining == pytest.approx(1000.0)
        assert left["quick"]().time_remaining == pytest.approx(20.0)


def test_without_a_terminal_a_line_counts_all_parts(monkeypatch):
    out = io.StringIO()
    monkeypatch.setattr(progress, "console", Console(file=out, force_terminal=False))
    with progress.Bar("Driving", {"a": 50, "b": 50}, "courses") as bar:
        bar.found(40, "a")
        bar.update(advance=10, part="a")
        bar.update(advance=50, part="b")
    lines = out.getvalue().split("\n")
    assert [line.strip() for line in lines if line] == [
        "Driving: 50 of 100 courses",
        "Driving: 100 of 100 courses",
    ]
