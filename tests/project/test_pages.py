"""Pages against the code: snippets run, commands parse, tables of the contract agree, named code
exists.

Links within the site are checked by `mkdocs build --strict`. `python -m tests.project.test_pages`
writes the table of named effects into its page again.
"""

import ast
import functools
import importlib.util
import inspect
import os
import re
import shlex
import shutil
import sys
from enum import Enum
from pathlib import Path
from unittest import mock

import gymnasium
import numpy as np
import pytest
from click.testing import CliRunner

from soil_env.cli import soil_env
from soil_env.envs.wheel_env import SoilWheelEnv, SoilWheelVectorEnv
from soil_env.logs.mapping import UNITS
from soil_env.online import Readings
from soil_env.simulation.task import Cause
from tests.conftest import ROOT
from tests.programs import python

DOCS = ROOT / "docs"
GUIDE = sorted((DOCS / "guide").glob("*.md"))
OUTSIDE = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    ROOT / "SECURITY.md",
    ROOT / "examples" / "README.md",
]
PAGES = [*sorted(DOCS.rglob("*.md")), *OUTSIDE]
EFFECTS = DOCS / "physics" / "effects.md"
FENCE = re.compile(
    r"^(?:<!-- not run: (?P<reason>.+?) -->\n)?```(?P<language>\w*)[^\n]*\n(?P<code>.*?)^```",
    re.M | re.S,
)
FRAME = str.maketrans("", "", "╭╮╰╯│─")  # of the conclusion, which README shortens
SECONDS = 300  # a page may take, on a slow machine with nothing compiled

pytestmark = pytest.mark.documents


def name_of(page: Path) -> str:
    """Path of a page from the root of the repository, as the name of a test."""
    return page.relative_to(ROOT).as_posix()


def blocks(page: Path, *languages: str) -> list[re.Match]:
    """Code blocks of a page in these languages: matches of `FENCE`, whose `reason` says why a block
    is not run, None where it is.
    """
    return [
        block
        for block in FENCE.finditer(page.read_text(encoding="utf-8"))
        if block["language"] in languages
    ]


def printed_below(page: Path, found: list[re.Match], anywhere: bool = False) -> list[str]:
    """What the blocks `found` print by the page: the text block right below each, if any, or with
    `anywhere` the next one.
    """
    text = page.read_text(encoding="utf-8")
    below = re.compile(("" if anywhere else r"\n\n") + r"^```text\n(.*?)^```", re.M | re.S)
    looked = [(below.search if anywhere else below.match)(text, block.end()) for block in found]
    return [match[1] for match in looked if match]


def tables(page: Path) -> dict[str, list[dict[str, str]]]:
    """Rows of the first table below each heading, each by the names of its columns."""
    found = {}
    for section in re.split(r"^#+ ", page.read_text(encoding="utf-8"), flags=re.MULTILINE):
        if table := re.search(r"^\| .*\n\|-.*\n((\| .*\n)+)", section + "\n", re.MULTILINE):
            rows = [
                [cell.strip() for cell in line.strip()[2:-2].split(" | ")]
                for line in table[0].splitlines()
            ]
            found[section.splitlines()[0]] = [
                dict(zip(rows[0], row, strict=True)) for row in rows[2:]
            ]
    return found


@pytest.mark.slow
@pytest.mark.parametrize(
    "page",
    [p for p in [ROOT / "README.md", *GUIDE] if any(not b["reason"] for b in blocks(p, "python"))],
    ids=name_of,
)
def test_the_python_of_a_page_runs(page, tmp_path):
    """All blocks in order, in one process, in a folder that has examples/ and nothing else."""
    shutil.copytree(ROOT / "examples", tmp_path / "examples")
    code = "\n".join(block["code"] for block in blocks(page, "python") if not block["reason"])
    (tmp_path / "page.py").write_text(code, encoding="utf-8")
    done = python("page.py", cwd=tmp_path, timeout=SECONDS)
    for printed in printed_below(page, blocks(page, "python")):
        assert printed in done.stdout, done.stdout


def compare_discovery(page: Path, table: str, said: str) -> None:
    """Check that what the page shows below its command `discover` of a `table`, between "[...]", is
    in `said`, what the command prints; line breaks do not count.
    """
    command = next(b for b in blocks(page, "sh") if b["code"].startswith("soil-env discover"))
    assert f"examples/data/{table}" in command["code"]
    (printed,) = printed_below(page, [command], anywhere=True)
    words = " ".join(said.translate(FRAME).split())
    for part in printed.translate(FRAME).split("[...]"):
        for paragraph in part.split("\n\n"):
            assert " ".join(paragraph.split()) in words, paragraph


@pytest.mark.slow
def test_the_discovery_of_the_page():
    """What the command prints, of which the notebook of the same table prints all."""
    notebooks = pytest.importorskip("mkdocs_notebooks", reason="jupytext is in the extra docs")
    notebook = notebooks.executed("discover_and_predict")["discover_and_predict"]
    first = next(cell for cell in notebook.cells if cell.cell_type == "code")
    said = "".join(output.text for output in first.outputs if output.name == "stdout")
    compare_discovery(DOCS / "guide" / "discovery.md", "rig.csv", said)


@pytest.fixture
def output_of(tmp_path, monkeypatch, unrendered):
    """Function that runs the command in a block, in a folder with examples/data, and returns what
    it prints.
    """
    monkeypatch.chdir(tmp_path)
    shutil.copytree(ROOT / "examples" / "data", tmp_path / "examples" / "data")

    def run(command: re.Match) -> str:
        """Output of the command, which has to end with status 0."""
        done = CliRunner().invoke(soil_env, shlex.split(command["code"])[1:])
        assert done.exit_code == 0, done.output
        return done.output

    return run


@pytest.mark.slow
def test_the_discovery_of_the_readme(output_of):
    readme = ROOT / "README.md"
    command = next(b for b in blocks(readme, "sh") if b["code"].startswith("soil-env discover"))
    compare_discovery(readme, "continuum.csv", output_of(command))


def test_the_identification_of_the_page(output_of):
    """The first command of the page prints the table below it."""
    page = DOCS / "guide" / "identify.md"
    command = blocks(page, "sh")[0]
    (printed,) = printed_below(page, [command], anywhere=True)
    assert printed in output_of(command)


def test_the_ros_node_of_the_page_identifies(monkeypatch):
    """The node of the online identifier against a stand-in for rclpy, which is not on PyPI."""
    rclpy = mock.MagicMock()
    for name in ("rclpy", "nav_msgs", "nav_msgs.msg", "sensor_msgs", "sensor_msgs.msg"):
        monkeypatch.setitem(sys.modules, name, rclpy)
    code = next(
        b["code"] for b in blocks(DOCS / "guide" / "online.md", "python") if "rclpy" in b["code"]
    )
    exec(compile(code, "online.md", "exec"), {})
    node = rclpy.create_node.return_value
    receive = {call.args[1]: call.args[2] for call in node.create_subscription.call_args_list}
    period, identify = node.create_timer.call_args.args
    assert period == 0.1
    for k in range(40):
        receive["/joint_states"](mock.Mock(velocity=[2.0], effort=[5.0]))
        receive["/odom"](mock.Mock(**{"twist.twist.linear.x": 0.27 - 0.004 * k}))
        receive["/range"](mock.Mock(range=0.13))
        identify()
    shown = [call.args[0] for call in node.get_logger.return_value.info.call_args_list]
    assert len(shown) == 40 and shown[-1].startswith("phi ") and shown[-1] != shown[0]


def commands(page: Path) -> list[list[str]]:
    """Words of the commands in the shell blocks of a page."""
    text = "".join(block["code"] for block in blocks(page, "sh", "bash")).replace("\\\n", " ")
    return [words for line in text.splitlines() if (words := shlex.split(line, comments=True))]


@functools.cache
def help_of(*command: str) -> str:
    """Help text of a Python command."""
    environment = {
        **os.environ,
        "COLUMNS": "200",
        "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path]),
    }
    return python(*command, "--help", env=environment).stdout


def check_options(words: list[str], text: str) -> None:
    """Every option is in the help text; --changes.course.length also as --changes.KEY,
    --ppo.history as --ppo.KEY.
    """
    for word in words:
        if word.startswith("--"):
            option = word.partition("=")[0]
            group = option.partition(".")[0] + "." if "." in option else ""
            known = re.search(re.escape(option) + r"(?![\w-])", text) or (
                group and re.search(group + "[A-Z]", text)
            )
            assert known, word


@pytest.mark.parametrize("page", [p for p in PAGES if commands(p)], ids=name_of)
def test_the_commands_of_a_page_exist(page):
    """Programs and modules exist; subcommands and options are in the help."""
    targets = re.findall(
        r"^([a-z]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE
    )
    for words in commands(page):
        while "=" in words[0]:  # a variable of the environment
            words = words[1:]
        if words[0] == "make":
            assert words[1] in targets, words
        elif words[:2] == ["python", "-m"] and words[2].split(".")[0] in (
            "soil_env",
            "soil_env_agents",
            "benchmarks",
            "tests",
        ):
            assert importlib.util.find_spec(words[2]) is not None, words
        elif words[0] == "python" and words[1].startswith(("examples/", "train.py", "benchmarks/")):
            assert (ROOT / words[1]).is_file(), words
            if any(word.startswith("--") for word in words[2:]):
                check_options(words[2:], help_of(words[1]))
        elif words[0] == "soil-env" and not words[1].startswith("-"):
            shown = CliRunner().invoke(soil_env, [words[1], "--help"])
            assert shown.exit_code == 0, words
            check_options(words[2:], shown.output)


def entries(env_id: str, **keywords) -> list[tuple[str, float, float, float, float]]:
    """(name, min, max, centre, scale) of each entry of the observation."""
    plain = gymnasium.make(env_id, scaled=False, **keywords)
    low, high = (
        np.float64(bound) for bound in (plain.observation_space.low, plain.observation_space.high)
    )
    scaled = gymnasium.make(env_id, **keywords).observation_space
    scale = (high - low) / (np.float64(scaled.high) - np.float64(scaled.low))
    centre = low - np.float64(scaled.low) * scale
    return list(zip(plain.unwrapped.observation_names, low, high, centre, scale, strict=True))


def agree(rows: list[dict[str, str]], expected: list[tuple]) -> None:
    """Check that each row of a page has the name and the numbers of `expected` (`entries`) at the
    place that its column "#" says.
    """
    assert rows
    for row in rows:
        name, *numbers = expected[int(row["#"])]
        assert row["name"] == name
        assert [float(row[key]) for key in ("min", "max", "centre", "scale")] == pytest.approx(
            numbers, abs=1e-4
        ), name


@pytest.mark.parametrize(
    ("page", "env_id", "variant", "once", "twice"),
    [
        (
            "environment.md",
            "SoilWheel-v0",
            "identified",
            ["Sensors", "Identified soil", "Camera"],
            ["Camera and identified soil"],
        ),
        (
            "environment.md",
            "SoilWheel-v0",
            "true_soil",
            ["Sensors", "True soil", "Camera"],
            ["Camera and true soil"],
        ),
        ("rover.md", "SoilRover-v0", "identified", ["Body"], ["Axles", "Identified soil"]),
        ("rover.md", "SoilRover-v0", "true_soil", ["Body"], ["Axles", "True soil"]),
    ],
)
def test_the_observation_tables(page, env_id, variant, once, twice):
    """Entries of the tables `twice` come again, for the line beside or the other axle."""
    found = tables(DOCS / "guide" / page)
    expected = entries(f"soil_env:{env_id}", observation=variant)
    # Numbered as with "identified".
    sensors = {"true_soil": ("Sensors", "Camera", "Body", "Axles")}.get(variant, ())
    agree([row for name in (*once, *twice) if name not in sensors for row in found[name]], expected)
    assert sum(len(found[name]) for name in once) + 2 * sum(
        len(found[name]) for name in twice
    ) == len(expected)


@pytest.mark.parametrize(
    ("page", "names"), [("online.md", Readings._fields), ("logs.md", UNITS)], ids=["online", "logs"]
)
def test_the_tables_of_readings(page, names):
    text = (DOCS / "guide" / page).read_text(encoding="utf-8")
    table = text.split("\n| reading |")[1].split("\n\n")[0]
    assert sorted(re.findall(r"^\| `(\w+)` ", table, re.MULTILINE)) == sorted(names)


@pytest.mark.parametrize(
    ("page", "heading", "made"),
    [
        ("environment.md", "Arguments", SoilWheelEnv),
        ("vector.md", "Vector environments", SoilWheelVectorEnv),
    ],
)
def test_the_defaults_of_arguments(page, heading, made):
    """A default that is no value, as "of the action", is None in the code."""
    parameters = inspect.signature(made).parameters
    for row in tables(DOCS / "guide" / page)[heading]:
        default = parameters[row["argument"].strip("`")].default
        default = default.value if isinstance(default, Enum) else default
        said = row["default"].strip("`")
        try:
            assert default == ast.literal_eval(said), row
        except (SyntaxError, ValueError):
            assert default is None, row


def test_actions_rewards_causes_and_info_of_the_environment():
    found = tables(DOCS / "guide" / "environment.md")
    env = gymnasium.make("soil_env:SoilWheel-v0", info="full")
    env.reset(seed=0)
    *_, info = env.step(np.zeros(1, np.float32))
    assert {row["key"] for row in found["Info"]} == set(info)
    weights = env.unwrapped.scenario.reward
    assert {row["term"]: float(row["weight"]) for row in found["Reward"]} == {
        term: getattr(weights, term) for term in info["reward_terms"]
    }
    for row in found["Action space"]:
        control = gymnasium.make(
            "soil_env:SoilWheel-v0", action=row["action"].split()[0]
        ).unwrapped.scenario.control
        assert control.action_periods == int(row["repeat"])
    assert {row["cause"]: int(row["number"]) for row in found["Start and end"]} == {
        c.name: c.value for c in Cause
    }
    keys = {
        row["key"].strip("`")
        for row in tables(DOCS / "guide" / "traversability.md")["Traversability and warning"]
    }
    assert keys == set(info["traversability"])


@pytest.mark.parametrize("page", PAGES, ids=name_of)
def test_links_of_a_page_lead_to_files_of_the_clone(page):
    for target in re.findall(r"\]\(([^)#\s]+)", FENCE.sub("", page.read_text(encoding="utf-8"))):
        assert re.match(r"https?:|mailto:", target) or (page.parent / target).exists(), target


def test_code_that_pages_name_exists():
    hooks = pytest.importorskip("mkdocs_hooks")
    lines = [
        line
        for page in PAGES
        for line in re.findall(r"^Code: .*$", page.read_text(encoding="utf-8"), re.MULTILINE)
    ]
    lines += [row["names"] for row in tables(ROOT / "CONTRIBUTING.md")["Where to look"]]
    assert len(lines) > 20
    for name in (name for line in lines for name in re.findall(r"`([\w.]+)`", line)):
        hooks.resolve(name)  # LookupError for a name that no module, or more than one, defines


def test_every_equation_number_in_the_code_is_on_a_page():
    pages = "".join(page.read_text(encoding="utf-8") for page in (DOCS / "physics").glob("*.md"))
    tagged = set()
    for first, last in re.findall(r"\\tag\{(\d+)(?:-(\d+))?\}", pages):
        tagged |= set(range(int(first), int(last or first) + 1))
    used = set()
    for source in (*(ROOT / "soil_env").rglob("*.py"), *(ROOT / "agents").rglob("*.py")):
        for group in re.findall(
            r"Eqs?\.\s*((?:\(\d+\)(?:\s*(?:,|and|-)\s*)*)+)", source.read_text(encoding="utf-8")
        ):
            used |= {int(n) for n in re.findall(r"\((\d+)\)", group)}
    assert {1, 10} <= used  # the pattern finds them
    assert used <= tagged


def effects_page() -> str:
    """Page of named effects with the table of the catalogue."""
    from soil_env.terramechanics.effects.text import markdown

    table = f"<!-- effects -->\n{markdown().strip()}\n<!-- end -->"
    return re.sub(
        r"<!-- effects -->.*<!-- end -->",
        lambda _: table,
        EFFECTS.read_text(encoding="utf-8"),
        flags=re.DOTALL,
    )


def test_the_page_of_effects_has_the_catalogue():
    pytest.importorskip("soil_env.terramechanics.effects.text")
    assert EFFECTS.read_text(encoding="utf-8") == effects_page(), (
        "run python -m tests.project.test_pages"
    )


if __name__ == "__main__":
    EFFECTS.write_text(effects_page(), encoding="utf-8")
