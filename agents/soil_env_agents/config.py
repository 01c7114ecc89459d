"""Configuration of a training: the keys of train.py's YAML file and command line.

Needs no torch.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field
from functools import cached_property
from typing import Literal

from soil_env._io.loading import Checked, FieldError, load, quantity
from soil_env.parameters import DEFAULT_SCENARIO, RoverScenario, Scenario
from soil_env.terramechanics.model import WheelSoilModel

#: Name of the agent of each observation variant in tables and files.
NAMES = {"blind": "agent_blind", "identified": "agent_identified", "true_soil": "agent_true"}


#: What a name cannot have where lists of controllers are to read it as it is.
NO_NAME = re.compile(r"[,=:*?\[\]\x00-\x1f]|^\s|\s$")


def _text(default: str, doc: str):
    """A dataclass field of text, with its default and its line in the help (`doc`)."""
    return field(default=default, metadata={"doc": doc})


@dataclass(frozen=True)
class PPOConfig(Checked):
    """Hyperparameters of PPO (Schulman et al. 2017), in SB3's terms.

    The learning rate falls linearly to 5 %.

    docs/guide/training.md says how these defaults were chosen.
    """

    num_envs: int = quantity("", 1, 65536, default=256, doc="wheels stepped together")
    n_steps: int = quantity("", 8, 65536, default=256, doc="steps of each wheel per update")
    batch_size: int = quantity("", 8, 1_000_000, default=8192, doc="transitions per gradient step")
    n_epochs: int = quantity("", 1, 100, default=3, doc="passes over a rollout")
    learning_rate: float = quantity(
        "", 1e-7, 1.0, default=1e-3, doc="learning rate of Adam at the start"
    )
    gamma: float = quantity("", 0.5, 1.0, default=0.999, doc="discount an action")
    gae_lambda: float = quantity(
        "", 0.0, 1.0, default=0.95, doc="bias against variance of the advantages"
    )
    clip_range: float = quantity(
        "", 0.01, 1.0, default=0.2, doc="largest change of a probability ratio in an update"
    )
    ent_coef: float = quantity("", 0.0, 1.0, default=0.0, doc="weight of the entropy")
    layer: int = quantity("", 1, 4096, default=64, doc="units in each of two hidden layers")
    activation: Literal["relu", "tanh"] = _text(
        "relu", "activation of the hidden layers: relu or tanh"
    )
    log_std_init: float = quantity(
        "", -5.0, 2.0, default=-1.4, doc="log of the initial standard deviation"
    )
    log_std_final: float | None = quantity(
        "", -5.0, 2.0, default=-2.8, doc="the same at the end; empty: learned"
    )
    initial_action: float = quantity(
        "", -1.0, 1.0, default=0.3, doc="mean action of the untrained policy"
    )
    history: int = quantity(
        "", 0, 1000, default=7, doc="past steps whose readings the network sees (history.py)"
    )
    threads: int = quantity(
        "", 1, 256, default=2, doc="threads of the environment; the result is the same"
    )

    def _check_together(self) -> None:
        """FieldError where a rollout of num_envs x n_steps is not a whole number of batches."""
        rollout = self.num_envs * self.n_steps
        if rollout % self.batch_size:
            problem = f" = {self.batch_size}: expected a divisor of num_envs x n_steps = {rollout}"
            raise FieldError(self, "batch_size", problem)


def check_oracle(config: Checked, driven: int | None, courses: int) -> None:
    """FieldError of a `config` if the oracle is to drive more courses (`driven`) than are compared
    (`courses`).
    """
    if (driven or 0) > courses:
        problem = f" = {driven}: expected at most {courses}, the courses compared"
        raise FieldError(config, "oracle_courses", problem)


class OfWorld(Checked):
    """Base of a configuration with `model`, the content of the model.yaml of its world's effects;
    empty = none.
    """

    model: dict

    @property
    def world(self) -> WheelSoilModel | None:
        """The model of the world's effects."""
        return WheelSoilModel.from_content(self.model, "model") if self.model else None


def task_of(content: dict) -> Scenario | RoverScenario:
    """The scenario in the content of its file, that of a rover if it has a `vehicle`."""
    return load(RoverScenario if "vehicle" in content else Scenario, content, "scenario")


class OfTask(OfWorld):
    """Base of a configuration with `task`, the content of a scenario or of a rover's."""

    task: dict

    @cached_property
    def scenario(self) -> Scenario | RoverScenario:
        """The scenario, of a wheel or of a rover."""
        return task_of(self.task)


@dataclass(frozen=True)
class TrainConfig(OfWorld):
    """A training run: the keys of its YAML file and of the command line."""

    scenario: str = _text(
        "", f"a scenario of configs/scenarios, or a YAML file; empty: {DEFAULT_SCENARIO}"
    )
    rover: str = _text("", "a rover of configs/rovers, or a YAML file, in place of a scenario")
    changes: dict = field(default_factory=dict)  # merged over the scenario
    model: dict = field(
        default_factory=dict,
        metadata={"doc": "model.yaml with the effects that are on in the world"},
    )
    observation: Literal["blind", "identified", "true_soil"] = _text(
        "identified", "blind, identified or true_soil"
    )
    hidden_worlds: int = quantity(
        "", 0, 1000, default=0, doc="worlds with a hidden effect, mixed into the training"
    )
    name: str = _text("", "name of the run folder; empty: observation, scenario and time")
    runs: str = _text("runs", "folder of the run folders")
    seed: int = quantity("", 0, 2**31 - 1, default=0, doc="seed of the training")
    timesteps: int = quantity(
        "", 1, 10**12, default=4_000_000, doc="environment steps, in whole rollouts"
    )
    student: float = quantity(
        "", 0.0, 1.0, default=0.225, doc="share of them as a student of best_slip_true, then PPO"
    )
    teacher_penalty: float = quantity(
        "", 0.0, 100.0, default=0.02, doc="of a student for leaving the teacher, at first"
    )
    checkpoint_every: int = quantity(
        "", 1, 10**12, default=500_000, doc="environment steps between checkpoints"
    )
    courses: int = quantity("", 1, 100_000, default=1000, doc="held-out courses of the comparison")
    tuning_courses: int = quantity(
        "", 0, 10**6, default=200, doc="to tune classical controllers on; 0: do not tune"
    )
    oracle_courses: int | None = quantity(
        "", 0, 10**6, default=None, doc="of them that the oracle drives too; empty: 50, no rover"
    )
    ppo: PPOConfig = PPOConfig()

    def _check_together(self) -> None:
        """Fill in the scenario, and for None the oracle's courses: 50, or all that are compared if
        these are fewer, and none of a rover.

        FieldError for a scenario or courses of the oracle beside a rover, and for more courses of
        the oracle than are compared. The same where the hidden worlds leave no wheel for the world
        without an effect.
        """
        beside = f"expected none beside rover = {self.rover!r}"
        if self.rover and self.scenario:
            raise FieldError(
                self, "scenario", f" = {self.scenario!r}: {beside}: the rover's file has its own"
            )
        if self.rover and self.oracle_courses:
            raise FieldError(
                self,
                "oracle_courses",
                f" = {self.oracle_courses!r}: {beside}: the oracle drives a wheel",
            )
        if not self.rover and not self.scenario:
            object.__setattr__(self, "scenario", DEFAULT_SCENARIO)
        if self.oracle_courses is None:
            object.__setattr__(self, "oracle_courses", 0 if self.rover else min(50, self.courses))
        check_oracle(self, self.oracle_courses, self.courses)
        if self.hidden_worlds >= self.ppo.num_envs:
            raise FieldError(
                self,
                "hidden_worlds",
                f" = {self.hidden_worlds}: expected fewer than ppo.num_envs wheels",
            )


def load_config(mapping: dict, where: str) -> TrainConfig:
    """A `TrainConfig` from a mapping; ParameterError as from `load`, beginning with the place
    `where`, or with the file that is wrong.

    `model` may be the path of a file, whose content then takes its place.
    """
    model = mapping.get("model")
    if isinstance(model, str):
        mapping = {**mapping, "model": WheelSoilModel.load(model).content()}
    elif isinstance(model, dict) and model:
        WheelSoilModel.from_content(model, f"{where}: model")  # for its errors only
    return load(TrainConfig, mapping, where)
