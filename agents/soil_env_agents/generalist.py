"""Training of the default policy: one student of the true-soil rule on several grounds, then PPO
from there.

    python -m soil_env_agents.generalist --out agents/soil_env_agents/default_policy.npz

The grounds of configs/default_policy.yaml stand side by side, half of the wheels of each in worlds
with hidden effects. Teachers that are chosen, and checkpoints of PPO, are kept in the folder
NAME.teachers beside the weights NAME.npz. A training that is started again goes on from there.
"""

import io
import itertools
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product
from pathlib import Path
from typing import Any

import click
import numpy as np
from stable_baselines3 import PPO

import soil_env
from soil_env._io.files import check_outputs, make_folder, replace_file
from soil_env._io.loading import (
    Checked,
    FieldError,
    ParameterError,
    config_dir,
    load,
    quantity,
    read_yaml,
    to_dict,
    unknown_value,
)
from soil_env.cli.running import PATH, run
from soil_env.parameters import Scenario, load_scenario
from soil_env.simulation.task import VERSION
from soil_env.terramechanics.model import WheelSoilModel

from . import common_layout, default_policy, ppo, student
from .agent import INFO, Info, read_mapping
from .cells import Engine, choose, code_version, digest_of, fill, in_process, read_cell
from .choice import Chooser
from .config import PPOConfig
from .environment import HIDDEN, CommonVecEnv, even_shares, hidden_worlds, side_by_side
from .evaluate.driving import run_courses
from .progress import Bar, show
from .teachers import Teacher, teacher_settings
from .training import CHECKPOINT, Watch, improve

CONFIG = "default_policy.yaml"
# Settings that `chosen` tries.
ACCELERATIONS = (1.0, 0.55, 0.3)  # factors of the teacher's acceleration
SHARES = (1.0, 0.6, 1.6)  # factors of its share of the best slip
SOFT_START = {"start": 1.0, "acceleration": 0.07}  # beside them, without a limit of the slip
#: Rounds of `chosen` in one world: courses of each setting, and settings that are left after it.
ROUNDS = ((50, 3), (200, 2), (300, 1))
OF_GROUND = ((40, 3), (60, 1))  # the same for all worlds of a ground
CHECKPOINT_EVERY = 500_000  # steps of PPO
TEACHING_SET = 5_000_011  # course set of these rounds (`evaluate.driving.course_rng`)


@dataclass(frozen=True)
class OnGround(Checked):
    """One ground of the training: a scenario with changes, and its number of wheels."""

    wheels: int = quantity("", 2, 65536)
    scenario: str = field(default="", metadata={"doc": "empty: that of the ground's name"})
    changes: dict = field(default_factory=dict)
    hidden: float = quantity(
        "share of the wheels that are in worlds with a hidden effect", 0.1, 0.9, default=0.5
    )


@dataclass(frozen=True)
class Generalist(Checked):
    """Content of configs/default_policy.yaml."""

    grounds: dict[str, OnGround]
    seed: int = quantity("", 0, 2**31 - 1, default=0)
    taught: int = quantity("steps as a student", 1, 10**12, default=3_000_000)
    kept: int = quantity("newest steps that the student learns from", 1, 10**9, default=2_000_000)
    improved: int = quantity("steps of PPO after that", 0, 10**12, default=0)
    hidden: int = quantity("worlds with a hidden effect on each ground", 0, 1000, default=6)
    effects: tuple[str, ...] = HIDDEN  # of these worlds, in turn
    ppo: PPOConfig = PPOConfig()  # but for its num_envs

    def _check_together(self) -> None:
        """ParameterError for what would fail, or be another policy, after hours of training.

        That is an effect that is none of `HIDDEN`, no ground or effect, a world without a wheel,
        and a network that `DefaultPolicy` does not have.
        """
        for name in self.effects:
            if name not in HIDDEN:
                raise unknown_value(name, HIDDEN, "effects")
        if not self.grounds:
            raise FieldError(self, "grounds", ": is empty: expected at least one")
        if self.hidden and not self.effects:
            raise FieldError(self, "effects", ": is empty: expected one of the hidden worlds")
        for name, own in self.grounds.items():
            in_hidden = round(own.hidden * own.wheels)
            if self.hidden and not self.hidden <= in_hidden < own.wheels:
                raise ParameterError(
                    f"grounds.{name}: {in_hidden} of {own.wheels} wheels in {self.hidden} hidden "
                    "worlds: expected one at least in each world"
                )
        if self.ppo.activation != "relu":
            raise ParameterError(f"ppo.activation = {self.ppo.activation!r}: expected 'relu'")
        if not self.ppo.history:
            raise ParameterError("ppo.history = 0: expected past steps, which the policy reads")

    def ground(self, name: str) -> tuple[Scenario, list[WheelSoilModel]]:
        """The scenario of a ground and its worlds with a hidden effect."""
        own = self.grounds[name]
        scenario = load_scenario(own.scenario or name, own.changes)
        seed = self.seed + list(self.grounds).index(name)
        return scenario, hidden_worlds(scenario, self.hidden, seed, self.effects)

    def teacher(self, cell: str, threads: int | None) -> dict[str, float]:
        """Settings of the teacher (`teachers.SETTINGS`) for a `cell` "GROUND/WORLD"; WORLD is 0 for
        that without an effect, from 1 for the hidden ones.

        Each hidden world has the teacher that does best in it. The world without an effect has the
        one that does best in all worlds of the ground, since at the start of a course the student
        cannot distinguish them. Without hidden worlds the settings are the ground's own.
        """
        name, number = cell.rsplit("/", 1)
        world = int(number)
        scenario, hidden = self.ground(name)
        own = teacher_settings(scenario)
        if world:
            return chosen(scenario, own, [hidden[world - 1]], ROUNDS, threads)
        if not hidden:
            return own
        # The world without an effect counts as much as all hidden ones together.
        return chosen(scenario, own, [*[None] * len(hidden), *hidden], OF_GROUND, threads)

    def build(
        self,
        folder: Path,
        progress: Callable[[int], None] = lambda _: None,
        engine: Engine = in_process,
    ) -> PPO:
        """The untrained agent in the vector environment of all grounds.

        The engine chooses the teachers that are not in `folder`, which keeps them; `progress`
        receives the number of those that are chosen.
        """
        numbers = itertools.count(1)
        made_from = self.made_from()
        fill(
            partial(self.teacher, threads=None if engine is in_process else 1),
            self.cells(),
            folder,
            engine,
            progress=lambda _: progress(next(numbers)),
            needs=lambda _: made_from,
        )
        parts = []
        for name, own in self.grounds.items():
            scenario, hidden = self.ground(name)
            in_hidden = round(own.hidden * own.wheels) if hidden else 0
            # Wheels in the world without an effect, then in each hidden one.
            shares = (own.wheels - in_hidden, *even_shares(in_hidden, len(hidden)))
            for k, (share, world) in enumerate(zip(shares, [None, *hidden], strict=True)):
                part = CommonVecEnv(
                    share,
                    scenario,
                    read_cell(folder, f"{name}/{k}", dict),
                    threads=self.ppo.threads,
                    model=world,
                    scatter=world is not None,
                )
                parts.append(part)
        model = ppo.learner(side_by_side(parts, self.ppo, self.seed), self.ppo, self.seed)
        model.origin = {"observation": "identified", "ppo": to_dict(self.ppo)}
        return model

    def made_from(self) -> dict[str, Any]:
        """What teachers and checkpoints depend on; those of another training are not used."""
        return {"training": to_dict(self), "code": code_version()}

    def cells(self) -> list[str]:
        """All "GROUND/WORLD" that have a teacher; those that take longest to choose first, so that
        the processes end together.
        """
        return [f"{name}/{k}" for k in range(self.hidden + 1) for name in self.grounds]


def chosen(
    scenario: Scenario,
    own: dict[str, float],
    worlds: Sequence[WheelSoilModel | None],
    rounds: Sequence[tuple[int, int]],
    threads: int | None = None,
) -> dict[str, float]:
    """Settings of the teacher with the highest mean return in `worlds`, after `rounds` of (courses
    in each world, settings left).

    Tried are `ACCELERATIONS` x `SHARES` times the settings `own`, and `own` with `SOFT_START`. The
    better ones of each round drive other courses in the next (successive halving: Jamieson &
    Talwalkar 2016, AISTATS). All settings drive the same courses, of the set `TEACHING_SET`.
    """
    first = 0  # course of a round; every world of it has courses of its own
    tried = [
        own | {"acceleration": a * own["acceleration"], "share": b * own["share"]}
        for a, b in product(ACCELERATIONS, SHARES)
    ]
    tried.append(own | SOFT_START)
    for courses, left in rounds:
        earned = np.zeros(len(tried))
        for world in worlds:
            for k, settings in enumerate(tried):
                teacher = Teacher(scenario, **settings)
                driven = range(first, first + courses)
                runs = run_courses(teacher, scenario, TEACHING_SET, driven, world, threads)
                earned[k] += runs.returns.mean()
            first += courses
        tried = [tried[k] for k in np.argsort(earned)[::-1][:left]]
    return tried[0]


def weights_of(model: PPO, history: int, made: dict) -> dict[str, np.ndarray]:
    """The content of the weights' file of a trained model, {name: array}; `made` says how it was
    trained, `history` is the number of past steps that it sees.

    `mean` and `sd` [D] of the input, and weight and bias of each of `default_policy.LAYERS`, are
    float32; `made` is a JSON text.
    """
    env = model.get_vec_normalize_env()
    policy = model.policy
    modules = [  # linear layers, every other of which is an activation
        *policy.mlp_extractor.policy_net[::2],
        policy.action_net,
    ]
    out = {"mean": env.obs_rms.mean, "sd": np.sqrt(env.obs_rms.var + env.epsilon)}
    for name, module in zip(default_policy.LAYERS, modules, strict=True):
        out[f"{name}_weight"], out[f"{name}_bias"] = (
            x.detach().numpy() for x in (module.weight, module.bias)
        )
    layout = {"observation_names": list(common_layout.NAMES), "observation_version": VERSION}
    made = {**layout, "history": history, **made}
    return {name: np.asarray(x, dtype=np.float32) for name, x in out.items()} | {
        "made": np.array(json.dumps(made))
    }


def learn(model: PPO, asked: Generalist, folder: Path) -> None:
    """Train an untrained `model` of `Generalist.build` as a student, then by PPO.

    A checkpoint is saved in `folder` after the student and during PPO. Where there is one already
    PPO goes on from it, with another random stream.
    """
    checkpoint = folder / CHECKPOINT
    if checkpoint.is_file():
        info = load(Info, read_mapping(checkpoint, INFO) or {}, str(checkpoint))
        ppo.restore(model, checkpoint, info)
        show(f"Resuming PPO at {model.num_timesteps:,} of {asked.improved:,} steps.")
    else:
        with Bar("Student", asked.taught, "steps") as bar:
            student.teach(model, asked.taught, asked.seed, bar.update, asked.kept)
        model.num_timesteps = 0  # of PPO
        ppo.save(model, checkpoint)
    begun = model.num_timesteps
    with Bar("PPO", asked.improved, "steps", begun) as bar:
        if begun < asked.improved:
            schedules = ppo.Schedules(asked.ppo)  # of learning rate and others
            # Learns from choices of the route; 13: a random stream of its own.
            rng = np.random.default_rng([asked.seed, 13, begun] if begun else [asked.seed, 13])
            watch = Watch(folder, CHECKPOINT_EVERY, bar)
            improve(model, asked.improved - begun, [schedules, Chooser(model, rng)], watch)


@click.command()
@click.option("--config", type=PATH, metavar="YAML", help="Default: the shipped one.")
@click.option("--out", type=PATH, required=True, metavar="FILE", help="The weights, .npz.")
@click.option("--workers", type=int, metavar="N", help="Processes that choose teachers.")
def command(config: Path | None, out: Path, workers: int | None) -> None:
    """Train the default policy.

    Teachers are chosen, one for each ground and world, and kept beside the weights. A student
    learns from them, goes on with PPO if `improved` is above 0, and its weights are written.
    """
    if out.suffix != ".npz":
        raise ParameterError(f"--out {out}: expected a file NAME.npz")
    make_folder(out.parent)
    check_outputs(out.parent, (out.name,))
    path = config or config_dir() / CONFIG
    asked = load(Generalist, read_yaml(path), str(path))
    engine = choose("local", workers)
    kept = out.with_suffix(".teachers")
    with Bar("Teachers", len(asked.cells()), "teachers") as bar:
        model = asked.build(kept, bar.update, engine)
    folder = kept / digest_of(asked.made_from())
    make_folder(folder)
    learn(model, asked, folder)
    stream = io.BytesIO()
    made = {"soil_env": soil_env.__version__, "config": to_dict(asked)}
    stored: dict[str, Any] = weights_of(model, asked.ppo.history, made)
    np.savez_compressed(stream, **stored)
    replace_file(out, stream.getvalue())
    (folder / CHECKPOINT).unlink()
    show(f"Written: {out} ({len(stream.getvalue()) / 1024:.0f} KiB)")


if __name__ == "__main__":
    raise SystemExit(run(command, None, "generalist"))
