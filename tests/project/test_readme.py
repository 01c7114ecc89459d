"""README to the word: its length, and what its numbers and its inline commands say.

Its Python and its discovery are run by `test_pages`, make train and make test by `.ci/run`; the
table of results takes minutes.
"""

import re
import shlex
import tomllib

import pytest
from click.testing import CliRunner

from soil_env.cli import soil_env

from .test_pages import DOCS, FENCE, ROOT, blocks, tables

README = ROOT / "README.md"
TEXT = README.read_text(encoding="utf-8")
pytestmark = pytest.mark.documents


def test_it_has_at_most_600_words():
    assert len(TEXT.split()) <= 600


def test_blocks_that_are_not_run_say_why():
    """Shell that is run elsewhere: make by .ci/run, venv and pip by the Makefile, discover by
    test_pages.
    """
    run = ("make ", "python -m venv ", "pip install ", "soil-env warmup", "soil-env discover ")
    for block in blocks(README, "sh"):
        lines = block["code"].replace("\\\n", " ").splitlines()
        assert block["reason"] or all(line.startswith(run) for line in lines), block["code"]


def test_versions_of_python():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    named = re.findall(r"Python :: (3\.\d+)", " ".join(project["classifiers"]))
    first, last = re.search(r"Python (3\.\d+) to (3\.\d+)", TEXT).groups()
    assert [first, last] == [named[0], named[-1]]
    assert f"Python {first} or newer" in TEXT and project["requires-python"] == f">={first}"


def test_the_drive_of_the_picture():
    """The rule gets stuck and the agent finishes, on the course of the command below the picture.
    No picture is drawn, to save time.
    """
    command = re.search(r"`(soil-env drive .*?)`", TEXT)[1].replace("--every 12 ", "")
    words = shlex.split(command)
    at = words.index("--out")
    done = CliRunner().invoke(soil_env, words[1:at])
    ends = re.findall(r"^(\w+): (\w+)", done.output, re.MULTILINE)
    assert done.exit_code == 0 and ends, done.output
    assert dict(ends)["default_policy"] == "FINISHED" and dict(ends)["soft_start"] != "FINISHED"


def test_errors_of_braked_pull():
    """For the two measured wheels, smooth and lugged: as on the page of results."""
    said = re.search(r"errs by (\d+) and (\d+) % of the load", TEXT).groups()
    rows = tables(DOCS / "results.md")["Laws on measured wheels"]
    assert said == tuple(row["presets"] for row in rows if row["wheel"].startswith("CMU"))


def test_nothing_is_quoted_from_an_earlier_name():
    """Commands of the prose exist: their subcommand is in the help."""
    known = CliRunner().invoke(soil_env, ["--help"]).output
    for name in re.findall(r"`soil-env (\w+)", FENCE.sub("", TEXT)):
        assert re.search(rf"^ +{name} ", known, re.MULTILINE), name
