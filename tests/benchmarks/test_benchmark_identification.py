"""benchmarks/identification.py --smoke: every part gives numbers, and the page is written."""

import json

from benchmarks import identification


def test_smoke_run(tmp_path):
    assert identification.main(["--smoke", "--out", str(tmp_path)]) == 0
    result = json.loads((tmp_path / "identification.json").read_text())
    for part in ("convergence", "efficiency", "identifiability", "online", "speed"):
        assert result[part]
    assert (tmp_path / "identification.md").read_text().startswith("# ")
