"""Runs of the cases of the oracle (tests/oracle_cases.py), through the public interface: {quantity:
array or text}.
"""

import math
from pathlib import Path

import gymnasium
import numpy as np

from soil_env.parameters import Soil
from soil_env.terramechanics.model import WheelSoilModel

ROOT = Path(__file__).resolve().parent.parent
EVERY = 10  # control periods from sample to sample


def world(effects: dict, law=(), **soil) -> WheelSoilModel:
    """A wheel with lugs, effects and a residual law, on the soil if there is one."""
    wheel = {"radius": 0.15, "width": 0.12 if soil else 0.15, "grouser_height": 0.01}
    content = {"wheel": wheel, "effects": effects, "residual": list(law)}
    return WheelSoilModel.from_content(content | ({"soil": soil} if soil else {}))


def make(maker=gymnasium.make, gravity=9.81, **options):
    """The environment of the keyword arguments."""
    return maker(
        "soil_env:SoilWheel-v0",
        **{"action": "torque", "scenario": "mixed", "scaled": False} | options,
        gravity=gravity,
    )


def action(k: int, level: float) -> float:
    """A drive that swings about a level, now and then at full power, and now and then brakes."""
    if k % 71 >= 60:
        return 1.0
    return -0.3 if k % 97 >= 92 else level + 0.2 * math.sin(0.17 * k)


#: A constant; and probabilities by a network, whose weights are trained anew without a change of
#: any law.
_LEFT_OUT = ("torque_available", "immobilised_within")


def drive(level: float, steps: int = 252, seed: int = 3, env=None, **options) -> dict:
    """Observations and states of a vehicle every `EVERY` steps; it starts again where an episode
    ends.

    Each axle has its own command. The vehicle is the wheel of the keyword arguments, or that of
    `env`.
    """
    rover = env is not None
    env = env if rover else make(disable_env_checker=True, info="full", **options)
    observation, info = env.reset(seed=seed)
    out = {"period": [], "observation": [], "return": []}
    total = 0.0
    ends = []
    for k in range(steps):
        commands = [action(k + 3 * axle, level) for axle in range(env.action_space.shape[0])]
        observation, reward, terminated, truncated, info = env.step(np.array(commands))
        total += reward
        over = terminated or truncated
        if k % EVERY == EVERY - 1 or over or k == steps - 1:
            out["period"].append(float(k))
            out["observation"].append(observation)
            out["return"].append(total)
            for group in (
                ("state",) if rover else ("state", "reward_terms", "estimate", "traversability")
            ):
                for name, value in info[group].items():
                    if isinstance(value, float) and not name.startswith(_LEFT_OUT):
                        out.setdefault(f"{group}.{name}", []).append(value)
        if over:
            ends.append(f"{k} {info['cause']}")
            env.reset()
    return {"ends": ", ".join(ends)} | {name: np.array(values) for name, values in out.items()}


def drive_rover(**options) -> dict:
    """The same of a rover."""
    return drive(0.45, 200, env=gymnasium.make("SoilRover-v0", disable_env_checker=True, **options))


def drive_many(count: int, steps: int = 200, **options) -> dict:
    """The same of several wheels at once, each at a level of its own; the wheels end and start
    again.
    """
    env = make(
        gymnasium.make_vec, num_envs=count, vectorization_mode="vector_entry_point", **options
    )
    observation, info = env.reset(seed=5)
    out = {"period": [], "observation": [], "return": [], "x": []}
    total = np.zeros(count)
    over = np.zeros(count, bool)
    ends = []
    for k in range(steps):
        if options.get("autoreset_mode") == "Disabled" and over.any():
            env.reset(options={"reset_mask": over})
        levels = np.array([[action(k + 7 * j, 0.2 + 0.06 * j)] for j in range(count)])
        observation, reward, terminated, truncated, info = env.step(levels)
        total = total + reward
        over = terminated | truncated
        # In SameStep mode `info` is of after the reset.
        cause = info.get("final_info", info)["cause"]
        ends += [f"{k} {j} {cause[j]}" for j in np.flatnonzero(over)]
        if k % 25 == 24:
            for name, value in zip(out, (float(k), observation, total, info["x"]), strict=True):
                out[name].append(value.copy() if isinstance(value, np.ndarray) else value)
    return {"ends": ", ".join(ends)} | {name: np.array(values) for name, values in out.items()}


def predict(models: dict, count: int = 20) -> dict:
    """Steady sinkage, drawbar pull and torque at conditions of every kind."""
    rng = np.random.default_rng(11)
    slip = np.concatenate(
        [[-1.0, -0.3, 0.0, 0.02, 0.3, 0.97, 1.0], rng.uniform(-0.2, 0.9, count - 7)]
    )
    conditions = {
        "slip": slip,
        "load": rng.uniform(60, 250, count),
        "speed": rng.uniform(0.01, 0.6, count),
        "pass": rng.integers(1, 5, count),
        "grade_deg": rng.uniform(-15, 15, count),
    }
    out = {}
    for name, model in models.items():
        values = model.predict(conditions)
        out |= {
            f"{name}.{part}": getattr(values, part)
            for part in ("sinkage", "drawbar_pull", "torque")
        }
        out[f"{name}.floating"] = str(values.supported)
    return out


SOIL = {
    "friction_angle_deg": 31,
    "cohesion": 3500,
    "shear_modulus": 0.028,
    "sinkage_coefficient": 740000,
    "sinkage_exponent": 0.64,
    "dig_gain": 0,
    "density": 1600,
}
SOFT = {
    "friction_angle_deg": 36,
    "cohesion": 200,
    "shear_modulus": 0.012,
    "sinkage_coefficient": 1300000,
    "sinkage_exponent": 1.05,
    "dig_gain": 1.5,
}


def identify(csv: str, setup: str) -> dict:
    """The soil of a table: values with intervals, covariance, fits."""
    from soil_env.identification.table import identify_table
    from soil_env.measurement import read_setup, read_table

    read = read_setup(ROOT / setup)
    found = identify_table(read_table(ROOT / csv, read.wheel), read)
    out = {
        name: np.array([p.value, p.low, p.high, p.sd_over_prior])
        for name, p in found.parameters.items()
    }
    out |= {f"fitted.{name}": np.array([*f.fitted, f.noise]) for name, f in found.fits.items()}
    out |= {"covariance": found.covariance, "condition": np.array([found.condition])}
    return out | {"free": ", ".join(found.free), "converged": str(found.converged)}


def soil_content(soil: Soil) -> dict:
    """The soil as the mapping of a model.yaml."""
    return {k: v for k, v in vars(soil).items() if v is not None and k != "source"}
