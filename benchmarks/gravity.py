"""A wheel at Earth's and at lunar gravity beside parabolic flights; steepest slopes of the presets.

    python -m benchmarks.gravity                seconds; writes docs/results/gravity.json and .md
    python -m benchmarks.gravity --smoke --out X   the same

A soil is fitted to the measurements at 1 g, and the law of `Soil.at` predicts those at lunar
gravity. Wheel and mass are the preset `planetary_rover`: we have not read those of the flights.
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
#: (quantity, slip), lowest and highest at 1 g, then at lunar g, of the same mass: A. Daca (2022),
#: PhD thesis, Concordia University; abstract read, values second-hand.
MEASURED = {
    ("DP/W", 0.2): ((0.07, 0.09), (0.09, 0.14)),
    ("DP/W", 0.7): ((0.22, 0.25), (0.29, 0.33)),
    ("sinkage / contact length", 0.2): ((0.04, 0.08), (0.05, 0.08)),
    ("sinkage / contact length", 0.7): ((0.11, 0.16), (0.10, 0.12)),
}
#: [Pa] of dry simulants: own choice, what was driven on is not known here.
COHESIONS = (150.0, 500.0)
EXPONENT = 1.0  # [-] n of regolith
#: Start and bounds of phi [deg], K [m], S [N/m^3] and the gain of digging.
UNKNOWNS = np.log([[25.0, 0.01, 1e7, 5.0], [5.0, 1e-3, 1e4, 0.01], [60.0, 0.2, 1e9, 8.0]])
#: Slopes [deg] that a rover of the class of each preset climbs, and where that is printed.
PUBLISHED = {
    "lunar_micro_rover": ("30, eccentric wheels with lugs", "Aerospace 12(1):24 (2025), abstract"),
    "mars_rover": ("23, sand and stones", "press on Curiosity, June 2023"),
    "field_rover": ("none found on loose soil", "-"),
    "planetary_rover": ("20 to 25, design of the Apollo LRV", "Jacob et al. (2026), abstract"),
}
TEXT = (
    "Sinkage over contact length is z/(r theta_1). The soil is fitted to the middle of the values "
    "at 1 g, with each cohesion c and a gain of slip-sinkage of at most 8; load of 1 g: c = 150 Pa "
    "at lunar gravity with the load of 1 g. "
    "A steepest slope is atan of the best drawbar pull over load within the torque of the motor, "
    "with a smooth rim; in brackets with a straight strength."
)


def at_slips(soil: Soil, load: float, gravity: float) -> list[float]:
    """The quantities of `MEASURED` [-] in their order, of a soil under a load [N] at a gravity
    [m/s2].
    """
    wheel = wheels()["planetary_rover"]
    state = soil.under(wheel.radius, wheel.width, load, gravity)
    found = [steady_state(slip, load, state, wheel.radius, wheel.width) for slip in SLIPS]
    return [s.drawbar_pull / load for s in found] + [
        s.sinkage / (wheel.radius * entry_angle(s.sinkage, wheel.radius)) for s in found
    ]


def fitted(weight: float, cohesion: float) -> Soil:
    """Fit a soil with this cohesion [Pa], under a weight [N] at 1 g, to the measurements there.

    Least squares of the relative errors of `at_slips` from the middles of `MEASURED`.
    """
    middle = np.array([np.mean(earth) for earth, _ in MEASURED.values()])

    def soil_of(x: np.ndarray) -> Soil:
        """Soil of the logarithms of the four unknowns, in the order of `UNKNOWNS`."""
        phi, modulus, stiffness, gain = np.exp(x).tolist()
        on_earth = {"sinkage_coefficient": stiffness, "gravity_measured": EARTH_GRAVITY}
        return Soil(
            friction_angle_deg=phi,
            cohesion=cohesion,
            shear_modulus=modulus,
            sinkage_exponent=EXPONENT,
            dig_gain=gain,
            **on_earth,
        )

    start, low, high = UNKNOWNS
    found = least_squares(
        lambda x: at_slips(soil_of(x), weight, EARTH_GRAVITY) / middle - 1.0,
        start,
        bounds=(low, high),
    )
    return soil_of(found.x)


def steepest(scenario: Scenario, soil: Soil) -> float:
    """Steepest slope [deg] of the wheel of a scenario on a soil: atan of the best pull over load.

    The best pull is that within the stall torque of the motor, with a smooth rim, under the load on
    level ground.
    """
    w = scenario.wheel
    load = scenario.weight
    best = best_working_point(load, scenario.beneath(soil), w.radius, w.width, w.stall_torque)
    return math.degrees(math.atan(best.drawbar_pull / load))


def slopes() -> list[list[str]]:
    """Rows of cells, one for each soil of each preset of `PUBLISHED`, by its own scenario or, for
    the wheel `planetary_rover`, `mixed`.

    Cells: name of rover or wheel, soil, steepest slope [deg], in brackets that with a straight
    strength, published slope and its source.
    """
    rows = []
    for name, published in PUBLISHED.items():
        scenario = load_scenario("mixed") if name == "planetary_rover" else load_rover(name)
        for of in scenario.soils:
            soil = scenario.library[of]
            # Without a reference stress the strength rises straight with the normal stress.
            straight = steepest(scenario, replace(soil, reference_stress=0.0))
            here = f"{steepest(scenario, soil):.1f} ({straight:.1f})"
            rows.append([name, of, here, *published])
    return rows


def span(values: tuple[float, float]) -> str:
    """Lowest and highest as the table shows them."""
    return f"{values[0]:.2f} to {values[1]:.2f}"


@click.command(NAME)
@study_options(NAME)
def command(smoke: bool, out: Path) -> None:
    """Pull and sinkage at lunar gravity beside measurements; steepest slopes of the presets."""
    path = ready(out, NAME)  # `smoke` changes nothing: all takes seconds
    mass = wheels()["planetary_rover"].body_mass
    earth = mass * EARTH_GRAVITY
    found = {c: fitted(earth, c) for c in (0.0, *COHESIONS)}
    usual = found[COHESIONS[0]]
    # [4] quantities of `MEASURED` in each column.
    columns = {"fitted, 1 g": at_slips(usual, earth, EARTH_GRAVITY)}
    columns |= {f"c = {c:g} Pa": at_slips(s, mass * MOON, MOON) for c, s in found.items()}
    columns["load of 1 g"] = at_slips(usual, earth, MOON)
    cells = [
        [quantity, f"{slip:g}", span(one), f"{ours[0]:.2f}", span(moon)]
        + [f"{value:.2f}" for value in ours[1:]]
        for ((quantity, slip), (one, moon)), ours in zip(
            MEASURED.items(), zip(*columns.values(), strict=True), strict=True
        )
    ]
    first, *others = columns
    head = ["quantity", "slip", "measured, 1 g", first, "measured, lunar g", *others]
    steep = slopes()
    result = {"command": f"python -m benchmarks.{NAME}", "values": columns, "slopes": steep}
    write_json(path, short(result))
    climbed = ["rover or wheel", "soil", "here", "published", "source"]
    tables = {
        "The same wheel at 1 g and at lunar gravity": Table(head, cells),
        "Steepest slopes [deg]": Table(climbed, steep),
    }
    write(out, NAME, "Gravity", TEXT, tables)


if __name__ == "__main__":
    leave(run(command, None, f"benchmarks.{NAME}"))
