"""Blind benchmark of discovery: which mechanism is missing from the model of a wheel on soil?

    python -m benchmarks.discovery run --entrant workflow --seed 100001 --out DIR --jobs 16
                                                draw, ask, score
    python -m benchmarks.discovery run --held-out ...                       the final run
    python -m benchmarks.discovery score --out DIR --publish docs/results   all answers in DIR

An entrant is `workflow` or module:function, from the paths of data.csv and setup.yaml to a
benchmarks.discovery.entrants.Answer. The same command goes on with a run that was interrupted.
Develop with seeds from 100000 on and without --held-out.

DIR holds cases/NAME, truth/NAME.json, answers/ENTRANT/NAME.json, and study.json with seed and
generator.
"""

import hashlib
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from dataclasses import asdict
from functools import partial
from pathlib import Path

import click
from threadpoolctl import threadpool_limits

import soil_env
from benchmarks.common import read_json
from benchmarks.discovery import score
from benchmarks.discovery.cases import GROUPS, draw_case, generator, task_of, tasks, write_case
from benchmarks.discovery.entrants import ENTRANTS, Answer, entrant
from soil_env._io.files import make_folder, write_json
from soil_env._io.loading import ParameterError
from soil_env.cli.running import PATH, WholeNumber, leave, run
from soil_env_agents.cells import in_process, processes

NAME = "benchmarks.discovery"
FIRST = 100000  # seed of development


def begin(folder: Path, seed: int) -> None:
    """Make the folder of a study. Raises `ParameterError` if it holds another seed or generator."""
    make_folder(folder)
    _agree(folder / "study.json", {"seed": seed, "generator": generator()}, "--out")


def describe(folder: Path, label: str, who: str) -> None:
    """Keep the entrant `who` and the hashed sources of soil_env beside the answers of a `label`.

    Raises `ParameterError` where the answers are by another entrant or other sources.
    """
    sources = sorted(Path(soil_env.__file__).parent.rglob("*.py"))
    digest = hashlib.sha256(b"".join(f.read_bytes() for f in sources)).hexdigest()[:12]
    about = {"entrant": who, "soil_env": f"{soil_env.__version__}+{digest}"}
    _agree(folder / "answers" / f"{label}.json", about, "--label")


def _agree(path: Path, about: dict, option: str) -> None:
    """Keep `about` in a JSON file; `ParameterError`, which asks for another `option`, where it has
    something else already.
    """
    known = read_json(path) if path.exists() else about
    if known != about:
        raise ParameterError(f"{path}: of {known}, asked {about}: expected another {option}")
    path.parent.mkdir(parents=True, exist_ok=True)
    write_json(path, about)


def draw(seed: int, folder: Path, name: str) -> None:
    """Draw the case `name` of a seed and write it and its truth into the folder of the study,
    unless it is there.
    """
    truth = folder / "truth" / f"{name}.json"
    if not truth.exists():
        write_case(draw_case(seed, task_of(name)), folder / "cases" / name, truth)


def ask(who: str, label: str, seed: int, folder: Path, name: str) -> None:
    """Draw a case if it is not there, ask the entrant in a folder that holds only the case, keep
    the answer.
    """
    draw(seed, folder, name)
    with tempfile.TemporaryDirectory() as place:
        shutil.copytree(folder / "cases" / name, place, dirs_exist_ok=True)
        begun = time.perf_counter()
        try:
            with threadpool_limits(1):
                answer = entrant(who)(Path(place) / "data.csv", Path(place) / "setup.yaml")
            answer = answer if isinstance(answer, Answer) else Answer.of(answer)
        except Exception as error:
            answer = Answer("error", note=f"{type(error).__name__}: {error}"[:300])
        seconds = round(time.perf_counter() - begun, 3)
    file = folder / "answers" / label / f"{name}.json"
    file.parent.mkdir(parents=True, exist_ok=True)
    write_json(file, asdict(answer) | {"seconds": seconds})


def each(work: Callable[[str], object], names: Sequence[str], jobs: int) -> None:
    """Call `work` with every name in `jobs` processes; an interrupt loses only the cases in
    work.
    """
    engine = in_process if jobs == 1 else partial(processes, workers=jobs)
    for done, (name, _) in enumerate(engine(work, names), start=1):
        print(f"{done}/{len(names)} {name}", file=sys.stderr, flush=True)


def _names(limit: int | None, groups: tuple[str, ...], held_out: bool) -> list[str]:
    """Names of the cases that the options choose: those of `tasks`, of the `groups` if there are
    some.
    """
    held = [g for g in groups if GROUPS[g].sort == "held"]
    if held and not held_out:
        raise ParameterError(
            f"--group {held[0]}: kinds that are held back from development: expected --held-out too"
        )
    return [t.name for t in tasks(limit, held_out) if not groups or t.group in groups]


def publish_scores(
    out: Path, publish: Path | None, limit: int | None, groups: tuple[str, ...], held_out: bool
) -> None:
    """Score the answers in a folder, write the figures and print a table."""
    about = read_json(out / "study.json")
    labels = sorted(p.name for p in (out / "answers").glob("*") if p.is_dir())
    if not labels:
        raise ParameterError(f"{out}: no answers; expected those of a run")
    entrants = {}
    for label in labels:
        if records := score.read_records(out, label, _names(limit, groups, held_out)):
            entrants[label] = read_json(out / "answers" / f"{label}.json") | score.figures(records)
    place = publish or out
    make_folder(place)
    write_json(place / "discovery.json", about | {"limit": limit, "entrants": entrants})
    print(score.table(entrants).markdown())


@click.group(NAME)
def command() -> None:
    """Blind naming of missing mechanisms: draw cases, ask entrants, score their answers."""


def _of_cases(work: Callable) -> Callable:
    """Decorator: add the options of both subcommands, for folders and the choice of cases."""
    options = (
        click.option(
            "--out",
            type=PATH,
            required=True,
            metavar="DIR",
            help="Folder of cases, truths, answers.",
        ),
        click.option(
            "--limit",
            type=WholeNumber(1),
            metavar="N",
            help="Only the first N cases, a fair sample.",
        ),
        click.option(
            "--group",
            "groups",
            multiple=True,
            type=click.Choice(list(GROUPS)),
            metavar="GROUP",
            help="Only this group.",
        ),
        click.option(
            "--held-out", is_flag=True, help="With the unlisted kinds that no development may use."
        ),
        click.option(
            "--publish",
            type=PATH,
            metavar="DIR",
            help="Folder of the scores (default: that of --out).",
        ),
    )
    for option in reversed(options):
        work = option(work)
    return work


@command.command("run")
@click.option(
    "--entrant",
    "who",
    required=True,
    metavar="NAME",
    help=f"{', '.join(ENTRANTS)} or module:function.",
)
@click.option("--label", metavar="NAME", help="Folder of the answers (default: from --entrant).")
@click.option("--seed", type=WholeNumber(), default=FIRST, metavar="N", help=f"Default: {FIRST}.")
@click.option("--jobs", type=WholeNumber(1), default=1, metavar="N", help="Processes (default 1).")
@_of_cases
def run_command(who, label, publish, seed, jobs, out, limit, groups, held_out) -> None:
    """Ask an entrant and score it; resumes."""
    label = label or re.sub(r"\W+", "_", who)[:40]
    entrant(who)  # before the work: that there is one
    begin(out, seed)
    describe(out, label, who)
    left = [
        n
        for n in _names(limit, groups, held_out)
        if not (out / "answers" / label / f"{n}.json").exists()
    ]
    each(partial(ask, who, label, seed, out), left, jobs)
    publish_scores(out, publish, limit, groups, held_out)


command.command("score", help="Score the answers in a folder.")(_of_cases(publish_scores))


def main(arguments: list[str] | None = None) -> int:
    """Run the command; return the exit status."""
    return run(command, arguments, NAME)


if __name__ == "__main__":
    # Processes of --jobs look functions up in a named module.
    from benchmarks.discovery import __main__ as imported

    leave(imported.main())
