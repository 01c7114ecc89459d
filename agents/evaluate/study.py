"""Configuration of an evaluation, its tasks, and the log of the courses that are driven.

The folder holds study.yaml (the whole task, resolved) and courses.jsonl: one line a block of courses of one controller.
Blocks are cut the same way by every engine, so that all engines and any number of interruptions give the same lines, in
another order at most.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path

import soil_env
from soil_env._io.loading import ParameterError, quantity
from soil_env.identification.online import immobilisation
from soil_env.parameters import Scenario

from .. import studies
from ..config import OfWorld
from ..controllers.oracle import Oracle
from . import loading
from .contestants import Contestant, digest, model_files
from .driving import HELD_OUT_SET
from .limit import BLOCK, ORACLE
from .records import Records, record

LOG = "courses.jsonl"


@functools.cache
def code_version() -> str:
    """Version of soil_env, with a hash of the code that results follow from (not of its compiled form)."""
    here, there = Path(soil_env.__file__).parent, Path(__file__).parents[1]
    files = [*sorted(here.rglob("*.py")), immobilisation.FILE, *sorted((there / "controllers").rglob("*.py"))]
    files += [there / "evaluate" / name for name in ("driving.py", "records.py", "warning.py")]
    return studies.fingerprint(files)


@dataclass(frozen=True)
class Study(OfWorld):
    """What is compared, and on which courses."""

    scenario: Scenario
    controllers: dict[str, Contestant]  # by `Contestant.key`
    courses: int = quantity("", 1, 100_000, default=1000)
    seed: int = quantity("", 0, 2**63 - 1, default=HELD_OUT_SET, doc="names the set of courses")
    block: int = quantity("courses driven side by side", 1, 100_000, default=100)
    resamples: int = quantity("of the bootstrap", 10, 100_000, default=2000)
    tuning_courses: int = quantity("0: not tuned", 0, 10**6, default=0)
    oracle_courses: int = quantity("of them, that the oracle drives too", 0, 100_000, default=0)
    tuned: dict = field(default_factory=dict)  # {classical controller: settings that tuning has found}
    model: dict = field(default_factory=dict)  # content of the model.yaml of the world's effects; empty = none
    version: str = field(default_factory=code_version)

    def __post_init__(self):
        super().__post_init__()
        if self.oracle_courses > self.courses:
            raise ParameterError(
                f"Study.oracle_courses = {self.oracle_courses}: expected at most {self.courses}, the courses compared"
            )

    @property
    def names(self) -> list[str]:
        """The algorithms, in the order in which they were named."""
        return list(dict.fromkeys(c.name for c in self.controllers.values()))

    def contestants(self) -> dict[str, Contestant]:
        """The controllers with the settings they are driven with."""
        return {
            key: replace(c, settings={**self.tuned.get(c.name, {}), **c.settings})
            for key, c in self.controllers.items()
        }

    def tasks(self) -> list[Task]:
        """All blocks of all controllers; block by block, so that an interrupted study has all controllers."""
        firsts = range(0, self.courses, self.block)
        own = [Task(key, f, min(self.block, self.courses - f)) for f in firsts for key in self.controllers]
        return own + [
            Task(ORACLE, f, min(BLOCK, self.oracle_courses - f)) for f in range(0, self.oracle_courses, BLOCK)
        ]


@dataclass(frozen=True)
class Task:
    """Courses `first` ... `first + count - 1` for controller `controller` of a study."""

    controller: str  # `Contestant.key`, or ORACLE
    first: int
    count: int


def load_study(folder: Path) -> Study:
    """The study of a folder."""
    return studies.load_study(Study, folder, code_version())


def check_controllers(study: Study) -> None:
    """Load and try every controller; ParameterError for the first that cannot be used."""
    for contestant in study.contestants().values():
        if contestant.kind == "model" and digest(contestant.source) != contestant.digest:
            raise ParameterError(f"controllers: {contestant.label}: the model has changed since the study began")
        loading.check(contestant, study.scenario, study.world)


# --- what is driven ---------------------------------------------------------------------------------------------------


class Job:
    """Drives tasks of a study; can be sent to other processes and machines.

    `ship`: take the models along, for machines that do not have the files.
    """

    def __init__(self, study: Study, threads: int | None = 1, ship: bool = False):
        self.scenario, self.seed, self.version = study.scenario, study.seed, study.version
        self.controllers = study.contestants()
        self.threads, self.world = threads, study.world
        self.files = {key: model_files(c.source) for key, c in self.controllers.items() if ship and c.kind == "model"}
        self._loaded: dict[str, object] = {}

    def __getstate__(self):
        return {**self.__dict__, "_loaded": {}}

    def __call__(self, task: Task) -> dict[str, list]:
        """The columns of `Records` of a task."""
        if self.version != code_version():
            raise ParameterError(f"a worker has soil_env {code_version()}, the study {self.version}")
        if task.controller == ORACLE:
            oracle, where = Oracle(self.scenario), (self.scenario, self.seed, task.first, task.count)
            return record(oracle, *where, self.threads, self.world).columns()
        contestant = self.controllers[task.controller]
        controller = self._loaded.get(task.controller)
        if controller is None:
            controller = loading.load(contestant, self.scenario, self.files.get(task.controller))
            if contestant.kind != "class":  # a class may keep things in itself: a new one for every block
                self._loaded[task.controller] = controller
        try:
            return record(
                controller, self.scenario, self.seed, task.first, task.count, self.threads, self.world
            ).columns()
        except ParameterError as error:
            text = str(error)
            raise ParameterError(
                text if text.startswith("controllers: ") else f"controllers: {contestant.label}: {text}"
            ) from None


def log_of(study: Study, folder: Path) -> studies.ResultLog:
    """courses.jsonl of a study: {task: its records}."""
    known = set(study.tasks())

    def parse(content: dict) -> tuple[Task, Records]:
        task = Task(str(content["controller"]), int(content["first"]), int(content["count"]))
        records = Records.from_columns(content["columns"])
        if task not in known or records.cause.size != task.count:
            raise ValueError(f"{task} with {records.cause.size} courses is not in the study")
        return task, records

    return studies.ResultLog(Path(folder) / LOG, parse)


def run(study: Study, folder: Path, engine: studies.Engine, job: Job, progress: Callable[[int], None]) -> dict:
    """Drive what is missing in `folder`; {algorithm: [Records of each member]}, and {ORACLE: [Records]} where the study
    asks for it. `progress` is told courses done."""
    with log_of(study, folder) as log:
        progress(sum(task.count for task in log.results))
        missing = [task for task in study.tasks() if task not in log.results]
        with closing(engine(job, missing)) as driven:
            for task, columns in driven:
                log.add({**dataclasses.asdict(task), "columns": columns})
                progress(task.count)
        out: dict[str, list[Records]] = {name: [] for name in study.names}
        for key, contestant in study.controllers.items():
            blocks = [log.results[task] for task in study.tasks() if task.controller == key]
            out[contestant.name].append(Records.join(blocks))
        if study.oracle_courses:
            out[ORACLE] = [Records.join([log.results[task] for task in study.tasks() if task.controller == ORACLE])]
        return out
