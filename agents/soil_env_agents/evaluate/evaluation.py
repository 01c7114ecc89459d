"""Configuration of an evaluation, and its cells: blocks of courses of one controller.

The folder holds study.yaml (the whole task, resolved) and a file in cells/ for each block that is
driven. Blocks are cut the same way by every engine, so that all engines and any number of
interruptions give the same files.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from soil_env._io.loading import ParameterError, quantity, to_dict

from ..cells import Engine, code_version, fill, is_begun, load_study, read_cell
from ..config import OfTask, check_oracle
from ..controllers.oracle import Oracle
from ..progress import Bar
from . import loading
from .comparing import ORACLE, ORACLE_BLOCK, comparison
from .contestants import Contestant, digest, model_bytes
from .driving import HELD_OUT_SET, Runs, run_block
from .own import bounds_of_settings, code_digest


@dataclass(frozen=True)
class Evaluation(OfTask):
    """Controllers that are compared, and their courses."""

    task: dict
    controllers: dict[str, Contestant]  # by `Contestant.key`
    courses: int = quantity("", 1, 100_000, default=1000)
    seed: int = quantity("", 0, 2**63 - 1, default=HELD_OUT_SET, doc="names the set of courses")
    block: int = quantity("courses driven side by side", 1, 100_000, default=100)
    resamples: int = quantity("of the bootstrap", 10, 100_000, default=2000)
    tuning_courses: int = quantity("0: not tuned", 0, 10**6, default=0)
    oracle_courses: int = quantity("of them, that the oracle drives too", 0, 100_000, default=0)
    #: {contestant: settings that tuning has found}, of classical ones and classes.
    tuned: dict[str, dict] = field(default_factory=dict)
    #: {contestant: digest of what it was tuned for: task, world, courses, and code of a class}.
    codes: dict = field(default_factory=dict)
    #: Content of the model.yaml of the world's effects; empty = none.
    model: dict = field(default_factory=dict)
    detailed: bool = True  # with the metrics `DETAILED` of a wheel
    version: str = field(default_factory=code_version)

    def _check_together(self) -> None:
        """FieldError where the oracle drives more courses than are compared."""
        check_oracle(self, self.oracle_courses, self.courses)

    def renewed(self, version: str) -> Evaluation:
        """This evaluation by other code, with nothing tuned."""
        return replace(self, version=version, tuned={}, codes={})

    def contestants(self) -> dict[str, Contestant]:
        """The controllers by `Contestant.key`, with the settings they are driven with: those given,
        over those that tuning has found.
        """
        own = self.controllers.items()
        return {
            key: replace(c, settings={**self.tuned.get(c.name, {}), **c.settings}) for key, c in own
        }

    def blocks(self) -> list[Block]:
        """All blocks by their first course, then by controller, so that an interrupted evaluation
        has the same courses of each; those of the oracle come last.
        """
        return [
            *_blocks_of(self.courses, self.block, self.controllers),
            *_blocks_of(self.oracle_courses, ORACLE_BLOCK, [ORACLE]),
        ]


@dataclass(frozen=True)
class Block:
    """Courses `first` to `first + count - 1` for the controller of a `Contestant.key`, or for
    `ORACLE`.
    """

    controller: str
    first: int
    count: int

    def __str__(self) -> str:
        """Name of the block, also of its file."""
        return f"{self.controller}-{self.first}"


def _blocks_of(courses: int, size: int, controllers: Collection[str]) -> list[Block]:
    """Blocks that cover the first `courses`, of at most `size` courses each.

    For each range of courses there is one block of each of the `controllers` (`Block.controller`).
    """
    return [
        Block(controller, first, min(size, courses - first))
        for first in range(0, courses, size)
        for controller in controllers
    ]


def as_begun(asked: Evaluation, folder: Path) -> Evaluation:
    """The evaluation of `folder` if that is `asked`, but for what tuning has written into it; else
    `asked`. Errors as of `cells.is_begun`.
    """
    if is_begun(asked, folder, ignored=("tuned", "codes")):
        return load_study(Evaluation, folder)
    return asked


def check_controllers(asked: Evaluation) -> None:
    """Load and try every controller; ParameterError for the first that cannot be used, and for
    models of one name that read other observations.
    """
    read: dict[str, str] = {}  # observation by name
    for contestant in asked.contestants().values():
        if contestant.kind == "model" and digest(contestant.source) != contestant.digest:
            raise ParameterError(
                f"controllers: {contestant.label}: the model has changed since the study began"
            )
        variant = loading.check(contestant, asked.scenario, asked.world)
        if read.setdefault(contestant.name, variant) != variant:
            raise ParameterError(
                f"controllers: {contestant.label}: reads the observation {variant!r}, another of "
                f"the name {read[contestant.name]!r}: expected trainings of one algorithm"
            )


class Job:
    """Drives blocks of an evaluation; can be sent to other processes and machines.

    `ship`: take the models along, for machines that do not have the files.
    """

    def __init__(self, asked: Evaluation, threads: int | None, ship: bool):
        self.asked = asked
        self.threads = threads
        self.controllers = asked.contestants()
        self.files = {
            key: model_bytes(c.source)
            for key, c in self.controllers.items()
            if ship and c.kind == "model"
        }
        self._loaded: dict[str, object] = {}

    def __getstate__(self):
        """All but the loaded controllers, which each process loads for itself."""
        return {**self.__dict__, "_loaded": {}}

    def __call__(self, block: Block) -> dict[str, list]:
        """The columns of the `Runs` of a block."""
        asked = self.asked
        key = block.controller
        try:
            runs = run_block(
                self._controller(key),
                asked.scenario,
                asked.seed,
                range(block.first, block.first + block.count),
                model=asked.world,
                threads=self.threads,
                detailed=asked.detailed and key != ORACLE,
            )
        except ParameterError as error:
            label = self.controllers[key].label if key in self.controllers else key
            named = str(error).startswith("controllers: ")
            raise ParameterError(
                str(error) if named else f"controllers: {label}: {error}"
            ) from None
        return runs.columns()

    def needs(self, block: Block) -> dict:
        """All that the runs of a block depend on, as plain values."""
        asked = self.asked
        contestant = self.controllers.get(block.controller)
        code = ""
        if contestant is not None and contestant.kind == "class":
            code = code_digest(contestant.source)
        return {
            "controller": to_dict(contestant) if contestant is not None else block.controller,
            "code": code,
            "courses": [asked.seed, block.first, block.count],
            **{name: getattr(asked, name) for name in ("task", "model", "detailed", "version")},
        }

    def _controller(self, key: str):
        """The loaded controller of a `Contestant.key`, or the oracle."""
        if key == ORACLE:
            return Oracle(self.asked.scenario)
        contestant = self.controllers[key]
        # An object may keep things in itself: a new one for every block.
        if contestant.kind == "class":
            return loading.load(contestant, self.asked.scenario)
        if key not in self._loaded:
            self._loaded[key] = loading.load(contestant, self.asked.scenario, self.files.get(key))
        return self._loaded[key]


def run(asked: Evaluation, folder: Path, engine: Engine, job: Job) -> dict:
    """Drive the blocks that are missing in `folder`, with a progress bar, and read all.

    Returns {name of a contestant: [runs of each member]}, with `ORACLE` as one more name if the
    oracle drives.
    """
    blocks = asked.blocks()
    names = {key: c.name for key, c in asked.controllers.items()} | {ORACLE: ORACLE}
    courses: Counter[str] = Counter()
    for block in blocks:
        courses[names[block.controller]] += block.count
    with Bar("Driving", courses, "courses") as bar:

        def progress(block: Block) -> None:
            """Count a block that is driven now."""
            bar.update(advance=block.count, part=names[block.controller])

        def found(block: Block) -> None:
            """Count a block that an earlier run has driven."""
            bar.found(block.count, names[block.controller])

        fill(job, blocks, folder, engine, progress, job.needs, found)

    def runs_of(key: str) -> Runs:
        """Runs of all blocks of a `Contestant.key`, or of `ORACLE`."""
        own = [b for b in blocks if b.controller == key]
        return Runs.join(
            [read_cell(folder, b, partial(Runs.from_columns, courses=b.count)) for b in own]
        )

    out: dict[str, list[Runs]] = {}
    for key, contestant in asked.controllers.items():
        out.setdefault(contestant.name, []).append(runs_of(key))
    return {**out, ORACLE: [runs_of(ORACLE)]} if asked.oracle_courses else out


def result(asked: Evaluation, runs: dict[str, list[Runs]]) -> dict:
    """The content of evaluation.json: a `comparison`, with how each controller was made.

    "sources": {name: [where from]}. "settings": {name: all that its controller drives with}, of
    classical ones and of classes with `bounds`. "chosen": {name: "given" where --settings named
    some of these, else "tuned" or "untuned"}. The fields `same` of `asked` are copied.
    """
    oracle = runs.get(ORACLE, [None])[0]
    own = {name: rows for name, rows in runs.items() if name != ORACLE}
    contestants = asked.contestants()
    settings = {
        c.name: loading.load(c, asked.scenario).settings
        for c in contestants.values()
        if c.kind == "classical"
        or (c.kind == "class" and bounds_of_settings(c.source, asked.scenario))
    }
    chosen = {
        c.name: "given" if c.settings else "tuned" if c.name in asked.tuned else "untuned"
        for c in asked.controllers.values()
        if settings.get(c.name)
    }
    same = ("tuning_courses", "block", "resamples", "version", *(["model"] if asked.model else []))
    return {
        **comparison(asked.scenario, asked.seed, own, settings, oracle, resamples=asked.resamples),
        "sources": {
            name: [c.source for c in contestants.values() if c.name == name] for name in own
        },
        "chosen": chosen,
        **{name: getattr(asked, name) for name in same},
    }
