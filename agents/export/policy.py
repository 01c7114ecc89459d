"""The ONNX model of an agent, its description, and the proof that both act alike."""

from __future__ import annotations

import io
import json
import platform
import time
from importlib import metadata
from pathlib import Path

import numpy as np

import soil_env
from soil_env._io.files import plain, replace_file
from soil_env._io.loading import ParameterError, to_dict
from soil_env.env import action_space, observation_space
from soil_env.parameters import Scenario
from soil_env.simulation.task import layout
from soil_env.terramechanics.model import WheelSoilModel

from ..evaluate.driving import HELD_OUT_SET, drive
from ..exported import FORMAT, ExportedAgent
from .graph import OPSET, Graph, Traced
from .guide import GuideGraph
from .network import action_of, memory_sizes

TOLERANCE = 1e-5  # of the action, between the agent and its export
_FORGETTABLE = 1e-8  # what VecNormalize adds to the variance, and agents.ppo too


def onnx_model(agent, description: dict):
    """The ONNX model of a loaded agent (`agents.evaluate.models.load_model`), `description` inside.

    Inputs: `observation` [n, D] float32, raw; for agents with hidden states `new_course` [n] bool and the states.
    Outputs: `action` [n, 1] float32 in [-1, 1], and `next_NAME` of each state. ParameterError for a network that has
    no such form.
    """
    if agent.model.action_space != action_space():
        raise ParameterError(f"action space {agent.model.action_space}: expected {action_space()}")
    graph, policy = Graph(), agent.model.policy
    seen = graph.input("observation", "float32")
    fresh = graph.input("new_course", "bool")
    guide = None if getattr(agent, "guide", None) is None else GuideGraph(graph, agent.guide)
    sizes = {name: (size, "float32") for name, size in memory_sizes(policy).items()}
    sizes |= {} if guide is None else {name: (size, "float64") for name, size in guide.sizes.items()}
    memory = {name: graph.input(name, dtype) for name, (_, dtype) in sizes.items()}
    raw = seen if guide is None else guide.observe(seen, memory, fresh)
    action, kept = action_of(graph, policy, _normalised(raw, agent), memory, fresh)
    action = np.clip(action, -1.0, 1.0)
    if guide is not None:
        action = guide.act(action)
        kept |= guide.kept()
    batch, shape = "n", {name: ["n", size] if size else ["n"] for name, (size, _) in sizes.items()}
    inputs = [graph.info(seen, [batch, observation_space(agent.variant).shape[0]])]
    inputs += [graph.info(fresh, [batch])] if sizes else []
    inputs += [graph.info(memory[name], shape[name]) for name in sizes]
    outputs = [graph.info(_named(graph, action, "action"), [batch, 1])]
    outputs += [graph.info(_named(graph, kept[name], f"next_{name}"), shape[name]) for name in sizes]
    return graph.model(inputs, outputs, {"policy": json.dumps(plain(description))})


def _named(graph: Graph, x: Traced, name: str) -> Traced:
    return graph.node("Identity", x, outputs=[name], dtype=x.dtype)


def _normalised(x: Traced, agent) -> Traced:
    """Observations as the network reads them, float32: as `Agent._normalised` and `VecNormalize.normalize_obs`."""
    if hasattr(agent, "mean"):
        mean, sd, clip = agent.mean, agent.sd, agent.clip
    elif agent.normalisation is not None and agent.normalisation.norm_obs:
        of = agent.normalisation
        mean, sd, clip = of.obs_rms.mean, np.sqrt(of.obs_rms.var + of.epsilon), of.clip_obs
    else:
        return x
    return np.clip((x.astype(np.float64) - mean) / sd, -clip, clip).astype(np.float32)


# --- description ------------------------------------------------------------------------------------------------------


def describe(agent, name: str, scenario: Scenario, world: WheelSoilModel | None) -> dict:
    """What policy.yaml says before anything was run, as plain values."""
    wheel, by_speed = scenario.wheel, scenario.control.action == "wheel_speed"
    space, model = observation_space(agent.variant), agent.model
    entries = [
        {"index": k, "name": e.name, "unit": e.unit, "low": low, "high": high}
        for k, (e, low, high) in enumerate(
            zip(layout(agent.variant), *(np.round(a.astype(float), 6).tolist() for a in (space.low, space.high)),
                strict=True)
        )
    ]  # fmt: skip
    guide = getattr(agent, "guide", None)
    sizes = memory_sizes(model.policy) | ({} if guide is None else GuideGraph(Graph(), guide).sizes)
    return {
        "format": FORMAT,
        "name": name,
        "algorithm": "PPO" if type(model).__name__ == "Learner" else type(model).__name__,
        "steps_trained": int(model.num_timesteps),
        "guide": None if guide is None else guide.content(),
        "observation": agent.variant,
        "inputs": entries,
        "reference": {
            "weight": {"value": scenario.weight, "unit": "N", "meaning": "of wheel and its share of the body"},
            "radius": {"value": wheel.radius, "unit": "m"},
            "top rim speed": {"value": wheel.radius * wheel.no_load_speed, "unit": "m/s"},
            "course length": {"value": scenario.course.length, "unit": "m"},
        },
        "states": [
            {"name": key, "size": size, "first": 0.0, "output": f"next_{key}"} for key, size in sizes.items()
        ],
        "output": {
            "name": "action",
            "low": -1.0,
            "high": 1.0,
            "meaning": "wheel speed, followed by the drive's own loop" if by_speed else "motor torque",
            "scale": {"value": wheel.no_load_speed, "unit": "rad/s"} if by_speed
            else {"value": wheel.stall_torque, "unit": "N m"},
        },
        "rate": {"period": scenario.control.period, "unit": "s"},
        "scenario": to_dict(scenario),
        "world": None if world is None else world.content(),
        "versions": _versions(),
    }  # fmt: skip


def _versions() -> dict[str, str]:
    known = {"soil_env": soil_env.__version__, "python": platform.python_version(), "opset": str(OPSET)}
    for package in ("stable-baselines3", "sb3-contrib", "torch", "numpy", "onnx", "onnxruntime"):
        try:
            known[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            pass
    return known


# --- proof ------------------------------------------------------------------------------------------------------------


class _Recorder:
    """An agent that keeps what it saw and did."""

    def __init__(self, agent):
        self.agent, self.variant = agent, agent.variant
        self.rows: list[tuple[np.ndarray, bool, np.ndarray]] = []

    def predict(self, observation, state=None, episode_start=None, deterministic: bool = True):
        action, state = self.agent.predict(observation, state, episode_start, deterministic)
        self.rows.append((observation[0].copy(), bool(episode_start[0]), np.array(action[0])))
        return action, state


def recorded(agent, scenario: Scenario, steps: int, world: WheelSoilModel | None) -> dict[str, np.ndarray]:
    """`observation` [steps, D], `new_course` [steps] and `action` [steps, 1] of the agent on held-out courses."""
    recorder, course = _Recorder(agent), 0
    while len(recorder.rows) < steps:
        for _ in drive(recorder, scenario, HELD_OUT_SET, course, 1, model=world):
            pass
        course += 1
    seen, fresh, action = (np.array(column) for column in zip(*recorder.rows[:steps], strict=True))
    return {"observation": seen.astype(np.float32), "new_course": fresh, "action": action.astype(np.float32)}


def compared(exported: ExportedAgent, course: dict[str, np.ndarray]) -> dict:
    """Largest difference of the actions on the recorded steps, and the time of a step of one wheel [us]."""
    memory, worst, times = None, 0.0, []
    for seen, fresh, expected in zip(course["observation"], course["new_course"], course["action"], strict=True):
        start = time.perf_counter()
        action, memory = exported.predict(seen[None], None if fresh else memory, np.array([fresh]))
        times.append(1e6 * (time.perf_counter() - start))
        worst = max(worst, float(np.abs(action[0] - expected).max()))
    return {
        "steps": len(times),
        "largest_difference": worst,
        "tolerance": TOLERANCE,
        "latency_us": {"median": float(np.median(times)), "p99": float(np.percentile(times, 99))},
        "machine": f"{platform.system()} {platform.machine()}, one thread",
    }


def write_course(course: dict[str, np.ndarray], path: Path) -> None:
    """course.npz."""
    stream = io.BytesIO()
    np.savez_compressed(stream, **course)
    replace_file(path, stream.getvalue())
