"""Configuration and steps of a study; each step is kept in a file and skipped where that file exists.

study.yaml                       what was asked, resolved; another study may not go on in this folder
uncorrected/                     controllers tuned and PPO trained on the scenario without effects, for all worlds
  tuned.json  ppo_0/ ...  runs/
worlds/NAME/
  table.csv  setup.yaml          from the log of the commissioning drives in the hidden world
  discrepancy/                   report.json, report.html, model.yaml of `soil_env.discrepancy`
  corrected.yaml                 the effects found, for the soils of the scenario
  logs/K/                        the same of further logs, for what is found again
  corrected/                     as uncorrected/, on that model
  runs/                          both arms in the hidden world
"""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from soil_env._io.files import replace_file
from soil_env._io.loading import Checked, ParameterError, quantity
from soil_env.discrepancy import run as find_discrepancy
from soil_env.parameters import Scenario
from soil_env.terramechanics.model import WheelSoilModel

from .. import studies
from ..config import PPOConfig, TrainConfig
from ..controllers import make_controller
from ..evaluate import HELD_OUT_SET, run_courses
from ..evaluate.study import code_version
from ..evaluate.tuning import kept_settings
from ..progress import Bar
from . import drives, table
from .drives import Commissioning

CLASSICAL = ("soft_start", "best_slip_identified")
PPO = "ppo_identified"
CONTROLLERS = (*CLASSICAL, PPO)
UNCORRECTED, CORRECTED = ARMS = ("uncorrected", "corrected")
METRICS = ("immobilised", "finished", "return")


@dataclass(frozen=True)
class Study(Checked):
    """Configuration of a study."""

    scenario: Scenario
    worlds: dict = field(default_factory=dict)  # name -> content of its model.yaml
    seed: int = quantity("of the drives, the training and the bootstraps", 0, 2**31 - 1, default=0)
    timesteps: int = quantity("environment steps of each PPO training", 1, 10**12, default=3_000_000)
    logs: int = quantity("logs of each world; all but the first for what is found only", 1, 100, default=3)
    training_seeds: int = quantity("PPO trainings of each arm", 1, 100, default=2)
    courses: int = quantity("held-out courses", 2, 10**6, default=1000)
    tuning_courses: int = quantity("courses that the classical controllers are tuned on", 1, 10**6, default=100)
    bootstrap: int = quantity("of the intervals", 10, 10**5, default=1000)
    commissioning: Commissioning = Commissioning()
    ppo: PPOConfig = PPOConfig()
    version: str = field(default_factory=code_version)

    def world(self, name: str) -> WheelSoilModel:
        """The hidden world of that name."""
        return WheelSoilModel.from_content(self.worlds[name], name)


def read_worlds(paths: list[Path], scenario: Scenario) -> dict[str, dict]:
    """{name: content of model.yaml} of the hidden worlds; `ParameterError` for an unsuitable one."""
    out = {}
    for path in map(Path, paths):
        model, w = WheelSoilModel.load(path), scenario.wheel
        if not model.effects and not model.residual:
            raise ParameterError(f"{path}: no effects; expected a world with at least one that is hidden")
        if model.soil is not None:
            raise ParameterError(f"{path}: expected no soil: the courses have the soils of the scenario")
        if (model.wheel.radius, model.wheel.width) != (w.radius, w.width):
            raise ParameterError(
                f"{path}: wheel of radius {model.wheel.radius:g} m and width {model.wheel.width:g} m: expected that of "
                f"scenario {scenario.name!r}, {w.radius:g} m and {w.width:g} m"
            )
        if path.stem in out:
            raise ParameterError(f"{path}: a second world named {path.stem!r}; expected different file names")
        out[path.stem] = model.content()
    return out


def begin(study: Study, folder: Path) -> None:
    """Write study.yaml; ParameterError where the folder holds another study, or something else."""
    if not studies.is_begun(study, folder):
        studies.save_study(study, folder)


def run(study: Study, folder: Path, say: Callable[[str], None]) -> None:
    """Do the steps that are missing; `say` is called with a line for each."""
    folder = Path(folder)
    base = Arm(study, folder / UNCORRECTED, None)
    base.prepare()
    base.drive(base.folder / "runs", None, "on the simulation it was made on")
    for name in study.worlds:
        here, hidden = folder / "worlds" / name, study.world(name)
        for k in range(1, study.logs):
            correct(study, name, another_log(here, k), say, study.seed + k)
        found = correct(study, name, here, say, study.seed)
        say(f"{name}: uncorrected controllers in the hidden world")
        base.drive(here / "runs" / UNCORRECTED, hidden, f"in hidden world {name}")
        arm = corrected_arm(study, base, here, found)
        if arm is not base:
            say(f"{name}: controllers on the corrected model")
            arm.prepare()
            arm.drive(arm.folder / "runs", found, "on the simulation it was made on")
            arm.drive(here / "runs" / CORRECTED, hidden, f"in hidden world {name}")
            base.drive(here / "runs" / "foretold", found, "uncorrected controllers on the corrected model")


def another_log(here: Path, k: int) -> Path:
    """Folder of log `k` of a world: of other drives on another bed."""
    return here / "logs" / str(k)


def corrected_arm(study: Study, base: Arm, here: Path, found: WheelSoilModel) -> Arm:
    """The corrected arm of a world: the uncorrected one where nothing was found to be missing."""
    return Arm(study, here / CORRECTED, found) if found.effects else base


# --- from the log to the corrected model ------------------------------------------------------------------------------


def correct(study: Study, name: str, here: Path, say: Callable[[str], None], seed: int) -> WheelSoilModel:
    """Log, table, workflow; what was found as a model for the soils of the scenario, kept in corrected.yaml.

    Effects that are named, in part or among others too, keep their parameters. A law without a name belongs to the soil
    that it was fitted with, and is left behind: `carried.left` says what it would do on other soils.
    """
    data, setup, kept = here / "table.csv", here / "setup.yaml", here / "corrected.yaml"
    if kept.is_file():
        return WheelSoilModel.load(kept)
    here.mkdir(parents=True, exist_ok=True)
    plan, hidden = study.commissioning, study.world(name)
    if not setup.is_file():
        with Bar(f"Commissioning in {name}", drives.drives_in_all(plan), "drives") as bar:
            log = drives.drive_all(study.scenario, hidden, plan, seed,
                                   lambda count, note: bar.update(advance=count, note=note))  # fmt: skip
        points = table.steady_points(log, study.scenario, plan)
        content = table.setup(study.scenario, hidden.wheel, plan, points)
        table.write_table(points, data)
        table.write_setup(content, setup)
    say(f"{name}: discrepancy workflow")
    workflow = here / "discrepancy"
    for left in (workflow, *here.glob(".report-*")):  # by a run that was killed
        shutil.rmtree(left, ignore_errors=True)
    report = find_discrepancy(data, setup, workflow, seed=seed, progress=None)
    named = report.model.effects if report.effects else {}
    model = WheelSoilModel(hidden.wheel, None, named, (), report.model.gravity)
    model.save(kept)
    return model


# --- one arm ----------------------------------------------------------------------------------------------------------


@dataclass
class Arm:
    """Controllers made on one simulation: tuned and trained in `folder` on the scenario with `model`."""

    study: Study
    folder: Path
    model: WheelSoilModel | None

    def prepare(self) -> None:
        """Tune and train."""
        self._settings()
        for k in range(self.study.training_seeds):
            self._train(k)

    def _settings(self) -> dict:
        path, study = self.folder / "tuned.json", self.study  # anew: with as many trials in every arm
        return kept_settings(path, study.scenario, study.tuning_courses, CLASSICAL, None, self.model, anew=True)

    def _train(self, k: int) -> None:
        """Train PPO agent k, from its checkpoint where there is one."""
        study = self.study
        config = TrainConfig(
            scenario=study.scenario.name, name=f"ppo_{k}", runs=str(self.folder), seed=study.seed + k,
            model=self.model.content() if self.model else {}, timesteps=study.timesteps, ppo=study.ppo,
        )  # fmt: skip
        from .. import training  # needs the extra `train`, which --help does not

        training.trained(config, study.scenario)

    def members(self, name: str) -> list:
        """The controllers of that name."""
        if name == PPO:
            from ..agent import load_agent

            return [load_agent(self.folder / f"ppo_{k}") for k in range(self.study.training_seeds)]
        return [make_controller(name, self.study.scenario, **self._settings()[name])]

    def drive(self, to: Path, world: WheelSoilModel | None, title: str) -> None:
        """Drive every controller over the held-out courses in `world`; one file a controller in `to`."""
        to.mkdir(parents=True, exist_ok=True)
        missing = [name for name in CONTROLLERS if not (to / f"{name}.json").is_file()]
        if not missing:
            return
        study = self.study
        each = {name: study.training_seeds if name == PPO else 1 for name in missing}
        with Bar(f"Driving {title}", study.courses * sum(each.values()), "courses") as bar:
            for name in missing:
                runs = [
                    run_courses(member, study.scenario, HELD_OUT_SET, study.courses, model=world,
                                progress=lambda count, name=name: bar.update(advance=count, note=name))
                    for member in self.members(name)
                ]  # fmt: skip
                scores = {metric: [r.metric(metric).tolist() for r in runs] for metric in METRICS}
                replace_file(to / f"{name}.json", json.dumps(scores))


def scores(folder: Path, name: str) -> dict[str, np.ndarray]:
    """{metric: [members, courses]} of a controller."""
    content = json.loads((Path(folder) / f"{name}.json").read_text(encoding="utf-8"))
    return {metric: np.array(values) for metric, values in content.items()}
