"""Configuration, folder and steps of an ablation.

    study.yaml                     what was asked, resolved; another study may not go on in this folder
    SCENARIO/tuned.json            settings of the classical controllers, tuned on this scenario
    SCENARIO/trained/AGENT-SEED/   a run folder of `agents.training`: config.yaml, model.zip, checkpoint.zip on the way
    SCENARIO/driven/NAME-SEED.json the held-out courses as driven by one controller or agent
    SCENARIO/evaluation/           evaluation.json, report.html, ... of `agents.evaluate`

Files are written atomically, so that a study goes on after an interrupt or a kill with what is missing. Work is
ordered by training seed: a study that is cut off has the same number of seeds for all, but for the last.
"""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from soil_env._io.files import replace_file
from soil_env._io.loading import Checked, ParameterError, load, quantity, to_dict, unknown_key
from soil_env.parameters import Scenario, load_scenario
from soil_env.terramechanics.model import WheelSoilModel

from .. import studies
from ..cli import config_mapping
from ..config import OfWorld, PPOConfig, TrainConfig
from ..controllers import CONTROLLERS
from ..evaluate import HELD_OUT_SET, study as driving
from ..evaluate.contestants import Contestant, digest
from ..evaluate.records import Records
from ..evaluate.tuning import kept_settings

_NOT_COMPARED = ("seeds", "courses")  # may differ when a study goes on: more seeds, other courses


@dataclass(frozen=True)
class Target(OfWorld):
    """A scenario on which controllers are compared."""

    scenario: Scenario
    trained_on: str = ""  # the target whose agents and tuned controllers are compared here; empty = its own
    model: dict = field(default_factory=dict)  # content of the model.yaml of this world's effects; empty = none


@dataclass(frozen=True)
class AgentSpec(Checked):
    """An agent that is trained."""

    observation: Literal["blind", "identified", "true_soil"]
    algorithm: Literal["ppo", "recurrent_ppo"] = "ppo"
    hidden_worlds: int = quantity("mixed into the training", 0, 1000, default=0)
    timesteps: int = quantity("environment steps", 1, 10**12, default=4_000_000)
    ppo: PPOConfig = PPOConfig()


@dataclass(frozen=True)
class Question(Checked):
    """The agents that the verdicts are about; empty = the first that reads `identified`, `blind`, `true_soil`."""

    identified: str = ""
    blind: str = ""
    true_soil: str = ""


@dataclass(frozen=True)
class Ablation(Checked):
    """Configuration of an ablation."""

    targets: dict[str, Target]
    agents: dict[str, AgentSpec]
    question: Question = Question()
    seeds: int = quantity("trainings of each agent on each scenario", 1, 1000, default=5)
    courses: int = quantity("held-out courses of each scenario", 2, 10**6, default=1000)
    held_out: int = quantity("seed of the set of those courses", 0, 2**31 - 1, default=HELD_OUT_SET)
    tuning_courses: int = quantity("courses that the classical controllers are tuned on", 1, 10**6, default=200)
    block: int = quantity("courses driven side by side", 1, 100_000, default=100)
    resamples: int = quantity("of the bootstrap", 10, 100_000, default=2000)
    checkpoint_every: int = quantity("environment steps", 1, 10**12, default=500_000)
    version: str = field(default_factory=driving.code_version)

    def __post_init__(self):
        super().__post_init__()
        for name, target in self.targets.items():
            source = target.trained_on
            if source and source not in self.sources:
                raise unknown_key(source, self.sources, f"targets.{name}: trained_on")
        for name in self.agents:
            if name in CONTROLLERS or "-" in name or "/" in name:
                raise ParameterError(f"agents: {name!r}: expected a name without - and /, not that of a controller")
        for observation, name in to_dict(self.question).items():
            if name and name not in self.agents:
                raise unknown_key(name, self.agents, f"question.{observation}")
            if name and self.agents[name].observation != observation:
                raise ParameterError(f"question.{observation}: {name} reads {self.agents[name].observation}")
        if not self.sources or not self.agents:
            raise ParameterError("expected at least one scenario to train on and one agent")

    @property
    def sources(self) -> list[str]:
        """The targets that are trained on."""
        return [name for name, target in self.targets.items() if not target.trained_on]

    def asked_about(self, observation: str) -> str | None:
        """The agent with an observation that the verdicts are about."""
        first = (name for name, spec in self.agents.items() if spec.observation == observation)
        return getattr(self.question, observation) or next(first, None)

    def source(self, target: str) -> str:
        """The target whose agents and controllers are compared on `target`."""
        return self.targets[target].trained_on or target

    def fed_by(self, source: str) -> list[str]:
        """The targets on which the agents and controllers of `source` are compared."""
        return [name for name in self.targets if self.source(name) == source]


def read_config(path: Path, only: list[str] | None = None, **changes) -> Ablation:
    """The study of a YAML file (see configs/ablation.yaml), with `changes` over it, for the scenarios `only`."""
    content = {**config_mapping(path), **{k: v for k, v in changes.items() if v is not None}}
    known = {"scenarios", *(f.name for f in dataclasses.fields(Ablation))} - {"targets", "version"}
    for key in content:
        if key not in known:
            raise unknown_key(key, known, str(path))
    entries = content.pop("scenarios", None)
    if not isinstance(entries, dict) or not entries:
        raise ParameterError(f"{path}: scenarios: expected a mapping NAME: {{...}}")
    for name in only or ():
        if name not in entries:
            raise unknown_key(name, entries, f"{path}: scenarios")
    targets = {name: _target(path, name, entry) for name, entry in entries.items() if not only or name in only}
    try:
        return load(Ablation, {**content, "targets": targets}, str(path))
    except ParameterError as error:  # in the words of the file
        raise ParameterError(str(error).replace(f"{path}: targets.", f"{path}: scenarios.", 1)) from None


def _target(path: Path, name: str, entry) -> dict:
    """The mapping of a `Target` that an entry of `scenarios` in the file `path` stands for."""
    where = f"{path}: scenarios.{name}"
    if entry is not None and not isinstance(entry, dict):
        raise ParameterError(f"{where} = {entry!r:.60}: expected a mapping")
    entry = entry or {}
    for key in entry:
        if key not in ("scenario", "changes", "trained_on", "model"):
            raise unknown_key(key, ("scenario", "changes", "trained_on", "model"), where)
    for key, kind, expected in (("changes", dict, "a mapping"), ("model", str, "the path of a model.yaml")):
        if not isinstance(entry.get(key) or kind(), kind):
            raise ParameterError(f"{where}.{key} = {entry[key]!r:.60}: expected {expected}")
    world, scenario = entry.get("model"), entry.get("scenario", name)
    try:
        load_scenario(scenario)
    except ParameterError as error:
        raise ParameterError(f"{where}: {error}") from None
    return {
        "scenario": to_dict(load_scenario(scenario, entry.get("changes"), f"{where}.changes")),
        "trained_on": entry.get("trained_on", ""),
        "model": WheelSoilModel.load(_beside(path, world)).content() if world else {},
    }


def with_steps(study: Ablation, timesteps: int) -> Ablation:
    """The same study with another length of its trainings."""
    agents = {name: dataclasses.replace(spec, timesteps=timesteps) for name, spec in study.agents.items()}
    return dataclasses.replace(study, agents=agents)


def _beside(path: Path, name: str) -> Path:
    """A file named in a YAML file: as seen from here, else from beside that file."""
    return Path(name) if Path(name).is_file() else Path(path).parent / name


def begin(study: Ablation, folder: Path) -> None:
    """Write study.yaml; ParameterError where the folder holds another study, or something else."""
    studies.is_begun(study, folder, _NOT_COMPARED)
    studies.save_study(study, folder)


def open_study(folder: Path) -> Ablation:
    """The study of a folder."""
    return studies.load_study(Ablation, folder, driving.code_version())


# --- steps ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Step:
    """One piece of work: tune and drive the classical controllers of a scenario, or train and drive one agent."""

    source: str
    agent: str = ""  # empty: the classical controllers
    seed: int = 0

    def __str__(self) -> str:
        return f"{self.source} {self.agent} seed {self.seed}" if self.agent else f"{self.source} classical controllers"


def steps(study: Ablation) -> list[Step]:
    """All work in its order: the classical controllers, then seed by seed every agent on every scenario."""
    classical = [Step(source) for source in study.sources]
    return classical + [
        Step(source, agent, seed) for seed in range(study.seeds) for source in study.sources for agent in study.agents
    ]


def cost(study: Ablation, step: Step) -> int:
    """Environment steps of the training in a step, the unit of its progress."""
    return study.agents[step.agent].timesteps if step.agent else 0


def done(study: Ablation, folder: Path, step: Step) -> bool:
    """Whether all files of a step are there."""
    names = [step.agent] if step.agent else list(CONTROLLERS)
    return all(
        driven_file(folder, target, name, step.seed).is_file() for target in study.fed_by(step.source) for name in names
    )


def perform(study: Ablation, folder: Path, step: Step, progress: Callable[[int], None]) -> None:
    """Do what is missing of a step; `progress` is told environment steps of training done since its last call."""
    folder = Path(folder)
    if not step.agent:
        settings = _tuned(study, folder, step.source)
        for name in CONTROLLERS:
            contestant = Contestant(name, 0, "classical", name, settings=settings.get(name, {}))
            _drive(study, folder, step, contestant)
        return
    model = _train(study, folder, step, progress)
    _drive(study, folder, step, Contestant(step.agent, step.seed, "model", str(model), digest(str(model))))


def driven_file(folder: Path, target: str, name: str, seed: int) -> Path:
    """File of the courses driven by one controller."""
    return Path(folder) / target / "driven" / f"{name}-{seed}.json"


def _tuned(study: Ablation, folder: Path, source: str) -> dict:
    path, target = folder / source / "tuned.json", study.targets[source]
    quiet = tuple(CONTROLLERS), lambda count, name: None
    return kept_settings(path, target.scenario, study.tuning_courses, *quiet, target.world)


class _Count:
    """What `training.train` shows progress on, told on as steps done since the last call."""

    def __init__(self, progress: Callable[[int], None], done: int):
        self.progress, self.done = progress, done

    def __enter__(self):
        self.progress(self.done)
        return self

    def __exit__(self, *error):
        return None

    def update(self, done: int, note: str = "") -> None:
        """Set the total of steps done."""
        self.progress(done - self.done)
        self.done = done


def _train(study: Ablation, folder: Path, step: Step, progress: Callable[[int], None]) -> Path:
    """Train from the checkpoint where there is one; the path of the model."""
    target, spec = study.targets[step.source], study.agents[step.agent]
    config = TrainConfig(
        scenario=target.scenario.name, model=target.model, observation=spec.observation, algorithm=spec.algorithm,
        hidden_worlds=spec.hidden_worlds,
        name=f"{step.agent}-{step.seed}", runs=str(folder / step.source / "trained"), seed=_seed_of(step),
        timesteps=spec.timesteps, checkpoint_every=study.checkpoint_every, ppo=spec.ppo,
    )  # fmt: skip
    from .. import training  # needs the extra `train`, which --help does not

    return training.trained(config, target.scenario, lambda title, total, unit, done: _Count(progress, done))


def _seed_of(step: Step) -> int:
    """Seed of a training, the same for all agents; far from the next one, as wheel k of a training has seed + k."""
    return 1_000_003 * (step.seed + 1)


def _drive(study: Ablation, folder: Path, step: Step, contestant: Contestant) -> None:
    """Drive the held-out courses of every target that the step feeds, where that is not done."""
    for name in study.fed_by(step.source):
        path, target = driven_file(folder, name, contestant.name, step.seed), study.targets[name]
        if path.is_file():
            continue
        one = driving.Study(
            scenario=target.scenario, controllers={contestant.key: contestant}, courses=study.courses,
            seed=study.held_out, block=study.block, model=target.model,
        )  # fmt: skip
        job = driving.Job(one, threads=1)
        parts = [Records.from_columns(job(task)) for task in one.tasks()]
        path.parent.mkdir(parents=True, exist_ok=True)
        content = {"contestant": dataclasses.asdict(contestant), "columns": Records.join(parts).columns()}
        replace_file(path, json.dumps(content, allow_nan=False))


# --- what is there ----------------------------------------------------------------------------------------------------


def evaluation(study: Ablation, folder: Path, target: str) -> tuple[driving.Study, dict[str, list[Records]]]:
    """The evaluation of one target as `agents.evaluate` has it: its study, and the records that are there."""
    contestants, records = {}, {}
    for name in (*CONTROLLERS, *study.agents):
        for seed in range(study.seeds if name in study.agents else 1):
            path = driven_file(folder, target, name, seed)
            if not path.is_file():
                continue
            content = json.loads(path.read_text(encoding="utf-8"))
            contestant = load(Contestant, content["contestant"], str(path))
            one = Records.from_columns(content["columns"])
            if one.cause.size != study.courses:
                raise ParameterError(f"{path}: {one.cause.size} courses, expected {study.courses}; delete it")
            contestants[contestant.key] = contestant
            records.setdefault(name, []).append(one)
    whole = driving.Study(
        scenario=study.targets[target].scenario, controllers=contestants, courses=study.courses, seed=study.held_out,
        block=study.block, resamples=study.resamples, tuning_courses=study.tuning_courses,
        model=study.targets[target].model, version=study.version,
    )  # fmt: skip
    return whole, records


def scores(records: dict[str, list[Records]], metric: str) -> dict[str, np.ndarray]:
    """{controller: [members, courses]} of a metric."""
    return {name: np.array([r.metric(metric) for r in rows]) for name, rows in records.items()}
