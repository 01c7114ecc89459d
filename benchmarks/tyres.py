"""Stresses of a tyre and of a rigid wheel on rock, and their pull from loose soil to rock.

python -m benchmarks.tyres                seconds; draws docs/figures/tyre.svg
"""

import io
from dataclasses import replace
from pathlib import Path
from typing import Any

import click
import numpy as np
from matplotlib.figure import Figure

from benchmarks.common import RESULTS
from soil_env._io.files import replace_files
from soil_env.cli.running import PATH, leave, run
from soil_env.parameters import EARTH_GRAVITY, Soil, wheels
from soil_env.terramechanics import contact
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel

SLIP = 0.2
STIFFNESS = 10.0 ** np.arange(5.0, 13.1, 0.25)  # S [N/m^(n+2)] with n = 1
ROCK = 1e10  # S of rock, in the same unit
POINTS = 200  # of the contact arc


def ground(stiffness: float) -> Soil:
    """Ground of this S [N/m^3], with n = 1 and the strength of dry, slightly cohesive soil."""
    law: dict[str, Any] = {"sinkage_exponent": 1.0, "sinkage_coefficient": stiffness}
    return Soil(
        friction_angle_deg=30.0,
        cohesion=1000.0,
        shear_modulus=0.01,
        **law,
        gravity_measured=EARTH_GRAVITY,
    )


def stresses(wheel: ModelWheel, load: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(place along the ground ahead of the lowest point [m], normal stress [Pa], shear stress [Pa])
    of a wheel under a load [N] on `ROCK` at `SLIP`.

    Each is [POINTS], from the lowest point on. The arc of a tyre is that of its circle
    (`contact.substitute_radius`). The normal stress has its peak in the middle of the arc. The
    soil's strength is multiplied by the share that a wheel with a `grip` transmits
    (`contact.gripping_share`).
    """
    soil = ground(ROCK)
    z = float(WheelSoilModel(wheel, soil).predict({"slip": SLIP, "load": load}).sinkage[0])
    r = wheel.radius
    share = 1.0
    if wheel.tyre is not None:
        root = np.sqrt(wheel.tyre.deflection / z)
        r *= (np.sqrt(1.0 + root**2) + root) ** 2
    theta1 = contact.entry_angle(z, r)
    theta = np.linspace(0.0, theta1, POINTS)
    normal = soil.lumped(wheel.width) * (r * theta1**2 / 2.0)
    normal *= 1.0 - (np.maximum(theta, theta1 - theta) / theta1) ** 2
    j = r * (theta1 - theta - (1.0 - SLIP) * (np.sin(theta1) - np.sin(theta)))
    if wheel.grip > 0.0:
        pressure = load / (wheel.width * r * theta1)
        strength = soil.cohesion + pressure * soil.tan_phi
        share = contact.held_below(strength, wheel.grip * pressure)[0] / strength
    shear = share * (soil.cohesion + normal * soil.tan_phi) * -np.expm1(-j / soil.shear_modulus)
    return r * np.sin(theta), normal, shear


def figure() -> tuple[Figure, dict[str, Any]]:
    """(Picture, {wheel: its drawbar pull over the load [-] on the grounds `STIFFNESS`}) of the
    preset `husky`, with its tyre and with a rigid wheel of its size.

    The picture has the stresses on rock, left, and the pull over S, right.
    """
    husky = wheels()["husky"]
    load = husky.body_mass * EARTH_GRAVITY
    tyre = ModelWheel.of(husky)
    assert tyre.tyre is not None
    deflection = load / tyre.tyre.stiffness
    # The same tyre under this load, by its deflection, which `stresses` needs.
    tyre = replace(tyre, tyre=replace(tyre.tyre, deflection=deflection, stiffness=0.0))
    rigid = ModelWheel(husky.radius, husky.width)
    picture = Figure(figsize=(9.0, 3.4), layout="constrained")
    left, right = picture.subplots(1, 2)
    pulls = {}
    for name, wheel, colour in (("tyre", tyre, "C0"), ("rigid wheel", rigid, "C1")):
        x, normal, shear = stresses(wheel, load)
        left.plot(1e3 * x, normal / 1e3, colour, label=f"{name}: normal")
        left.plot(1e3 * x, shear / 1e3, colour, linestyle="--", label=f"{name}: shear")
        pull = [
            float(WheelSoilModel(wheel, ground(s)).predict({"slip": SLIP, "load": load})[1][0])
            for s in STIFFNESS
        ]
        pulls[name] = np.array(pull) / load
        right.semilogx(STIFFNESS, pulls[name], colour, label=name)
    left.set(yscale="log", ylim=(1.0, None), xlabel="ahead of the lowest point [mm]")
    left.set(ylabel="stress [kPa]", title=f"on rock, S = {ROCK:.0e} N/m$^3$, slip {SLIP:g}")
    right.set(xlabel="S [N/m$^3$]", ylabel="DP/W [-]", title=f"pull at slip {SLIP:g}")
    left.legend(fontsize=8)
    right.legend(fontsize=8)
    return picture, pulls


@click.command()
@click.option("--out", type=PATH, default=RESULTS.parent / "figures", help="Folder of tyre.svg.")
def main(out: Path) -> None:
    """Draw docs/figures/tyre.svg and print the pull over load."""
    picture, pulls = figure()
    stream = io.BytesIO()
    picture.savefig(stream, format="svg", metadata={"Date": None})
    replace_files(out, {"tyre.svg": stream.getvalue().decode()})
    for k in range(0, STIFFNESS.size, 4):
        print(f"S = {STIFFNESS[k]:.0e}: " + ", ".join(f"{n} {p[k]:.4f}" for n, p in pulls.items()))


if __name__ == "__main__":
    leave(run(main, None, "benchmarks.tyres"))
