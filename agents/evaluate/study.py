"""One evaluation: what is compared on which courses, the folder it is kept in, and driving what is not driven yet.

The folder holds study.yaml (the whole task, resolved) and courses.jsonl: one line a block of courses of one controller,
written whole and flushed to the disk when the block is done. A line cut off by a crash is dropped when the study goes
on. Blocks are cut the same way by every engine, so that all engines and any number of interruptions give the same
lines, in another order at most.
"""

from __future__ import annotations

import dataclasses
import functools
import json
import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

import yaml

import soil_env
from soil_env._io.files import replace_file
from soil_env._io.loading import Checked, ParameterError, load, quantity, read_yaml, to_dict
from soil_env.parameters import Scenario
from soil_env.terramechanics.model import WheelSoilModel

from .. import engines
from . import contestants as entries
from .contestants import Contestant
from .driving import HELD_OUT_SET
from .records import Records, record

try:
    import fcntl
except ImportError:  # no POSIX: two evaluations in one folder are then not told from each other
    fcntl = None

STUDY, LOG = "study.yaml", "courses.jsonl"


@functools.cache
def code_version() -> str:
    """Version of soil_env, with a hash of the code that results follow from (not of its compiled form)."""
    here, there = Path(soil_env.__file__).parent, Path(__file__).parents[1]
    files = sorted(here.rglob("*.py")) + [there / "controllers.py"]
    files += [there / "evaluate" / name for name in ("driving.py", "records.py", "warning.py")]
    return engines.fingerprint(files)


@dataclass(frozen=True)
class Study(Checked):
    """What is compared, and on which courses."""

    scenario: Scenario
    controllers: dict[str, Contestant]  # by `Contestant.key`
    courses: int = quantity("", 1, 100_000, default=1000)
    seed: int = quantity("", 0, 2**63 - 1, default=HELD_OUT_SET, doc="names the set of courses")
    block: int = quantity("courses driven side by side", 1, 100_000, default=100)
    resamples: int = quantity("of the bootstrap", 10, 100_000, default=2000)
    tuning_courses: int = quantity("0: not tuned", 0, 10**6, default=0)
    tuned: dict = field(default_factory=dict)  # {classical controller: settings that tuning has found}
    model: dict = field(default_factory=dict)  # content of the model.yaml of the world's effects; empty = none
    version: str = field(default_factory=code_version)

    @property
    def world(self) -> WheelSoilModel | None:
        """The model of the world's effects."""
        return WheelSoilModel.from_content(self.model, "model") if self.model else None

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
        return [Task(key, f, min(self.block, self.courses - f)) for f in firsts for key in self.controllers]


@dataclass(frozen=True)
class Task:
    """Courses `first` ... `first + count - 1` for controller `controller` of a study."""

    controller: str  # `Contestant.key`
    first: int
    count: int


def save_study(study: Study, folder: Path) -> None:
    """Write study.yaml, in one piece."""
    replace_file(Path(folder) / STUDY, yaml.safe_dump(to_dict(study), sort_keys=False).encode())


def load_study(folder: Path) -> Study:
    """The study of a folder."""
    folder = Path(folder)
    if not folder.is_dir():
        raise ParameterError(f"{folder}: no such folder; expected one that an evaluation has written")
    path = folder / STUDY
    study = load(Study, read_yaml(path), str(path))
    if study.version != code_version():
        raise ParameterError(
            f"{path}: begun with soil_env {study.version}, this is {code_version()}: give another --out"
        )
    return study


def differences(a: Study, b: Study) -> list[str]:
    """What two studies differ in, tuning results aside."""
    return [f.name for f in dataclasses.fields(Study) if f.name != "tuned" and getattr(a, f.name) != getattr(b, f.name)]


def check_controllers(study: Study) -> None:
    """Load and try every controller; ParameterError for the first that cannot be used."""
    for contestant in study.contestants().values():
        if contestant.kind == "model":
            digest = entries.digest(contestant.source)
            if digest != contestant.digest:
                raise ParameterError(f"controllers: {contestant.label}: the model has changed since the study began")
        entries.check(contestant, study.scenario, study.world)


# --- what is driven ---------------------------------------------------------------------------------------------------


class Job:
    """Drives tasks of a study; can be sent to other processes and machines.

    `ship`: take the models along, for machines that do not have the files.
    """

    def __init__(self, study: Study, threads: int | None = 1, ship: bool = False):
        self.scenario, self.seed, self.version = study.scenario, study.seed, study.version
        self.controllers = study.contestants()
        self.threads, self.world = threads, study.world
        self.files = {
            key: entries.model_files(c.source) for key, c in self.controllers.items() if ship and c.kind == "model"
        }
        self._loaded: dict[str, object] = {}

    def __getstate__(self):
        return {**self.__dict__, "_loaded": {}}

    def __call__(self, task: Task) -> dict[str, list]:
        """The columns of `Records` of a task."""
        if self.version != code_version():
            raise ParameterError(f"a worker has soil_env {code_version()}, the study {self.version}")
        contestant = self.controllers[task.controller]
        controller = self._loaded.get(task.controller)
        if controller is None:
            controller = entries.load(contestant, self.scenario, self.files.get(task.controller))
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


class Log:
    """courses.jsonl of a study, held by one process at a time. Use with `with`."""

    def __init__(self, study: Study, folder: Path):
        self.study, self.path = study, Path(folder) / LOG
        self.blocks: dict[Task, Records] = {}

    def __enter__(self):
        self.file = os.open(self.path, os.O_RDWR | os.O_CREAT, 0o666)
        try:
            if fcntl is not None:
                fcntl.flock(self.file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            self._read()
        except BlockingIOError:
            os.close(self.file)
            raise ParameterError(f"{self.path}: another evaluation is writing it") from None
        except BaseException:
            os.close(self.file)
            raise
        return self

    def __exit__(self, *error):
        os.close(self.file)

    def _read(self) -> None:
        with open(self.path, "rb") as stream:
            content = stream.read()
        whole = content.rfind(b"\n") + 1
        known = set(self.study.tasks())
        for number, line in enumerate(content[:whole].splitlines(), 1):
            try:
                entry = json.loads(line)
                task = Task(str(entry["controller"]), int(entry["first"]), int(entry["count"]))
                records = Records.from_columns(entry["columns"])
                if task not in known or task in self.blocks or records.cause.size != task.count:
                    raise ValueError(f"{task} is not to be here")
            except (ValueError, KeyError, TypeError) as error:
                raise ParameterError(
                    f"{self.path}: line {number} is damaged ({error}); delete the line to have it driven again"
                ) from None
            self.blocks[task] = records
        os.ftruncate(self.file, whole)

    def append(self, task: Task, columns: dict[str, list]) -> None:
        """Keep a finished block; OSError leaves the file as it was."""
        if task in self.blocks:
            raise ValueError(f"{task} is driven already")
        records = Records.from_columns(columns)
        line = json.dumps({**dataclasses.asdict(task), "columns": columns}, allow_nan=False).encode() + b"\n"
        size = os.fstat(self.file).st_size
        try:
            rest = memoryview(line)
            os.lseek(self.file, size, os.SEEK_SET)
            while rest:
                rest = rest[os.write(self.file, rest) :]
            os.fsync(self.file)
        except OSError as error:
            os.ftruncate(self.file, size)
            raise OSError(error.errno, error.strerror, str(self.path)) from None
        self.blocks[task] = records

    def missing(self) -> list[Task]:
        """Tasks that are not driven yet."""
        return [task for task in self.study.tasks() if task not in self.blocks]

    def records(self) -> dict[str, list[Records]]:
        """{algorithm: the records of each of its members}, over all courses."""
        out: dict[str, list[Records]] = {name: [] for name in self.study.names}
        for key, contestant in self.study.controllers.items():
            parts = [self.blocks[t] for t in self.study.tasks() if t.controller == key]
            out[contestant.name].append(Records.join(parts))
        return out


def run(study: Study, folder: Path, engine: engines.Engine, job: Job, progress: Callable[[int], None]) -> dict:
    """Drive what is missing in `folder`; {algorithm: [Records of each member]}. `progress` is told courses done."""
    with Log(study, folder) as log:
        progress(sum(task.count for task in log.blocks))
        for task, columns in engine(job, log.missing()):
            log.append(task, columns)
            progress(task.count)
        return log.records()
