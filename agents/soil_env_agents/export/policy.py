"""The ONNX model of an agent, its description, and the steps on which both are compared."""

import json
import platform
from importlib import metadata

import numpy as np
from gymnasium.spaces import Box

import soil_env
from soil_env._io.files import plain
from soil_env._io.loading import ParameterError, to_dict
from soil_env.parameters import Control, Scenario, Wheel
from soil_env.simulation.task import VERSION, layout
from soil_env.simulation.world.wheel import REVERSE
from soil_env.terramechanics.model import WheelSoilModel

from ..default_policy import DefaultPolicy
from ..evaluate.driving import HELD_OUT_SET, drive
from ..exported import FORMAT
from .graph import OPSET, Graph, Values

_NETWORKS = ("stable-baselines3", "torch")  # what trained the agents that are not shipped
TOLERANCE = 1e-5  # of the action, between the agent and its export


def onnx_model(agent, description: dict):
    """The ONNX model of a loaded agent (`evaluate.models.load_model`), `description` inside.

    Inputs: `observation` [n, D] float32, raw; for agents with a history `new_course` [n] bool and
    `history`. Outputs: `action` [n, 1] float32 in [-1, 1], and `next_history`. ParameterError for
    actions of another space and for a network that `network.action_of` does not know.
    """
    shipped = isinstance(agent, DefaultPolicy)
    # Of a model trained with LineAction.
    choice = None if shipped else getattr(agent, "choice", None)
    expected = Box(-1.0, 1.0, (1 if choice is None else 2,), np.float32)
    if not shipped and agent.policy.action_space != expected:
        raise ParameterError(f"action space {agent.policy.action_space}: expected {expected}")
    graph = Graph()
    entries = len(description["inputs"])
    seen: Values = graph.input("observation", "float32")
    fresh = graph.input("new_course", "bool")
    raw = agent.scaling(seen) if agent.scaling.scaled else seen
    inputs = [graph.info(seen, ["n", entries])]
    results = []
    if history := getattr(agent, "history", None):
        memory = graph.input("history", "float32")
        raw, kept = history.observe(raw, memory, fresh)
        inputs += [graph.info(fresh, ["n"]), graph.info(memory, ["n", history.kept])]
        results = [(kept, "next_history", history.kept)]
    x = raw
    if hasattr(agent, "normalised"):  # models of other programs have no normalisation
        x = agent.normalised(raw.astype(np.float64))
    if shipped:
        action = agent.action(x)
    else:
        from .network import action_of  # needs torch, which the shipped policy does not

        action = action_of(graph, agent.policy, x)
    if choice is not None:
        action = np.where(np.greater(seen[:, [choice]], 0.5), action[:, [1]], action[:, [0]])
    results = [(np.clip(action, -1.0, 1.0), "action", 1), *results]
    outputs = [
        graph.info(graph.node("Identity", x, name=name, dtype=x.dtype), ["n", size])
        for x, name, size in results
    ]
    return graph.model(inputs, outputs, {"policy": json.dumps(plain(description))})


def describe(agent, name: str, scenario: Scenario, world: WheelSoilModel | None) -> dict:
    """Content of policy.yaml but for "proof", the comparison with the agent.

    `name`: the agent's in the description; `scenario` and `world` (None: no effects): what it is
    exported for.
    """
    wheel = scenario.wheel
    control = scenario.control
    shipped = isinstance(agent, DefaultPolicy)
    history = getattr(agent, "history", None)
    states = []
    if history is not None:
        states = [{"name": "history", "size": history.kept, "first": 0.0, "output": "next_history"}]
    return {
        "format": FORMAT,
        "name": name,
        "network": type(getattr(agent, "policy", agent)).__name__,
        "history": 0 if history is None else history.steps,
        "observation": agent.variant,
        "observation_version": VERSION,
        "inputs": [
            {"index": k, "name": e.name, "unit": e.unit, "low": e.low, "high": e.high}
            for k, e in enumerate(layout(agent.variant, scenario.course))
        ],
        "reference": {
            "weight": {
                "value": scenario.weight,
                "unit": "N",
                "meaning": "of wheel and its share of the body",
            },
            "radius": {"value": wheel.radius, "unit": "m"},
            "top rim speed": {"value": wheel.radius * wheel.no_load_speed, "unit": "m/s"},
            "course length": {"value": scenario.course.length, "unit": "m"},
        },
        "states": states,
        "output": {"name": "action", "low": -1.0, "high": 1.0, **_output(wheel, control)},
        "rate": {"period": round(control.duration, 9), "unit": "s"},
        "scenario": to_dict(scenario),
        "world": None if world is None else world.content(),
        "versions": {
            "soil_env": soil_env.__version__,
            "python": platform.python_version(),
            "opset": str(OPSET),
        }
        | {
            package: metadata.version(package)
            for package in (*(() if shipped else _NETWORKS), "onnx", "onnxruntime")
        },
    }


def _output(wheel: Wheel, control: Control) -> dict:
    """Meaning of the action on a vehicle, and as "scale" the value and unit of an action of 1.

    Where the action is a rate of the rim speed, "limits" are those of this rim speed.
    """
    if control.action == "torque":
        return {"meaning": "motor torque", "scale": {"value": wheel.stall_torque, "unit": "N m"}}
    if control.action == "wheel_speed":
        scale = {"value": wheel.no_load_speed, "unit": "rad/s"}
        return {"meaning": "wheel speed, followed by the drive's own loop", "scale": scale}
    top = wheel.radius * wheel.no_load_speed
    return {
        "meaning": (
            "rate of the rim speed that the drive's own loop follows and that is 0 at the start "
            "and in halts"
        ),
        "scale": {"value": control.rim_acceleration, "unit": "m/s2"},
        "limits": {"value": [-REVERSE * top, top], "unit": "m/s, of that rim speed"},
    }


class _Recorder:
    """An agent that keeps its observations and actions; it drives one course at a time."""

    def __init__(self, agent):
        self.agent = agent
        self.variant = agent.variant
        self.rows: list[tuple[np.ndarray, bool, np.ndarray]] = []

    def predict(self, observation, state=None, episode_start=None, deterministic: bool = True):
        """Prediction of the agent, kept in `rows`."""
        action, state = self.agent.predict(observation, state, episode_start, deterministic)
        self.rows.append((observation[0].copy(), bool(episode_start[0]), np.array(action[0])))
        return action, state


def recorded(
    agent, scenario: Scenario, steps: int, world: WheelSoilModel | None
) -> dict[str, np.ndarray]:
    """`observation` [steps, D], `new_course` [steps] and `action` [steps, 1] of the agent on
    held-out courses, driven one after the other; `world`: model of their effects, None without.
    """
    recorder = _Recorder(agent)
    course = 0
    while len(recorder.rows) < steps:
        for _ in drive(recorder, scenario, HELD_OUT_SET, range(course, course + 1), world):
            pass
        course += 1
    seen, fresh, action = (np.array(column) for column in zip(*recorder.rows[:steps], strict=True))
    return {
        "observation": seen.astype(np.float32),
        "new_course": fresh,
        "action": action.astype(np.float32),
    }
