"""`--help` of every command is its manual page."""

import importlib
import io
import re
from contextlib import redirect_stdout

import pytest

COMMANDS = (
    "soil_env.discrepancy.__main__",
    "soil_env.discrepancy.cmu",
    "soil_env.identification.__main__",
    "soil_env.paper.recompute",
    "agents.evaluate.__main__",
    "agents.sim2real.__main__",
    "benchmarks.blind",
    "benchmarks.blind_cases",
    "benchmarks.cmu",
    "benchmarks.identification",
    "benchmarks.identification_coverage",
    "benchmarks.throughput",
    "benchmarks.training",
)
SECTIONS = {  # a manual page has these
    "synopsis": r"^usage: ",
    "options": r"^options:$",
    "exit status": r"^exit status:",
    "examples": r"^examples?:|^    python |^  python ",
    "files": r"^files:|\bOUT\b|report\.html|Writes? ",
}


def help_of(module: str) -> str:
    out = io.StringIO()
    with redirect_stdout(out), pytest.raises(SystemExit) as end:
        importlib.import_module(module).main(["--help"])
    assert end.value.code == 0
    return out.getvalue()


@pytest.mark.parametrize("module", COMMANDS)
def test_help_is_a_manual_page(module, monkeypatch):
    monkeypatch.setenv("COLUMNS", "120")
    text = help_of(module)
    for section, pattern in SECTIONS.items():
        assert re.search(pattern, text, re.MULTILINE), f"{module}: no {section}"
    assert max(map(len, text.splitlines())) <= 120
    description = text.split("\n\n")[1]
    assert len(description) > 40, f"{module}: no description"
    said = text.split("options:\n", 1)[1].split("\n\n")[0]
    options = re.findall(r"^  (-[^\n]*(?:\n {6,}[^\n]*)*)", said, re.MULTILINE)
    assert options
    for option in options:
        words = re.split(r" {2,}|\n", option, maxsplit=1)
        assert len(words) == 2 and words[1].strip(), f"{module}: {option}: not described"
        takes_value = re.match(r"(?:-\w, )?--[\w-]+ \S", words[0])
        if takes_value and not re.search(r"default|required|go on|folder with|cluster|first|classical", option):
            named = re.match(r"--([\w-]+)", words[0]).group(1)
            assert named in ("data", "resume", "controllers", "out", "model", "world", "effect", "records", "run"), (
                option
            )
