"""Switch an effect on in the model, and drive in a world that has it.

    python examples/model_with_effect.py
    python examples/model_with_effect.py --courses 500 --out bulldozing.png

Soil pushed ahead of the wheel (bulldozing) reduces the drawbar pull. The picture shows pull and sinkage over slip with
and without it. The same model is then a world unknown to identifier and controller.
"""

import argparse

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

from soil_env.parameters import load_scenario, soils
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel
from soil_env_agents.controllers import make_controller
from soil_env_agents.evaluate import HELD_OUT_SET, run_courses


def main() -> None:
    """Predict, draw, drive."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--courses", type=int, default=100)
    p.add_argument("--out", default="bulldozing.png", help="the picture")
    options = p.parse_args()

    wheel, effects = ModelWheel(radius=0.15, width=0.15), {"bulldozing": {"hegedus": 1.0}}
    soil = soils()["dry_sand_loose"]
    figure, axes = plt.subplots(1, 2, figsize=(9, 3.5), layout="constrained")
    slip = np.linspace(0.02, 0.8, 40)
    for name, on in (("base model", {}), ("with bulldozing", effects)):
        found = WheelSoilModel(wheel, soil, on).predict({"slip": slip, "load": 147.0})
        axes[0].plot(slip, found.drawbar_pull, label=name)
        axes[1].plot(slip, 1e3 * found.sinkage, label=name)
    axes[0].set(xlabel="slip [-]", ylabel="drawbar pull [N]")
    axes[1].set(xlabel="slip [-]", ylabel="sinkage [mm]")
    axes[0].legend()
    figure.savefig(options.out, dpi=130)

    scenario = load_scenario("mixed")
    for name, world in (("as modelled", None), ("with bulldozing", WheelSoilModel(wheel, effects=effects))):
        controller = make_controller("best_slip_identified", scenario)
        runs = run_courses(controller, scenario, HELD_OUT_SET, options.courses, model=world)
        print(f"{name:16s} immobilised {runs.metric('immobilised').mean():6.1%}   return {runs.returns.mean():.2f}")
    WheelSoilModel(wheel, effects=effects).save("bulldozing.yaml")  # gymnasium.make(..., model="bulldozing.yaml")
    print(f"written: {options.out}, bulldozing.yaml")


if __name__ == "__main__":
    main()
