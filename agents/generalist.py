"""Training of the default policy: one student of the true-soil rule on several grounds, then PPO from there.

    python -m soil_env_agents.generalist --out agents/default_policy.npz

The grounds of configs/default_policy.yaml stand side by side, half of the wheels of each in worlds with hidden effects.
"""

import io
import json
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path

import click
import numpy as np
from stable_baselines3 import PPO

import soil_env
from soil_env._io.files import replace_file
from soil_env._io.loading import Checked, config_dir, load, quantity, read_yaml, to_dict, unknown_value
from soil_env.cli.running import PATH, run
from soil_env.parameters import load_scenario

from . import common_layout, default_policy, ppo, student
from .config import PPOConfig
from .environment import HIDDEN, CommonVecEnv, hidden_worlds, side_by_side
from .progress import Bar, show
from .teachers import settings_of

CONFIG = "default_policy.yaml"
SOFTENING = "shear_softening"  # effect whose worlds have a more careful teacher


@dataclass(frozen=True)
class OnGround(Checked):
    """One ground of the training: a scenario with changes, and its number of wheels."""

    wheels: int = quantity("", 2, 65536)
    scenario: str = field(default="", metadata={"doc": "empty: that of the ground's name"})
    changes: dict = field(default_factory=dict)
    hidden: float = quantity("share of the wheels that are in worlds with a hidden effect", 0.1, 0.9, default=0.5)
    plain: float = quantity("factor on the teacher's acceleration in worlds without softening", 0.01, 1.0, default=1.0)
    careful: float = quantity("the same with softening", 0.01, 1.0, default=0.3)


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
    cut: float = quantity("of the prior of their sizes [standard deviations]", 0.1, 3.0, default=1.0)
    ppo: PPOConfig = PPOConfig()  # but for its num_envs

    def __post_init__(self):
        super().__post_init__()
        for name in self.effects:
            if name not in HIDDEN:
                raise unknown_value(name, HIDDEN, "effects")

    def build(self, progress: Callable[[int], None] = lambda _: None) -> PPO:
        """The untrained agent in the vector environment of all grounds.

        The teacher knows the true soil but no effect. In worlds with shear softening it starts with more care.
        """
        parts = []
        for k, (name, own) in enumerate(self.grounds.items()):
            scenario = load_scenario(own.scenario or name, own.changes)
            hidden = hidden_worlds(scenario, self.hidden, self.seed + k, self.effects, self.cut)
            some = round(own.hidden * own.wheels) if hidden else 0
            shares = own.wheels - some, *np.diff(np.linspace(0, some, len(hidden) + 1).astype(int)).tolist()
            usual = settings_of(scenario)["acceleration"]
            for share, world in zip(shares, [None, *hidden], strict=True):
                softening = world is not None and SOFTENING in world.effects
                teacher = {"acceleration": usual * (own.careful if softening else own.plain)}
                parts.append(CommonVecEnv(share, scenario, teacher, threads=self.ppo.threads, model=world))
            progress(k + 1)
        return ppo.learner(side_by_side(parts, self.ppo, self.seed), self.ppo, self.seed)


def arrays(model: PPO, history: int, made: dict) -> dict[str, np.ndarray]:
    """The content of the weights' file of a trained model."""
    env, policy = model.get_vec_normalize_env(), model.policy
    own = policy.mlp_extractor
    modules = [own.policy_net[0], own.policy_net[2], own.line_net[0], own.line_net[2], policy.action_net]
    out = {"mean": env.obs_rms.mean, "sd": np.sqrt(env.obs_rms.var + env.epsilon)}
    for name, module in zip(default_policy.LAYERS, modules, strict=True):
        out[f"{name}_weight"], out[f"{name}_bias"] = (x.detach().numpy() for x in (module.weight, module.bias))
    made = {"observation_names": list(common_layout.NAMES), "history": history, **made}
    return {name: np.asarray(x, dtype=np.float32) for name, x in out.items()} | {"made": np.array(json.dumps(made))}


@click.command()
@click.option("--config", type=PATH, default=None, metavar="YAML", help="Default: the shipped one.")
@click.option("--out", type=PATH, required=True, metavar="FILE", help="The weights, .npz.")
def command(config: Path | None, out: Path) -> None:
    """Train the default policy."""
    path = config or config_dir() / CONFIG
    asked = load(Generalist, read_yaml(path), str(path))
    with Bar("Teachers", len(asked.grounds), "grounds") as bar:
        model = asked.build(bar.update)
    with Bar("Student", asked.taught, "steps") as bar:
        student.teach(model, asked.taught, asked.seed, bar.update, asked.kept)
    with Bar("PPO", asked.improved, "steps") as bar:
        if asked.improved:
            model.learn(asked.improved, callback=lambda *_: bar.update(model.num_timesteps) or True)
    stream, made = io.BytesIO(), {"soil_env": soil_env.__version__, "config": to_dict(asked)}
    np.savez_compressed(stream, **arrays(model, asked.ppo.history, made))
    replace_file(out, stream.getvalue())
    show(f"Written: {out} ({len(stream.getvalue()) / 1024:.0f} KiB)")


if __name__ == "__main__":
    raise SystemExit(run(command, None, "generalist"))
