"""A wheel at one and at a sixth of Earth's gravity beside parabolic flights, and the steepest slopes
of the presets.

    python -m benchmarks.gravity             seconds; writes docs/results/gravity.json and .md
    python -m benchmarks.gravity --smoke --out X   the same

A soil is fitted to the measurements at 1 g, and the law of `Soil.at` predicts those at lunar
gravity. Wheel and mass are the preset `planetary_rover`: those of the flights were not read.
"""

import math
from dataclasses import replace
from pathlib import Path

import click
import numpy as np
from scipy.optimize import least_squares

from benchmarks.common import ready, short, study_options, write
from soil_env._io.document import Table
from soil_env._io.files import write_json
from soil_env.cli.running import leave, run
from soil_env.parameters import EARTH_GRAVITY, Scenario, Soil, load_rover, load_scenario, wheels
from soil_env.terramechanics.contact import entry_angle
from soil_env.terramechanics.steady import steady_state
from soil_env.terramechanics.traversability import best_working_point

NAME = "gravity"
MOON = 1.62  # [m/s2]
SLIPS = (0.2, 0.7)
#: Drawbar pull over load and sinkage over contact length of a wheel of the same mass, lowest and
#: highest at each slip: A. Daca (2022), PhD thesis, Concordia University, as quoted to us.
MEASURED = {
    EARTH_GRAVITY: (((0.07, 0.09), (0.22, 0.25)), ((0.04, 0.08), (0.11, 0.16))),
    MOON: (((0.09, 0.14), (0.29, 0.33)), ((0.05, 0.08), (0.10, 0.12))),
}
COHESION = 150.0  # [Pa] of a dry regolith simulant; own choice
EXPONENT = 1.0  # [-] n of regolith
START = (math.log(30.0), math.log(0.02), math.log(1e6), math.log(2.0))  # phi [deg], K, S, dig gain
#: Slopes that rovers of the class of a preset have climbed, and where that is printed.
PUBLISHED = {
    "lunar_micro_rover": (
        "30 on simulant, eccentric wheels with lugs",
        "Aerospace 12(1):24 (2025), abstract",
    ),
    "mars_rover": (
        "23, sand and stones",
        "NASA/JPL on Curiosity, June 2023, as reported",
    ),
    "field_rover": ("no test on loose soil found", "-"),
    "planetary_rover": (
        "20 to 23 designed, 25 at most (Apollo LRV)",
        "Jacob et al. (2026), NASA abstract",
    ),
}
TEXT = (
    "Sinkage over contact length is z/(r theta_1). The soil is fitted to the middle of the values "
    "at 1 g, its cohesion is assumed. The steepest slope is atan of the best drawbar pull over "
    "load within the torque of the motor, rim smooth, soil as the preset has it and, in brackets, "
    "with a straight strength."
)


def at_slips(soil: Soil, load: float, gravity: float) -> np.ndarray:
    """[2, 2] of pull over load and sinkage over contact length, at `SLIPS`."""
    wheel = wheels()["planetary_rover"]
    state = soil.under(wheel.radius, wheel.width, load, gravity)
    out = np.empty((2, len(SLIPS)))
    for k, slip in enumerate(SLIPS):
        s = steady_state(slip, load, state, wheel.radius, wheel.width)
        length = wheel.radius * entry_angle(s.sinkage, wheel.radius)
        out[:, k] = s.drawbar_pull / load, s.sinkage / length
    return out


def fitted(weight: float) -> Soil:
    """The soil of the measurements at 1 g under a weight [N]."""
    middle = np.mean(MEASURED[EARTH_GRAVITY], axis=2)

    def soil_of(x: np.ndarray) -> Soil:
        phi, modulus, stiffness, gain = np.exp(x).tolist()
        return Soil(
            phi,
            COHESION,
            modulus,
            EXPONENT,
            sinkage_coefficient=stiffness,
            dig_gain=gain,
            gravity_measured=EARTH_GRAVITY,
        )

    found = least_squares(
        lambda x: (at_slips(soil_of(x), weight, EARTH_GRAVITY) / middle - 1.0).ravel(),
        START,
        bounds=(np.log([5.0, 1e-3, 1e4, 0.01]), np.log([60.0, 0.2, 1e8, 20.0])),
    )
    return soil_of(found.x)


def steepest(scenario: Scenario, soil: Soil) -> float:
    """Steepest slope [deg] of the wheel of a scenario on a soil."""
    w = scenario.wheel
    state = scenario.beneath(soil)
    best = best_working_point(scenario.weight, state, w.radius, w.width, w.stall_torque)
    return math.degrees(math.atan(best.drawbar_pull / scenario.weight))


def slopes() -> list[dict]:
    """A row for each soil of each rover, and of the wheel of the scenario `mixed`."""
    scenarios: dict[str, Scenario] = {"planetary_rover": load_scenario("mixed")}
    scenarios |= {name: load_rover(name) for name in PUBLISHED if name not in scenarios}
    return [
        {
            "rover": name,
            "soil": soil,
            "slope_deg": steepest(scenario, scenario.library[soil]),
            "straight_deg": steepest(
                scenario, replace(scenario.library[soil], reference_stress=0.0)
            ),
        }
        for name, scenario in scenarios.items()
        for soil in scenario.soils
    ]


def tables(values: dict[str, np.ndarray], rows: list[dict]) -> dict[str, Table]:
    """The tables of the page."""
    cells = []
    for q, quantity in enumerate(("DP/W", "sinkage / contact length")):
        for k, slip in enumerate(SLIPS):
            spans = [
                f"{low:.2f} to {high:.2f}" for low, high in (m[q][k] for m in MEASURED.values())
            ]
            ours = [f"{v[q, k]:.2f}" for v in values.values()]
            cells.append([quantity, f"{slip:g}", spans[0], ours[0], spans[1], *ours[1:]])
    head = ["quantity", "slip", "measured, 1 g", "fitted, 1 g", "measured, lunar g", *values]
    del head[5]  # the fitted column has its name
    climbed = [
        [
            r["rover"],
            r["soil"],
            f"{r['slope_deg']:.1f} ({r['straight_deg']:.1f})",
            *PUBLISHED[r["rover"]],
        ]
        for r in rows
    ]
    return {
        "The same wheel at 1 g and at lunar gravity": Table(head, cells),
        "Steepest slopes [deg]": Table(
            ["rover or wheel", "soil", "here (straight)", "published", "source"], climbed
        ),
    }


@click.command(NAME)
@study_options(NAME)
def command(smoke: bool, out: Path) -> None:
    """Pull and sinkage at lunar gravity beside measurements; steepest slopes of the presets."""
    path = ready(out, NAME)
    mass = wheels()["planetary_rover"].body_mass
    earth = mass * EARTH_GRAVITY
    soil = fitted(earth)
    values = {
        "fitted, 1 g": at_slips(soil, earth, EARTH_GRAVITY),
        "here, lunar g": at_slips(soil, mass * MOON, MOON),
        "without cohesion": at_slips(replace(soil, cohesion=0.0), mass * MOON, MOON),
        "same load": at_slips(soil, earth, MOON),
    }
    rows = slopes()
    content = {name: v.tolist() for name, v in values.items()}
    write_json(path, short({"command": f"python -m benchmarks.{NAME}", **content, "slopes": rows}))
    write(out, NAME, "Gravity", TEXT, tables(values, rows))
    print(soil)


if __name__ == "__main__":
    leave(run(command, None, f"benchmarks.{NAME}"))
