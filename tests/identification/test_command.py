"""`python -m soil_env.identification` and `benchmarks/identification.py` as commands; the code of docs/identify.md."""

import io
import json
import re
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path

import pytest

from benchmarks import identification as benchmark
from soil_env._io.files import replace_files
from soil_env.identification.__main__ import main
from tests.identification.test_table import EXAMPLE, NAMES

ROOT = Path(__file__).resolve().parents[2]


def test_command_line(tmp_path):
    command = [sys.executable, "-m", "soil_env.identification", str(EXAMPLE / "single_wheel.csv")]
    command += ["--setup", str(EXAMPLE / "setup.yaml"), "--out", str(tmp_path / "out")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=EXAMPLE.parent.parent)
    assert done.returncode == 0, done.stderr
    for word in ("friction angle", "95 % interval", "Correlation", "drawbar pull", "identification.png"):
        assert word in done.stdout
    assert "\x1b" not in done.stdout and done.stderr == ""
    report = json.loads((tmp_path / "out" / "identification.json").read_text())
    assert set(report["parameters"]) == {*NAMES, "reference_pressure"} and len(report["slip"]) == 18
    assert (tmp_path / "out" / "identification.png").read_bytes()[:8] == b"\x89PNG\r\n\x1a\n"
    assert len(list((tmp_path / "out").iterdir())) == 2


def test_command_line_refuses_in_one_line(tmp_path, capsys):
    (tmp_path / "data.csv").write_text("slip,load,sinkage\n0.1,100,30\n")
    out = tmp_path / "out"
    assert main([str(tmp_path / "data.csv"), "--setup", str(EXAMPLE / "setup.yaml"), "--out", str(out)]) == 2
    said = capsys.readouterr()
    assert said.out == "" and said.err.count("\n") == 1 and "row 2, sinkage = 30" in said.err and not out.exists()
    file = str(tmp_path / "data.csv")
    assert main([str(EXAMPLE / "single_wheel.csv"), "--setup", str(EXAMPLE / "setup.yaml"), "--out", file]) == 2
    assert "expected a folder" in capsys.readouterr().err
    assert main([str(EXAMPLE / "single_wheel.csv"), "--setup", str(EXAMPLE / "setup.yaml"), "--out", ""]) == 2
    assert capsys.readouterr().err == "soil_env.identification: --out is empty: expected a folder\n"
    with pytest.raises(SystemExit) as ended:
        main(["--help"])
    assert ended.value.code == 0 and "slip,load,sinkage" in capsys.readouterr().out


@pytest.mark.parametrize("blocked", ["identification.json", "identification.png"])
def test_writes_both_files_or_none(tmp_path, capsys, blocked):
    (tmp_path / blocked).mkdir()
    assert (
        main([str(EXAMPLE / "single_wheel.csv"), "--setup", str(EXAMPLE / "setup.yaml"), "--out", str(tmp_path)]) == 2
    )
    assert f"{blocked}: is a folder" in capsys.readouterr().err
    assert [p.name for p in tmp_path.iterdir()] == [blocked]
    (tmp_path / "old").write_text("old")
    with pytest.raises(OSError, match="no.folder"):
        replace_files(tmp_path, {"old": b"new", "no/folder": b""})
    assert (tmp_path / "old").read_text() == "old" and len(list(tmp_path.iterdir())) == 2


def test_says_what_is_taken_as_exact(capsys):
    assert main([str(EXAMPLE / "single_wheel.csv"), "--setup", str(EXAMPLE / "setup.yaml")]) == 0
    assert "slip and load taken as exact (noise.slip, noise.load not given)" in capsys.readouterr().out


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="needs /dev/full")
def test_a_result_that_cannot_be_printed_is_one_line(tmp_path):
    command = [sys.executable, "-m", "soil_env.identification", str(EXAMPLE / "single_wheel.csv")]
    command += ["--setup", str(EXAMPLE / "setup.yaml"), "--out", str(tmp_path / "out")]
    with open("/dev/full", "w") as full:
        done = subprocess.run(command, stdout=full, stderr=subprocess.PIPE, text=True, timeout=300, cwd=ROOT)
    assert done.returncode == 2 and done.stderr.count("\n") == 1 and "No space left on device" in done.stderr
    assert len(list((tmp_path / "out").iterdir())) == 2


def test_the_python_of_the_page_prints_what_it_says(monkeypatch):
    """docs/identify.md: every block of Python, in order; a comment after a print is what it prints."""
    monkeypatch.chdir(ROOT)
    blocks = re.findall(r"```python\n(.*?)```", (ROOT / "docs" / "identify.md").read_text(encoding="utf-8"), re.DOTALL)
    names, shown = {}, io.StringIO()
    with redirect_stdout(shown):
        for block in blocks:
            exec(compile(block, "identify.md", "exec"), names)
    said = re.findall(r"^print\(.*\)  # (.+)$", "\n".join(blocks), re.MULTILINE)
    assert len(blocks) == 2 and len(said) == 2
    assert shown.getvalue().splitlines()[-2:] == said
    assert f"{names['found'].other.sinkage_coefficient:.2e}" == "5.40e+06"


# --- the benchmark ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("arguments", [["--seed", "-1"], ["--seed", "1.5"], ["--out", ""]])
def test_the_benchmark_refuses_bad_options(capsys, monkeypatch, arguments):
    monkeypatch.setattr(benchmark, "study", pytest.fail)
    with pytest.raises(SystemExit) as ended:
        benchmark.main(arguments)
    assert ended.value.code == 2 and f"argument {arguments[0]}" in capsys.readouterr().err


def test_the_benchmark_refuses_a_folder_that_is_none_before_the_study(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(benchmark, "study", pytest.fail)
    (tmp_path / "file").write_text("")
    (tmp_path / "identification.md").mkdir()
    for out, said in ((tmp_path / "file", "is a file: expected a folder"), (tmp_path / "file" / "x", "is a file"),
                      (tmp_path, "identification.md: is a folder")):  # fmt: skip
        assert benchmark.main(["--out", str(out)]) == 2
        shown = capsys.readouterr()
        assert shown.out == "" and shown.err.count("\n") == 1 and shown.err.startswith("benchmarks.identification: ")
        assert said in shown.err
