"""Compile the kernels that most tests use: `python -m tests.kernels`, before several test processes start at once."""

from pathlib import Path

import gymnasium
import numpy as np

from agents.controllers import make_controller
from soil_env.identification.table import identify_table
from soil_env.measurement.table import read_setup, read_table
from soil_env.parameters import load_scenario, soils
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel
from soil_env.warmup import warm_up

EXAMPLES = Path(__file__).resolve().parents[1] / "examples" / "data"


def controllers() -> None:
    """A step of the controllers that compute the best slip."""
    envs = gymnasium.make_vec("SoilWheel-v0", 64, "vector_entry_point")
    observations, _ = envs.reset(seed=0)
    for name in ("best_slip_identified", "best_slip_true"):
        make_controller(name, load_scenario("mixed")).predict(observations, None, np.ones(64, dtype=bool))


def tables() -> None:
    """The fit of a soil to a table, and the steady states of the model at its points."""
    setup = read_setup(EXAMPLES / "setup.yaml")
    table = read_table(EXAMPLES / "single_wheel.csv", setup.wheel)
    identify_table(table, setup)
    model = WheelSoilModel(ModelWheel(0.15, 0.15), soils()["lete_sand"], {"bulldozing": {"rankine": 1.0}})
    model.predict({"slip": table.slip, "load": 100.0})


if __name__ == "__main__":
    warm_up()
    controllers()
    tables()
