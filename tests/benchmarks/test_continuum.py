"""The wheel on a continuum: the laws that its soil and its contact have to keep."""

import math

import numpy as np
import pytest

from benchmarks.common import RESULTS, read_json
from benchmarks.continuum import __main__ as continuum, loop, rig as rows_of
from benchmarks.continuum.soil import EDGE, GRAVITY, Bed, strain
from benchmarks.continuum.wheel import FASTEST_OUT, HELD, START, Rig, outline
from soil_env.parameters import soils
from soil_env.terramechanics.model import ModelWheel, WheelSoilModel
from soil_env_agents.cells import in_process

SAND = rows_of.SOILS["sand"]
LOAM = rows_of.SOILS["loam"]
# [m] of a bed that is quick to compute
COARSE = Bed(length=0.6, depth=0.12, spacing=0.02)
SMOOTH = rows_of.SHAPES["smooth"]
LUGGED = rows_of.SHAPES["lugged"]
LOAD = 60.0  # [N]


def rig(material=SAND, shape=SMOOTH, slope=0.0):
    """A wheel with `LOAD` on a coarse bed that has come to rest on a `slope` [rad]."""
    return Rig(COARSE, material, shape, LOAD, np.random.default_rng(0), slope)


def strengths(particles, material):
    """(square root of J2, strength at their pressure) [Pa] of all particles, [n] each; soil yields
    where the first would exceed the second.
    """
    xx, zz, xz, yy = particles.stress.T
    pressure = -(xx + zz + yy) / 3.0
    deviators = (xx + pressure) ** 2 + (zz + pressure) ** 2 + (yy + pressure) ** 2
    return np.sqrt(0.5 * deviators + xz**2), material.friction * pressure + material.cohesion


def test_a_bed_at_rest_bears_its_own_weight():
    bed = rig()
    depth = np.mean(bed.surface - bed.particles.position[:, 1])
    upright = -np.mean(bed.particles.stress[:, 1])
    assert upright == pytest.approx(SAND.density * GRAVITY * depth, rel=0.05)


def test_soil_that_touches_nothing_falls_freely():
    falling = rig()
    falling.particles.position[:, 1] += 0.1
    for values in (
        falling.particles.velocity,
        falling.particles.gradient,
        falling.particles.stress,
    ):
        values[:] = 0.0
    falling.body = falling.body._replace(load=0.0)
    steps = round(0.05 / falling.step.time)
    falling.forward(0.05)
    velocity = falling.particles.velocity
    assert velocity[:, 0] == pytest.approx(0.0, abs=1e-9)
    assert velocity[:, 1] == pytest.approx(-GRAVITY * steps * falling.step.time, rel=1e-9)


def test_a_grain_that_swells_has_a_largest_volume():
    bed = rig()
    bed.particles.gradient[0] = np.eye(2) * 0.01 / bed.step.time
    for _ in range(200):
        strain(bed.particles, 0, bed.step)
    assert bed.particles.volume[0] == pytest.approx(bed.step.swollen)


def test_a_lug_that_overruns_a_grain_does_not_throw_it():
    wheel = rig(shape=LUGGED)
    held = wheel.wheel
    # 6 mm below the rim, inside the lowest lug
    away = np.array([1e-4, -LUGGED.radius - 0.006])
    assert outline(*away, held.angle, LUGGED)[0] < -0.004
    wheel.particles.position[0] = away + (held.x, held.z)
    wheel.particles.velocity[:] = 0.0
    wheel.wheel.along = wheel.wheel.speed = 0.0
    fastest = 0.0
    for _ in range(40):
        wheel.forward(wheel.step.time)
        fastest = max(fastest, float(np.abs(wheel.particles.velocity[0]).max()))
    assert 0.1 < fastest < 3.0 * FASTEST_OUT


def test_grains_that_are_thrown_stay_on_the_grid():
    thrown = rig()
    top = thrown.particles.position[:, 1] > COARSE.depth - thrown.bed.between
    thrown.particles.velocity[top] = 6.0, 6.0  # [m/s] along and up
    thrown.forward(0.2)
    position = thrown.particles.position
    assert np.all(np.isfinite(position)) and position[:, 1].max() > COARSE.depth + 0.2
    assert np.all(position[:, 1] < COARSE.depth + COARSE.headroom + EDGE * COARSE.spacing)


@pytest.mark.parametrize(("material", "shape"), [(SAND, SMOOTH), (LOAM, LUGGED)])
def test_a_wheel_at_rest_is_carried_and_no_soil_is_stronger_than_it_is(material, shape):
    still = rig(material, shape)
    still.forward(0.6)
    still.forward(0.4)  # `forces` are the means of this time alone
    assert shape.width * still.forces.up == pytest.approx(LOAD, rel=0.02)
    assert abs(shape.width * still.forces.along) < 0.02 * LOAD
    assert still.sinkage > -shape.lug_height and still.wheel.x == START
    stress, strength = strengths(still.particles, material)
    assert np.all(stress <= strength + 1e-6 * (1.0 + strength))


def test_a_wheel_that_slips_more_pulls_more_and_sinks_deeper():
    found = {}
    for slip in (0.05, 0.5):
        driven = rig()
        driven.wheel.along = 0.2 * (1.0 - slip)
        driven.wheel.speed = 0.2 / SMOOTH.radius
        driven.forward(0.3)
        driven.forward(0.3)
        found[slip] = driven.forces.along, driven.forces.torque, driven.sinkage
    assert all(more > less for more, less in zip(found[0.5], found[0.05], strict=True))


def test_the_motor_turns_a_free_wheel_and_gravity_pulls_it_back_on_a_slope():
    level = rig()
    uphill = rig(slope=math.radians(40.0))
    # The command is a share of the no-load speed: 0.3 of 5 rad/s.
    for free, seconds, command in ((level, 0.5, 0.3), (uphill, 0.1, 0.0)):
        free.let_go(mass=LOAD / GRAVITY, inertia=0.5, stall_torque=20.0, no_load_speed=5.0)
        free.forward(seconds, command, True)
    assert uphill.wheel.along < 0.0
    assert level.wheel.along > 0.02 and level.wheel.speed == pytest.approx(1.5, abs=0.3)
    assert level.body.mass_along < HELD  # infinite before the wheel is let go


@pytest.mark.parametrize("shape", [SMOOTH, LUGGED])
def test_the_normal_of_a_wheel_is_the_slope_of_the_distance_to_it(shape):
    """By differences at 300 random points; `kinks` counts those where they do not agree."""
    rng = np.random.default_rng(1)
    step = 1e-7
    kinks = 0
    for away, at, angle in rng.uniform([-0.01, 0.0, -7.0], [0.03, 2.0 * math.pi, 7.0], (300, 3)):
        x = (shape.radius + away) * math.cos(at)
        z = (shape.radius + away) * math.sin(at)
        distance, *normal = outline(x, z, angle, shape)
        assert math.hypot(*normal) == pytest.approx(1.0)
        further = outline(x + step, z, angle, shape)[0], outline(x, z + step, angle, shape)[0]
        kinks += not np.allclose((np.array(further) - distance) / step, normal, atol=0.1)
    assert kinks <= 15


def test_lugs_turn_with_the_wheel_clockwise():
    """The lug that lies along x at angle 0 has its top 0.1 rad below that at angle 0.1 rad."""
    top = LUGGED.radius + LUGGED.lug_height
    on_top = top * math.cos(-0.1), top * math.sin(-0.1)
    assert outline(*on_top, 0.1, LUGGED)[0] == pytest.approx(0.0, abs=1e-12)
    assert outline(*on_top, 0.0, LUGGED)[0] > 0.005


def test_tables_go_on_with_what_is_missing(tmp_path, monkeypatch, capsys):
    """Of a table of two rows the second is cut off: only that is measured again."""
    monkeypatch.setattr(continuum, "LOADS", (40.0,))
    monkeypatch.setattr(continuum, "SLIPS", (0.1, 0.2))
    asked = []
    row = [0.01, 5.0, 2.0, 1e-4, 0.1, 0.01]
    monkeypatch.setattr(rows_of, "row", lambda cell: asked.append(cell) or row)
    monkeypatch.setattr(
        continuum, "processes", lambda work, cells, workers: in_process(work, cells)
    )
    wanted = ["rig", "--out", str(tmp_path), "--only", "loam_lugged"]
    assert continuum.main(wanted) == 0
    file = tmp_path / "loam_lugged.csv"
    lines = file.read_text().splitlines()
    assert len(asked) == 2 and lines[0].startswith("slip,load,speed,sinkage")
    file.write_text("\n".join(lines[:2]) + "\n")
    assert continuum.main(wanted) == 0
    assert len(asked) == 3 and file.read_text().splitlines() == lines


def test_soil_piles_up_within_some_radii_of_travel():
    """Before a braked wheel, on a bed that is coarse but long enough: 0.02 to 0.4 m."""
    assert 0.02 < rows_of.piling(("sand", 80.0), COARSE._replace(length=1.2)) < 0.4


def test_the_rule_is_tuned_to_the_steepest_grade_of_its_slip():
    model = WheelSoilModel(ModelWheel(SMOOTH.radius, SMOOTH.width), soils()["lete_sand"])
    grade, drive = loop.tuned(SMOOTH, model)
    assert 0.0 < grade < loop.GRADES[-1] and drive.slip <= loop.SLIP
    steeper = loop.simulated(SMOOTH, grade + 0.5, model)
    assert steeper.slip > loop.SLIP and steeper.distance < drive.distance


def test_a_drive_on_the_continuum_slips_more_uphill(monkeypatch):
    monkeypatch.setattr(loop, "SECONDS", 2.0)
    bed = COARSE._replace(length=0.8)
    drives = []
    for grade in (0.0, 6.0):
        slope = math.radians(grade)
        load = loop.LOAD * math.cos(slope)
        wheel = Rig(bed, SAND, SMOOTH, load, np.random.default_rng(0), slope)
        drives.append(loop.on_continuum(wheel, loop.scenario_of(SMOOTH, grade), grade))
    level, uphill = drives
    assert level.slip < uphill.slip < 1.0 and 0.0 < uphill.distance < level.distance
    assert uphill.sinkage > 0.0


def test_drives_without_meaning_are_not_gone_on_with(tmp_path, monkeypatch):
    """Six drives of a smoke run, all six anew in a full run, and none when that is done."""
    kept = read_json(RESULTS / "continuum.json")
    drive = loop.Drive._make([0.1] * len(loop.Drive._fields))
    driven = []

    def here(work, cells, workers):
        """Stand-in for `processes`: the same drive for all cells, whose number is noted."""
        driven.append(len(cells))
        return dict.fromkeys(cells, drive).items()

    monkeypatch.setattr(continuum, "_learnt", lambda table: {**kept[table]})
    monkeypatch.setattr(continuum, "processes", here)
    wanted = ["loop", "--out", str(tmp_path), "--only", "loam_lugged"]
    assert [continuum.main([*wanted, *more]) for more in (["--smoke"], [], [])] == [0, 0, 0]
    assert driven == [6, 6, 0]


def test_the_page_shows_the_kept_figures():
    kept = read_json(RESULTS / "continuum.json")
    page = (RESULTS / "continuum.md").read_text(encoding="utf-8")
    for heading, table in continuum.pages(kept, continuum.BEDS).items():
        assert f"## {heading}\n\n{table.markdown()}" in page
    # Drives beyond those that are asked for do not count: here those of the third bed.
    fewer = continuum.pages(kept, 2)
    for of in kept.values():
        of["drives"] = {key: drive for key, drive in of["drives"].items() if not key.endswith(" 2")}
    assert continuum.pages(kept, 2) == fewer


def test_the_shipped_tables_are_whole():
    for table in rows_of.WHEELS:
        rows = rows_of.read(continuum.TABLES / f"{table}.csv")
        wanted = {(load, slip) for load in continuum.LOADS for slip in continuum.SLIPS}
        assert rows.keys() == wanted, table
