"""Configuration of a study: arms, scenarios and worlds, read from a YAML file; docs/guide/study.md
has its keys.

Scenarios, arms and worlds have the keys of `_Scenario`, `Arm` and `World`, the other keys are the
numbers of `Study`. Files are looked for from here, then beside the YAML file.
"""

from __future__ import annotations

import dataclasses
import re
from dataclasses import dataclass, field
from pathlib import Path

from soil_env._io.loading import (
    Checked,
    FieldError,
    ParameterError,
    load,
    merge,
    quantity,
    to_dict,
    unknown_key,
    unknown_value,
)
from soil_env.parameters import RoverScenario, Scenario, load_rover, load_scenario
from soil_env.terramechanics.model import WheelSoilModel

from ..cells import code_version
from ..cli import config_mapping
from ..config import NO_NAME, OfTask, OfWorld, TrainConfig
from ..controllers import CONTROLLERS, within_bounds
from ..controllers.rover import ROVER_CONTROLLERS, controllers_of
from ..evaluate import loading
from ..evaluate.contestants import SHIPPED, SHIPPED_CLASS, Contestant
from ..evaluate.driving import HELD_OUT_SET, TUNING_SET
from ..evaluate.own import bounds_of_settings
from ..inputs import entries_of

#: Keys of the training's config that the study sets.
_SET_HERE = (
    "scenario",
    "rover",
    "changes",
    "model",
    "name",
    "runs",
    "seed",
    "courses",
    "tuning_courses",
    "oracle_courses",
)


@dataclass(frozen=True)
class Target(OfTask):
    """A scenario on which arms are compared."""

    task: dict
    trained_on: str = ""  # target that the arms are made on; empty: this one
    #: Content of the model.yaml of its world's effects; empty: none.
    model: dict = field(default_factory=dict)


@dataclass(frozen=True)
class World(OfWorld):
    """A named world that arms are made in."""

    model: dict = field(default_factory=dict)  # content of its model.yaml; empty: no effects


@dataclass(frozen=True)
class Arm(Checked):
    """A controller that is compared: an agent that is trained, a classical controller, or a
    class.
    """

    train: dict = field(default_factory=dict)  # keys of the training's config
    controller: str = ""  # a classical controller or module:Thing, in place of a training
    settings: dict = field(default_factory=dict)  # of a controller; empty: tuned, if it has some
    world: str = ""  # that it is made in; empty: that of its scenario


@dataclass(frozen=True)
class Study(Checked):
    """Configuration of a study."""

    targets: dict[str, Target]
    arms: dict[str, Arm]
    worlds: dict[str, World] = field(default_factory=dict)
    baseline: str = ""
    seeds: int = quantity("trainings of each agent on each scenario", 1, 1000, default=5)
    courses: int = quantity("held-out courses of each scenario", 2, 10**6, default=1000)
    held_out: int = quantity("seed of the set of those courses", 0, 2**31 - 1, default=HELD_OUT_SET)
    tuning_courses: int = quantity(
        "to tune classical controllers on; 0: do not tune", 0, 10**6, default=200
    )
    resamples: int = quantity("of the bootstrap", 10, 100_000, default=2000)
    version: str = field(default_factory=code_version)

    def _check_together(self) -> None:
        """ParameterError for a name that does not exist or cannot be part of the name of a file.

        The same for an arm that cannot be made on a scenario, and for held-out courses that
        controllers are tuned on. There is at least one arm, and one scenario to make it on.
        """
        sources = self.sources
        for name in (*self.targets, *self.arms):
            if wrong := re.search("[-/]", name) or NO_NAME.search(name):
                raise ParameterError(
                    f"{name!r}: expected the name of a scenario or an arm without {wrong[0]!r}"
                )
        for name, target in self.targets.items():
            if target.trained_on and target.trained_on not in sources:
                raise unknown_value(target.trained_on, sources, f"targets.{name}: trained_on")
        if self.tuning_courses and self.held_out == TUNING_SET:
            raise FieldError(
                self, "held_out", f" = {TUNING_SET}: controllers are tuned on this set"
            )
        if not sources or not self.arms:
            raise ParameterError("expected at least one scenario to train on and one arm")
        if self.baseline and self.baseline not in self.arms:
            raise unknown_value(self.baseline, self.arms, "baseline")
        for name, arm in self.arms.items():
            if arm.world and arm.world not in self.worlds:
                raise unknown_value(arm.world, self.worlds, f"arms.{name}: world")
            for source in sources:
                self._check(name, arm, self.targets[source].scenario)
                if not arm.controller:
                    self._check_compared(name, arm, source)

    def _check(self, name: str, arm: Arm, scenario: Scenario) -> None:
        """ParameterError where the arm `name` cannot be made on a scenario: for keys or settings
        that it cannot have, an unknown controller, or both `controller` and `train`.
        """
        if not arm.controller:
            for key in arm.train:
                if key in _SET_HERE:
                    raise ParameterError(
                        f"arms.{name}.train.{key}: the study sets it; expected another key"
                    )
            if arm.settings:
                raise ParameterError(
                    f"arms.{name}.settings: an agent has none: expected controller beside them"
                )
            load(TrainConfig, arm.train, f"arms.{name}.train")
            return
        if arm.train:
            raise ParameterError(f"arms.{name}: expected controller or train, not both")
        known, _ = controllers_of(scenario)
        if ":" in arm.controller:
            loading.load(
                Contestant(name, 0, "class", arm.controller, settings=arm.settings), scenario
            )
        elif arm.controller not in known:
            raise unknown_value(
                arm.controller, (*known, *SHIPPED, "module:Class"), f"arms.{name}: controller"
            )
        else:
            bounds = bounds_of_settings(arm.controller, scenario)
            where = f"arms.{name}.settings"
            within_bounds(arm.controller, bounds, scenario, arm.settings, where)

    def _check_compared(self, name: str, arm: Arm, source: str) -> None:
        """ParameterError where agents made on `source` cannot drive a target that they are compared
        on: for another kind of vehicle, other observations or other actions.
        """
        variant = arm.train.get("observation", TrainConfig.observation)

        def driven(scenario: Scenario | RoverScenario) -> tuple:
            """What an agent of the arm reads and does."""
            entries = [e.name for e in entries_of(scenario, variant)]
            control = scenario.control
            strength = control.rim_acceleration if control.action == "rim_acceleration" else 0.0
            return type(scenario), entries, control.action, control.duration, strength

        own = driven(self.targets[source].scenario)
        for target in self.fed_by(source):
            if driven(self.targets[target].scenario) != own:
                raise ParameterError(
                    f"targets.{target}: trained_on: {source!r} has other observations or actions: "
                    f"agents of arms.{name} cannot drive both"
                )

    def renewed(self, version: str) -> Study:
        """This study with the `version` of other code."""
        return dataclasses.replace(self, version=version)

    @property
    def sources(self) -> list[str]:
        """The targets that arms are made on."""
        return [name for name, target in self.targets.items() if not target.trained_on]

    @property
    def compared_with(self) -> str:
        """The arm that the table compares the others with."""
        return self.baseline or list(self.arms)[-1]

    def fed_by(self, source: str) -> list[str]:
        """The targets on which the arms made on `source` are compared."""
        return [
            name for name, target in self.targets.items() if (target.trained_on or name) == source
        ]

    def cells(self) -> list[Cell]:
        """All cells: the arms without a training, then seed by seed every agent on every
        scenario without `trained_on`.
        """
        sources = self.sources
        once = [Cell(s, a, 0) for s in sources for a, arm in self.arms.items() if arm.controller]
        agents = [name for name, arm in self.arms.items() if not arm.controller]
        return once + [
            Cell(s, a, seed) for seed in range(self.seeds) for s in sources for a in agents
        ]

    def training(self, cell: Cell, model: WheelSoilModel | None, runs: Path) -> TrainConfig:
        """Config of the training of a cell, in the world `model`, with its run folder in `runs`."""
        scenario = self.targets[cell.source].scenario
        task = {"rover" if isinstance(scenario, RoverScenario) else "scenario": scenario.name}
        content = model.content() if model else {}
        # The same for all arms; far from the next one, as wheel k of a training has seed + k.
        seed = 1_000_003 * (cell.seed + 1)
        own = {"model": content, "name": str(cell), "runs": str(runs), "seed": seed}
        return load(
            TrainConfig, {**self.arms[cell.arm].train, **task, **own}, f"arms.{cell.arm}.train"
        )


#: Keys of the file.
KEYS = (
    "scenarios",
    "controllers",
    "train",
    "changes",
    *(f.name for f in dataclasses.fields(Study) if f.name not in ("targets", "version")),
)


@dataclass(frozen=True)
class Cell:
    """One arm with one training seed, made on the scenario `source`."""

    source: str
    arm: str
    seed: int

    def __str__(self) -> str:
        """Name of the cell, also of its files."""
        return f"{self.source}-{self.arm}-{self.seed}"


def read_config(path: Path, changes: dict | None = None) -> Study:
    """The study of a YAML file with the mapping `changes` merged over it.

    The file's own key `changes` counts for every scenario, `train` for every arm that is trained.
    Each of `controllers`, all classical ones if left out, is an arm of its own name. A name of the
    shipped policy stands for its class, and a world's `model` for the content of that file.
    """
    content = merge(config_mapping(path), changes or {})
    for key in content:
        if key not in KEYS:
            raise unknown_key(key, KEYS, str(path))
    for key in ("scenarios", "arms", "worlds", "train", "changes"):
        if not isinstance(content.get(key) or {}, dict):
            raise ParameterError(f"{path}: {key} = {content[key]!r:.60}: expected a mapping")
    scenarios = content.pop("scenarios", None) or {}
    common = content.pop("changes", None) or {}
    targets = {name: _target(path, name, entry or {}, common) for name, entry in scenarios.items()}
    rovers = any("vehicle" in target["task"] for target in targets.values())
    listed = "controllers" in content
    chosen = content.pop("controllers", list(ROVER_CONTROLLERS if rovers else CONTROLLERS))
    if not isinstance(chosen, list) or not all(isinstance(name, str) for name in chosen):
        raise ParameterError(f"{path}: controllers = {chosen!r:.60}: expected a list of names")
    shared = content.pop("train", None) or {}
    own_arms = content.get("arms") or {}
    if twice := own_arms.keys() & (chosen if listed else ()):
        raise ParameterError(
            f"{path}: arms.{min(twice)}: expected another name: one of controllers has this one"
        )
    arms = {name: {"controller": name} for name in chosen} | own_arms
    for name, arm in arms.items():
        if isinstance(arm, dict) and "controller" not in arm:
            own = arm.get("train") or {}
            arms[name] = {**arm, "train": merge(shared, own) if isinstance(own, dict) else own}
        elif isinstance(arm, dict) and arm["controller"] in SHIPPED:
            arms[name] = {**arm, "controller": SHIPPED_CLASS}
    worlds = {name: entry or {} for name, entry in (content.get("worlds") or {}).items()}
    for name, entry in worlds.items():
        if isinstance(entry, dict) and isinstance(entry.get("model"), str):
            worlds[name] = {**entry, "model": _model(path, entry["model"])}
    try:
        return load(
            Study, {**content, "targets": targets, "arms": arms, "worlds": worlds}, str(path)
        )
    except ParameterError as error:  # in the words of the file
        raise ParameterError(
            str(error).replace(f"{path}: targets.", f"{path}: scenarios.", 1)
        ) from None


@dataclass(frozen=True)
class _Scenario(Checked):
    """Entry of `scenarios` in the file, from which a `Target` is made."""

    scenario: str = ""  # name or file; empty: that of the entry's name
    rover: str = ""  # the same of a rover, in place of a scenario
    changes: dict = field(default_factory=dict)  # merged over it
    trained_on: str = ""  # as in `Target`
    model: str = ""  # file of its world's effects


def _target(path: Path, name: str, entry, common: dict) -> dict:
    """The mapping of a `Target` of an entry of `scenarios` in the file `path`; `common`: changes of
    all scenarios.
    """
    where = f"{path}: scenarios.{name}"
    entry = load(_Scenario, entry, where)
    if entry.scenario and entry.rover:
        raise ParameterError(f"{where}: expected scenario or rover, not both")
    load_task, which = (
        (load_rover, entry.rover) if entry.rover else (load_scenario, entry.scenario or name)
    )
    try:
        load_task(which)  # for the errors of the file, apart from those of the changes
    except ParameterError as error:
        raise ParameterError(f"{where}: {error}") from None
    scenario = load_task(which, merge(common, entry.changes), f"{where}.changes")
    model = _model(path, entry.model, scenario) if entry.model else {}
    return {"task": to_dict(scenario), "trained_on": entry.trained_on, "model": model}


def _model(path: Path, name: str, scenario: Scenario | None = None) -> dict:
    """Content of a model.yaml that is named in a file: as seen from here, else from beside that
    file.

    Without a scenario, of a fitted model only the effects: what they leave belongs to its soil.
    ParameterError for a model without effects, with a soil, or of a wheel of another radius or
    width than that of the scenario.
    """
    file = Path(name) if Path(name).is_file() else path.parent / name
    model = WheelSoilModel.load(file)
    if scenario is None and model.soil is not None:
        model = WheelSoilModel(model.wheel, effects=model.effects, gravity=model.gravity)
    if not (model.effects or model.residual or model.remainder is not None):
        raise ParameterError(f"{file}: no effects; expected a world with at least one")
    if model.soil is not None:
        raise ParameterError(
            f"{file}: expected no soil: the courses have the soils of the scenario"
        )
    if scenario is not None:
        own = model.wheel
        wheel = scenario.wheel
        if (own.radius, own.width) != (wheel.radius, wheel.width):
            raise ParameterError(
                f"{file}: wheel of radius {own.radius:g} m and width {own.width:g} m: expected "
                f"that of scenario {scenario.name!r}, {wheel.radius:g} m and {wheel.width:g} m"
            )
    return model.content()
