"""Predictability of the best slip from one moment's sensors, from the identifier's estimate, from the true soil.

The best slip of the true soil (`traversability.best_working_point`, at the nominal load) is predicted by a small
network from what can be read on courses driven by `fixed_slip`. The share of its variance that is predicted on other
courses (R^2) is the worth of a reading. It is no bound: a network may find more with more data, and a memory of sensor
readings may tell more than one moment does.

    python benchmarks/information.py --out docs/comparison          writes information.json, prints a table
    python benchmarks/information.py --smoke --out /tmp/information  in seconds, numbers without meaning
"""

from __future__ import annotations

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np
import torch

from agents.controllers import make_controller
from agents.evaluate import drive
from benchmarks.common import study_parser
from soil_env._io.commands import command_line, leave
from soil_env._io.document import Table
from soil_env._io.files import make_folder, write_json
from soil_env.parameters import Scenario, load_scenario
from soil_env.simulation.task import Cause, layout
from soil_env.terramechanics.traversability import best_points

COURSE_SET = 3_000_017  # neither of training, tuning nor comparison
EVERY = 8  # control periods between two readings
HALF = 0.7  # share of the courses that the network learns from
READINGS = {
    "sensors": (),
    "sensors, estimate": ("estimate",),
    "sensors, true phi, K, S": ("friction_angle", "log10_shear_modulus", "log10_sinkage_coefficient"),
    "sensors, estimate, true c, n, digging": ("estimate", "cohesion", "sinkage_exponent", "dig_gain"),
    "sensors, true soil": tuple(entry.name for entry in layout("true_soil")[len(layout("blind")) :]),
}


def readings(scenario: Scenario, variant: str, courses: int) -> tuple[np.ndarray, np.ndarray]:
    """(observations [n, D], course of each [n]) while `fixed_slip` drives, halts left out.

    The controller reads sensors only, so the courses are driven alike in every variant.
    """
    controller, rows, who = make_controller("fixed_slip", scenario, slip=0.3, start=0.225), [], []
    controller.variant = variant  # whose observation begins with what the controller reads
    for step, (w, alive) in enumerate(drive(controller, scenario, COURSE_SET, 0, courses, threads=1), start=1):
        if step % EVERY == EVERY - 1:
            k = np.flatnonzero(alive & (w.cause == Cause.RUNNING.value) & (w.state["halt_left"] == 0.0))
            rows.append(w.observation[k].astype(float))
            who.append(k)
    return np.concatenate(rows), np.concatenate(who)


def best_slip(scenario: Scenario, name: str, observation: np.ndarray) -> np.ndarray:
    """The slip that controller `name` would hold at these readings, at the nominal load [n]."""
    controller, n = make_controller(name, scenario), len(observation)
    out, wheel = np.zeros(n), scenario.wheel
    load = np.full(n, scenario.weight)
    soils = controller.soils(observation)
    best_points(np.arange(n), soils, load, wheel.radius, wheel.width, wheel.stall_torque, out, np.empty(n))
    return out


def predicted_share(x: np.ndarray, y: np.ndarray, learn: np.ndarray, epochs: int) -> float:
    """R^2, on the rows not in `learn`, of a network that has learnt y [n] from x [n, D] on the rows in `learn`."""
    torch.manual_seed(0)
    mean, sd = x[learn].mean(axis=0), x[learn].std(axis=0) + 1e-6
    inputs = torch.tensor(np.clip((x - mean) / sd, -8.0, 8.0), dtype=torch.float32)
    target = torch.tensor((y - y[learn].mean()) / y[learn].std(), dtype=torch.float32)
    net = torch.nn.Sequential(
        torch.nn.Linear(x.shape[1], 64),
        torch.nn.Tanh(),
        torch.nn.Linear(64, 64),
        torch.nn.Tanh(),
        torch.nn.Linear(64, 1),
    )
    optimiser = torch.optim.Adam(net.parameters(), 2e-3)
    schedule = torch.optim.lr_scheduler.LinearLR(optimiser, 1.0, 0.02, epochs)
    rows = np.flatnonzero(learn)
    for epoch in range(epochs):
        order = np.random.default_rng(epoch).permutation(rows)
        for start in range(0, order.size, 512):
            part = order[start : start + 512]
            loss = ((net(inputs[part])[:, 0] - target[part]) ** 2).mean()
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
        schedule.step()
    with torch.no_grad():
        residual = (net(inputs)[:, 0] - target).numpy()[~learn]
    return float(1.0 - (residual**2).mean() / (target.numpy()[~learn] ** 2).mean())


def study(name: str, courses: int, epochs: int) -> dict:
    """{"readings": n, "best_slip_sd", "r_squared": {reading: R^2}, "identified": {"correlation", "rms_error"}}."""
    scenario = load_scenario(name)
    true, who = readings(scenario, "true_soil", courses)
    seen, _ = readings(scenario, "identified", courses)
    sensors = len(layout("blind"))
    if not np.array_equal(true[:, :sensors], seen[:, :sensors]):
        raise AssertionError("the courses were not driven alike")
    column = {entry.name: true[:, [i]] for i, entry in enumerate(layout("true_soil")) if i >= sensors}
    column["estimate"] = seen[:, sensors:]
    best, held = best_slip(scenario, "best_slip_true", true), best_slip(scenario, "best_slip_identified", seen)
    learn = who < HALF * courses
    r_squared = {
        label: predicted_share(np.hstack([seen[:, :sensors], *(column[c] for c in names)]), best, learn, epochs)
        for label, names in READINGS.items()
    }
    return {
        "readings": len(best),
        "best_slip_sd": float(best.std()),
        "r_squared": r_squared,
        "identified": {
            "correlation": float(np.corrcoef(best, held)[0, 1]),
            "rms_error": float(np.sqrt(((held - best) ** 2).mean())),
        },
    }


@command_line("benchmarks.information")
def main(arguments: list[str] | None = None) -> int:
    """Run the study and write information.json; returns the exit status."""
    p = study_parser("python benchmarks/information.py", __doc__, "information.json", None)
    p.add_argument("--scenarios", default="mixed,loose_slopes,sticky", metavar="A,B")
    options = p.parse_args(arguments)
    make_folder(options.out)
    torch.set_num_threads(1)
    courses, epochs = (12, 2) if options.smoke else (400, 25)
    result = {name: study(name, courses, epochs) for name in options.scenarios.split(",")}
    content = {"courses": courses, "smoke": options.smoke, "scenarios": result}
    write_json(options.out / "information.json", content)
    rows = [(label, *(f"{entry['r_squared'][label]:.2f}" for entry in result.values())) for label in READINGS]
    print(Table(("best slip predicted from (R^2)", *result), rows).markdown())
    return 0


if __name__ == "__main__":
    leave(main())
