"""How often a sound table is doubted, and how often a mistake is found where it matters.

    python -m benchmarks.sound_tables --tables 400       both commands say the same; some minutes
    python -m benchmarks.sound_tables --tables 20        a look

Tables of many wheels (radius 0.05 to 0.35 m) on the soils of configs/soils.yaml: none, one or two
effects that the base model lacks, smooth errors of 0, 5 or 10 % in what is measured, noise of 0.3
to 2 %, and priors that are tight, loose or absent. Each is examined as it is, and again with each
mistake in turn. A mistake matters where the estimate of the sound table and that of the wrong one
differ by more than two standard deviations of the wrong one.
"""

import dataclasses
import itertools
import math
import re
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import click
import numpy as np

from benchmarks.common import share
from soil_env._io.loading import ParameterError
from soil_env.cli.running import WholeNumber, leave, run, seed_option
from soil_env.identification.table import identify_table
from soil_env.identification.table.fit import Parameter
from soil_env.identification.table.mistakes import examine
from soil_env.measurement.setup import NoiseLevels, Prior, Setup, SetupWheel, SoilPriors
from soil_env.measurement.table import MEASURED, Table, read_table
from soil_env.parameters import Soil, soils
from soil_env.terramechanics.effects import CATALOGUE
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel

GRAVITY = 9.81  # [m/s2]
LIGHTEST = 2.0  # [N] on the wheel of a rig
LEAST_PRESSURE = 1e3  # [Pa] below it
MOST_PRESSURE = 5e6  # [Pa] below it: no rig presses a wheel into asphalt
MOST_GRIP = 1.2  # largest pull, or torque over radius, over the load that soil gives
OFF = 2.0  # [sd] of an estimate, from which a mistake matters
INTERVAL = 3.92  # [sd] from end to end of an interval of 95 %
#: Largest strengths of effects that go with the size of the values: share of the torque, of the
#: sinkage.
SIZES = {"drivetrain_friction_constant": 0.1, "sinkage_offset_offset": 0.25}
#: Standard deviation of the priors, relative but for phi [deg] and n; one as often as another.
PRIORS: tuple[dict[str, float], ...] = (
    {},
    {"cohesion": 0.2},
    {
        "friction_angle_deg": 1.5,
        "cohesion": 0.2,
        "sinkage_coefficient": 0.12,
        "sinkage_exponent": 0.03,
    },
    {
        "friction_angle_deg": 3.0,
        "cohesion": 0.5,
        "shear_modulus": 0.3,
        "sinkage_coefficient": 0.4,
        "sinkage_exponent": 0.1,
    },
)


@dataclass(frozen=True, eq=False)
class Sound:
    """A synthetic table by column [N], and its setup; sound, or with a mistake (`MISTAKES`)."""

    columns: dict[str, np.ndarray]
    setup: Setup
    what: str  # soil, wheel, effects and errors in words
    wrong_row: int = 0  # line of the file, 0 if none is wrong

    def table(self) -> Table:
        """The table as `read_table` reads it from a file, with seven digits of each value."""
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "data.csv"
            rows = np.stack([*self.columns.values()], axis=1)
            header = ",".join(self.columns)
            np.savetxt(path, rows, delimiter=",", header=header, comments="", fmt="%.7g")
            return read_table(path, self.setup.wheel)


def sound_tables(count: int, seed: int) -> Iterator[Sound]:
    """Yield `count` sound tables, each on a random soil of configs/soils.yaml, some with effects
    that the base model lacks.
    """
    rng = np.random.default_rng(seed)
    names = list(soils())
    made = 0
    while made < count:
        table = _draw(rng, names[int(rng.integers(len(names)))])
        if table is not None:
            made += 1
            yield table


def _draw(rng: np.random.Generator, name: str) -> Sound | None:
    """One table on the soil `name`, as the module's docstring says; None where the soil does not
    carry the wheel or hardly lets it in, or where no rig could measure it (`of_a_rig`).

    One of two tables has all channels; the others lack sinkage or torque. Six of ten setups state
    the noise.
    """
    r = math.exp(rng.uniform(math.log(0.05), math.log(0.35)))
    b = r * rng.uniform(0.4, 1.2)
    height = r * rng.choice([0.0, 0.05, 0.1])
    preset = soils()[name]
    stiffness = preset.lumped(b)
    n = preset.sinkage_exponent
    soil = replace(preset, k_c=None, k_phi=None, sinkage_coefficient=stiffness, dig_gain=0.0)
    z = r * rng.uniform(0.03, 0.2)
    # [N] load that this S carries at the sinkage z, as `plate_coefficient` has it.
    middle = 0.6 * b * math.sqrt(2.0 * r * z) * stiffness * z**n
    loads = middle * np.geomspace(0.6, 1.6, int(rng.integers(1, 4)))
    ends = rng.uniform(0.02, 0.12), rng.uniform(0.45, 0.75)
    slips = np.round(np.linspace(*ends, int(rng.integers(5, 10))), 3)
    at = np.array(list(itertools.product(loads, slips)))
    conditions = {"load": at[:, 0], "slip": at[:, 1]}
    effects = _effects(rng, torque=middle * r * 0.3, sinkage=z)
    try:
        found = WheelSoilModel(ModelWheel(r, b, height), soil, effects).predict(conditions)
    except ParameterError:
        return None
    y = np.stack(found[:3], axis=1)
    if not LEAST_PRESSURE < stiffness * z**n < MOST_PRESSURE or middle < LIGHTEST:
        return None
    if not np.all(found.supported) or not of_a_rig(y, r, np.max(loads)):
        return None
    # Smooth relative errors: a wave over slip and load for each channel.
    s = (at[:, 1] - slips.mean()) / np.ptp(slips)
    w = np.log(at[:, 0] / middle)
    waves = [
        np.sin(2.0 * s + rng.uniform(0.0, 6.0)) + 0.5 * np.sin(1.5 * w + rng.uniform(0.0, 6.0))
        for _ in range(3)
    ]
    error = float(rng.choice([0.0, 0.05, 0.1]))
    # Typical sinkage, pull and torque, the forces for a coefficient of traction of 0.3.
    sd = np.array([z, 0.3 * middle, 0.3 * middle * r]) * rng.uniform(0.003, 0.02)
    y = y * (1.0 + error * np.stack(waves, axis=1)) + sd * rng.normal(size=y.shape)
    drop = rng.choice([-1, -1, 0, 2])  # of the channels, one is sometimes not measured
    columns = conditions | {c: y[:, j] for j, c in enumerate(MEASURED) if j != drop}
    given = dict(zip(MEASURED, sd, strict=True)) if rng.random() < 0.6 else {}
    priors = _priors(rng, soil, PRIORS[int(rng.integers(len(PRIORS)))])
    setup = Setup(SetupWheel(r, b, height), priors, NoiseLevels(**given))
    what = f"{name}, r {r:.2f} m, {' and '.join(effects) or 'no effect'}, error {error:g}"
    return Sound(columns, setup, what)


def of_a_rig(y: np.ndarray, r: float, load: float) -> bool:
    """True if a rig could measure `y` [N, 3], sinkage [m], pull [N] and torque [N m].

    Pull and torque/r are then at most `MOST_GRIP` times the largest `load` [N], and sinkages 0.005
    to 0.6 times the radius r [m] of the wheel.
    """
    sinkage, pull, torque = y.T
    grip = max(np.max(np.abs(pull)), np.max(np.abs(torque)) / r) / load
    return bool(grip <= MOST_GRIP and np.min(sinkage) >= 0.005 * r and np.max(sinkage) <= 0.6 * r)


def _effects(
    rng: np.random.Generator, torque: float, sinkage: float
) -> dict[str, dict[str, float]]:
    """{effect: {parameter: value}} of none to two effects, each in one of its forms, 0.5 to 3 times
    the usual size, in a table of slips and loads.

    `torque` [N m] and `sinkage` [m]: typical values of the table, for the sizes that go with them.
    Soils of the library flow along the rim by themselves.
    """
    names = [e.name for e in CATALOGUE.values() if e.varies is None and e.name != "soil_flow"]
    out = {}
    for name in rng.choice(names, int(rng.integers(0, 3)), replace=False):
        effect = CATALOGUE[str(name)]
        form = effect.forms[int(rng.integers(len(effect.forms)))]
        values = dict(form.fixed)
        for p in (effect.parameter(name) for name in form.free):
            usual = SIZES.get(f"{effect.name}_{p.name}", p.scale * (p.centre or 1.0))
            # Coulomb friction is a share of the torque, a wrong zero of the sinkage one of that.
            usual *= {"constant": torque}.get(
                p.name, sinkage if effect.name == "sinkage_offset" else 1.0
            )
            values[p.name] = (p.centre or p.neutral) + usual * rng.uniform(0.5, 3.0)
            values[p.name] = min(max(values[p.name], p.low), p.high)
        # Above 1: below it the law does not soften the soil.
        if effect.name == "shear_softening" and "sharpness" in values:
            values["sharpness"] = 1.0 + values["sharpness"]
        out[effect.name] = values
    return out


def _priors(rng: np.random.Generator, soil: Soil, chosen: dict[str, float]) -> SoilPriors:
    """Priors about the truth, off by their standard deviations times N(0, 1); the density is known.

    `chosen`: an entry of `PRIORS`.
    """
    out = {"density": Prior(soil.density, 0.0)}
    limits = {f.name: f.metadata for f in dataclasses.fields(Soil)}
    for name, relative in chosen.items():
        truth = getattr(soil, name)
        size = {
            "friction_angle_deg": 1.0,
            "sinkage_exponent": 1.0,
            "cohesion": max(truth, 100.0),
        }.get(name, truth)
        sd = relative * size
        low = max(0.2 * truth, limits[name]["low"])
        out[name] = Prior(min(max(truth + sd * rng.normal(), low), limits[name]["high"]), sd)
    return SoilPriors(**out)


def _changed(name: str, change: Callable, one: bool = False) -> Callable[[Sound], Sound | None]:
    """Return the function that makes a mistake in a table: `change` of the values [N] of the column
    `name`, or of only `one` of them, in a row that follows from the table.
    """

    def wrong(t: Sound) -> Sound | None:
        """The table with the mistake, `wrong_row` set if it is in one row; None without the
        column.
        """
        if name not in t.columns:
            return None
        values = t.columns[name]
        changed = change(values)
        line = 0
        if one:
            k = int(1e6 * abs(values.sum())) % values.size  # as good as random, and repeatable
            changed = np.where(np.arange(values.size) == k, changed, values)
            line = k + 2  # behind the header, from 1
        return replace(t, columns=t.columns | {name: changed}, wrong_row=line)

    return wrong


def _diameter(t: Sound) -> Sound:
    """The table with the diameter of the wheel stated as its radius."""
    wheel = replace(t.setup.wheel, radius=2.0 * t.setup.wheel.radius)
    return replace(t, setup=replace(t.setup, wheel=wheel))


def _forces_in_kilograms(t: Sound) -> Sound | None:
    """The table with both forces of load cells, pull and load, in kilograms; None without either
    column.
    """
    pull = MISTAKES["pull in kilograms"](t)
    return pull and MISTAKES["load in kilograms"](pull)


#: What is wrong with a table, by name; None where the table has no such column.
MISTAKES: dict[str, Callable[[Sound], Sound | None]] = {
    "load in kilograms": _changed("load", lambda x: x / GRAVITY),
    "pull in kilograms": _changed("drawbar_pull", lambda x: x / GRAVITY),
    "load and pull in kilograms": _forces_in_kilograms,
    "torque in kilogram metres": _changed("torque", lambda x: x / GRAVITY),
    "torque in newton millimetres": _changed("torque", lambda x: 1e3 * x),
    "sign of the pull": _changed("drawbar_pull", lambda x: -x),
    "sign of the slip": _changed("slip", lambda x: -x),
    "slip over the travel speed": _changed("slip", lambda x: x / (1.0 - x)),
    "diameter for the radius": _diameter,
    "one load ten times too large": _changed("load", lambda x: 10.0 * x, one=True),
    "one sinkage ten times too large": _changed("sinkage", lambda x: 10.0 * x, one=True),
}


def told(t: Sound) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """(Sentences that doubt a table, cautions that another reading fits too), by `examine`.

    A refusal of the table counts as a doubt, and so does the note that the wrong row, or a value in
    it, is left out.
    """
    try:
        found = examine(t.table(), t.setup)
    except ParameterError as error:
        return (str(error),), ()
    row = re.compile(rf"Row {t.wrong_row}\b")
    said = (*found.said, *(text for text in found.left_out if row.match(text)))
    return said, found.undecided


@cache  # of a sound table for all mistakes
def estimate(t: Sound) -> dict[str, Parameter] | None:
    """Parameters by name as identified from the table as it is, without a check for mistakes; None
    where the table is refused.
    """
    try:
        return identify_table(t.table(), t.setup, check=False).parameters
    except ParameterError:
        return None


def matters(sound: Sound, wrong: Sound) -> bool:
    """True if a mistake moves an estimate by more than `OFF` standard deviations, an `INTERVAL`th
    of its 95 % interval from the wrong table; False where either table has no estimate.
    """
    off = estimate(wrong)
    right = None if off is None else estimate(sound)
    if right is None or off is None:
        return False
    return any(
        abs(off[name].value - p.value) > OFF * (off[name].high - off[name].low) / INTERVAL
        for name, p in right.items()
        if not p.known
    )


@click.command(help=__doc__)
@click.option("--tables", type=WholeNumber(1), default=60, metavar="N", help="Sound tables.")
@click.option("--sound-only", is_flag=True, help="No tables with mistakes.")
@click.option(
    "--only", multiple=True, type=click.Choice(list(MISTAKES)), help="This mistake, not all."
)
@seed_option()
def main(tables: int, sound_only: bool, only: tuple[str, ...], seed: int) -> None:
    """Print what is said of sound tables, how often they are doubted and cautioned, and how often
    each mistake is found where it matters.
    """
    drawn = list(sound_tables(tables, seed))
    doubted = [told(t) for t in drawn]
    for t, (said, undecided) in zip(drawn, doubted, strict=True):
        for text in (*said, *undecided):
            print(f"  {t.what}: {text}")
    print_share("sound, doubted", [bool(said) for said, _ in doubted])
    print_share("sound, cautioned", [bool(undecided) for _, undecided in doubted])
    if sound_only:
        return
    for name in only or MISTAKES:
        pairs = [(t, MISTAKES[name](t)) for t in drawn]
        found = [told(w) for t, w in pairs if w is not None and matters(t, w)]
        print_share(f"{name}, found where it matters", [bool(said) for said, _ in found])
        print_share(f"{name}, cautioned instead", [bool(u) and not said for said, u in found])


def print_share(name: str, values: list[bool]) -> None:
    """Print how many are true, and the rate with its 95 % interval [%]; nothing without values."""
    rate = share(values)
    if rate is not None:
        low, high = (100.0 * rate[end] for end in ("low", "high"))
        print(
            f"{name}: {rate['count']} of {rate['of']}, {100.0 * rate['value']:.1f} % "
            f"[{low:.1f}, {high:.1f}]",
            flush=True,
        )


if __name__ == "__main__":
    leave(run(main, None, "benchmarks.sound_tables"))
