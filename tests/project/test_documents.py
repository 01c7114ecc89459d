"""What README and docs state is what the committed results say."""

import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
COLUMNS = {  # heading in the README -> (metric, factor, digits)
    "immobilised [%]": ("immobilised", 100.0, 1),
    "out of time [%]": ("time_limit", 100.0, 1),
    "finished [%]": ("finished", 100.0, 1),
    "time [s]": ("time", 1.0, 0),
    "energy [J/m]": ("energy_per_metre", 1.0, 0),
    "slip": ("slip", 1.0, 2),
    "return": ("return", 1.0, 2),
}


def table(text):
    """{controller: {heading: cell}} of the comparison table of the README."""
    block = text.split("<!-- comparison -->")[1].split("<!-- end -->")[0]
    rows = [[c.strip() for c in line.strip("|\n ").split("|")] for line in block.splitlines() if line.startswith("|")]
    heading, body = rows[0], rows[2:]
    return {row[0].strip("`"): dict(zip(heading[1:], row[1:], strict=True)) for row in body}


def test_the_readme_s_table_is_the_committed_comparison():
    result = json.loads((ROOT / "docs" / "comparison.json").read_text())
    shown = table((ROOT / "README.md").read_text())
    assert list(shown) == list(result["controllers"])
    for name, cells in shown.items():
        assert list(cells) == list(COLUMNS)
        for heading, (metric, factor, digits) in COLUMNS.items():
            m = {key: factor * value for key, value in result["controllers"][name][metric].items()}
            expected = f"{m['value']:.{digits}f} [{m['low']:.{digits}f}, {m['high']:.{digits}f}]"
            assert cells[heading] == expected, (name, heading)


def test_the_files_the_readme_names_exist():
    text = (ROOT / "README.md").read_text()
    for link in re.findall(r"\]\(([^)#]+)\)", text):
        if not link.startswith("http"):
            assert (ROOT / link).exists(), link


def test_the_default_task_needs_traction_control():
    """The promise of the scenario, on the committed comparison of 1000 held-out courses."""
    result = json.loads((ROOT / "docs" / "comparison.json").read_text())
    stuck = {name: row["immobilised"] for name, row in result["controllers"].items()}
    assert result["courses"] >= 1000 and result["scenario"] == "mixed"
    assert 0.4 <= stuck["full_throttle"]["value"] <= 0.8
    assert 0.15 <= stuck["fixed_slip"]["value"] <= 0.45
    assert stuck["ppo_identified"]["high"] < stuck["fixed_slip"]["low"]


@pytest.mark.xfail(strict=True, reason="10.5 % on this set of courses: README.md")
def test_who_knows_the_soil_is_seldom_immobilised():
    """The last promise of the scenario: not met by the committed comparison, and said so."""
    result = json.loads((ROOT / "docs" / "comparison.json").read_text())
    assert result["controllers"]["best_slip_true"]["immobilised"]["value"] < 0.1


def test_the_benchmark_of_the_identification_runs(tmp_path):
    script = ROOT / "benchmarks" / "identification.py"
    command = [sys.executable, str(script), "--smoke", "--out", str(tmp_path)]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr[-2000:]
    page = (tmp_path / "identification.md").read_text()
    result = json.loads((tmp_path / "identification.json").read_text())
    for part in ("convergence", "efficiency", "identifiability", "online", "speed"):
        assert result[part]
    assert "--smoke" in page and page.count("\n## ") == 5


def test_the_page_of_the_ablation_is_the_committed_result():
    from agents.ablation import page
    from agents.ablation.study import read_config

    result = json.loads((ROOT / "docs" / "comparison" / "comparison.json").read_text())
    text = (ROOT / "docs" / "comparison.md").read_text()
    marked = text.split(page.BEGIN)[1].split(page.END)[0].strip()
    assert marked == page.block(read_config(ROOT / "configs" / "ablation.yaml"), result, "comparison/")
    assert result["courses"] >= 1000
    for scenario in result["scenarios"].values():
        seeds = {name: c["members"] for name, c in scenario["controllers"].items() if name in result["agents"]}
        assert set(seeds.values()) == {result["seeds"]}
    for link in re.findall(r"\]\(([^)#]+)\)", text):
        assert link.startswith("http") or (ROOT / "docs" / link).exists(), link
