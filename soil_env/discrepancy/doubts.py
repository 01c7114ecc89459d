"""Doubts about a table: mistakes of sign and unit, and single rows that decide what is named.

Two things speak for a mistake. The base model fits the table far better when it is read otherwise,
for instance with the sign of the drawbar pull turned. Or the table breaks a physical limit of a
wheel on soil. Where both hold the table is refused; one of them alone is a doubt that a report
states first.

The measured values of a row are checked by the rows beside it (`noise`). A row at a slip or load
that no other row comes near is checked by none, and a mistyped condition makes such a row.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env.discrepancy.calibrate import GRAVITY, Problem, calibrate
from soil_env.discrepancy.instrument import LISTED
from soil_env.discrepancy.search import Finding, search
from soil_env.identification.table.data import Data, prepare
from soil_env.identification.table.noise import NoiseEstimate
from soil_env.measurement.doubts import contact_area, load_doubt
from soil_env.measurement.table import in_radians
from soil_env.terramechanics.model import Rows

LARGE = 3.0  # [noise] rms of what the base model leaves, below which no mistake is looked for
#: Times smaller that its mean square above the noise has to get where the table is read otherwise.
BETTER = 10.0
FALLS = 0.8  # share of the groups of rows in which the drawbar pull falls with slip
LOW_SLIP = 0.2  # slip below which a group must begin for a fall to say anything
LEAST_SPAN = 0.15  # of the slips of a group, for the same
SURE = 4.0  # [sd] beyond the setup's value at which a soil parameter is not sought
STEEPEST = 50.0  # [deg] friction angle where the setup says nothing
FEW = 20  # rows for each one that may stand alone; in a smaller table most of them do
#: Share of the load, largest in a table, below which a force is in another unit: rolling takes
#: more.
WEAK = 2e-3


class Reinterpretation(NamedTuple):
    """The table read otherwise."""

    name: str
    words: str  # "with ...", in a sentence
    remedy: str
    problem: Problem


def of_table(problem: Problem) -> tuple[str, ...]:
    """Return doubts about signs and units, none as a rule; raise `ParameterError` where the table
    cannot be right.
    """
    load = load_doubt(problem.data.table, problem.data.setup)
    always = (*filter(None, (load,)), *problem.data.setup.doubts(), *_grades_doubted(problem.data))
    dead = _channels_doubted(problem)
    if dead:  # what else could be read into such a table says nothing
        return (*dead, *always)
    rms = _rms(problem)
    if rms < LARGE:
        return always
    tried = [(_rms(reading.problem), reading) for reading in _reinterpretations(problem)]
    better = [
        (other, reading) for other, reading in tried if BETTER * (other**2 - 1.0) < rms**2 - 1.0
    ]
    if better:
        other, reading = min(better, key=lambda f: f[0])
        text = (
            f"{reading.words}, the base model misses the table by {other:.2g} times the noise "
            f"instead of {rms:.2g}: {reading.remedy}"
        )
        broken = {"pull": _pull_falls, "load": _beyond_strength}.get(
            reading.name, lambda problem: ""
        )(problem)
        if broken:
            raise ParameterError(
                f"{problem.data.table.source}: {broken}; {text[:1].lower()}{text[1:]}"
            )
        return (f"{text}.", *always)
    if falls := _pull_falls(problem):
        return (f"{falls}: check the sign of drawbar_pull (positive = the wheel pulls).", *always)
    return always


def _grades_doubted(data: Data) -> tuple[str, ...]:
    """A doubt where the only grade of the table is that of whole degrees in radians."""
    grades = data.table.grade_deg[data.table.grade_deg != 0.0]
    if not in_radians([repr(float(g)) for g in grades]):
        return ()
    angle = math.degrees(abs(float(grades[0])))
    return (f"grade_deg = {abs(grades[0]):g} is {angle:.0f} degrees in radians: expected degrees.",)


def _channels_doubted(problem: Problem) -> tuple[str, ...]:
    """Doubts of channels that hold one value at all slips, or forces that are far too small for
    newtons.
    """
    data = problem.data
    out = []
    # A wheel that climbs freely pulls nothing.
    free = data.setup.load == "vertical" or "grade_deg" in data.varied
    size = data.rows.load * data.rows.wheels[:, 0]
    for j, name, unit, over in (
        (0, "sinkage", "", data.rows.wheels[:, 0]),
        (1, "drawbar_pull", "newtons", data.rows.load),
        (2, "torque", "newton metres", size),
    ):
        known = data.measured[:, j]
        y = data.y[known, j]
        slips = data.rows.slip[known]
        if y.size < 4 or np.ptp(slips) < LEAST_SPAN or (j == 1 and free and not np.any(y)):
            continue
        largest = float(np.max(np.abs(y) / over[known]))
        if np.ptp(y) == 0.0:
            out.append(
                f"{name} is {y[0]:g} in every row: expected measured values, which change with "
                "slip."
            )
        elif unit and largest < WEAK:
            against = "the load" if j == 1 else "load times radius"
            out.append(
                f"{name} is at most {largest:.2g} times {against}: expected {unit} (if it is "
                f"kilo{unit}, times 1000)."
            )
    return tuple(out)


def _rms(problem: Problem) -> float:
    return math.sqrt(float(np.mean(problem.fit().residual ** 2)))


def _reinterpretations(problem: Problem) -> list[Reinterpretation]:
    data = problem.data
    rows = problem.data.rows
    out = []

    def add(name, words, remedy, **changes):
        noise = problem.noise * changes.pop("scale", np.ones(3))
        used = changes.pop("used", problem.used)
        there = dataclasses.replace(data, **changes)
        out.append(
            Reinterpretation(name, words, remedy, Problem(there, noise, used, problem.freedom))
        )

    if problem.used[:, 1].any():
        add(
            "pull",
            "With the sign of drawbar_pull turned",
            "expected drawbar_pull positive where the wheel pulls",
            y=data.y * [1.0, -1.0, 1.0],
        )
        add(
            "pull_kg",
            f"With drawbar_pull as kilograms (times {GRAVITY})",
            "expected drawbar_pull in newtons",
            y=data.y * [1.0, GRAVITY, 1.0],
            scale=np.array([1.0, GRAVITY, 1.0]),
        )
    if problem.used[:, 2].any():
        add(
            "torque_kg",
            f"With torque as kilogram metres (times {GRAVITY})",
            "expected torque in newton metres",
            y=data.y * [1.0, 1.0, GRAVITY],
            scale=np.array([1.0, 1.0, GRAVITY]),
        )
    if problem.used[:, 1:].any(axis=0).all():
        swapped = [0, 2, 1]
        # Else the setup gives it by the name of the channel.
        of_table = math.isfinite(problem.freedom)
        scale = problem.noise[swapped] / problem.noise if of_table else np.ones(3)
        add(
            "columns",
            "With the columns of drawbar_pull and torque exchanged",
            "expected drawbar_pull in newtons and torque in newton metres, each in its own column",
            y=data.y[:, swapped],
            scale=scale,
            used=problem.used[:, swapped],
        )
    add(
        "load",
        f"With load as kilograms (times {GRAVITY})",
        "expected load in newtons",
        rows=rows._replace(load=rows.load * GRAVITY),
    )
    if problem.used[:, 1:].any():  # sinkage alone may rise or fall with slip
        add(
            "slip",
            "With the sign of slip turned",
            "expected slip positive where the wheel drives",
            rows=rows._replace(slip=-rows.slip),
        )
    if not np.any(np.isfinite(data.table.wheel_radius)) and data.wheel.radius >= 0.02:
        half = 0.5 * data.wheel.radius
        if not np.any(data.y[:, 0] > half):
            add(
                "radius",
                f"With wheel.radius of the setup halved to {half:g} m",
                "expected the radius, not the diameter",
                wheel=dataclasses.replace(data.wheel, radius=half),
                rows=_resized(rows, half),
            )
    return out


def _resized(rows: Rows, radius: float) -> Rows:
    wheels = rows.wheels.copy()
    wheels[:, 0] = radius
    return rows._replace(wheels=wheels)


def _pull_falls(problem: Problem) -> str:
    """The drawbar pull falls with slip from low slip on, below 0 at much slip, in nearly all groups
    of rows.
    """
    data = problem.data
    falls = []
    first = []
    last = []
    for rows in data.groups:
        rows = rows[problem.used[rows, 1]]
        slip = data.rows.slip[rows]
        if (
            rows.size < 3
            or slip.min() < -0.05
            or slip.min() > LOW_SLIP
            or np.ptp(slip) < LEAST_SPAN
        ):
            continue
        order = np.argsort(slip)
        pull = data.y[rows[order], 1]
        slip = slip[order]
        slope = np.polyfit(slip, pull, 1)[0]
        falls.append(
            slope * np.ptp(slip) < -3.0 * problem.noise[1] and pull[-1] < min(pull[0], 0.0)
        )
        first.append(pull[0])
        last.append(pull[-1])
    if not falls or np.mean(falls) < FALLS:
        return ""
    where = (
        "in every group of rows"
        if all(falls)
        else f"in {100.0 * np.mean(falls):.0f} % of the groups of rows"
    )
    return (
        f"drawbar_pull falls with slip {where} that differ in slip alone, from "
        f"{np.median(first):.3g} N at the least to {np.median(last):.3g} N at the largest slip"
    )


def _beyond_strength(problem: Problem) -> str:
    """The thrust is larger than a soil within the priors can bear at that load: c A + W tan(phi) on
    the contact.
    """
    data = problem.data
    priors = problem.data.setup.soil
    if priors.cohesion is None:
        return ""
    cohesion = priors.cohesion.value + SURE * priors.cohesion.sd
    phi = priors.friction_angle_deg
    tangent = math.tan(
        math.radians(STEEPEST if phi is None else min(phi.value + SURE * phi.sd, STEEPEST))
    )
    radius = data.rows.wheels[:, 0]
    width = data.rows.wheels[:, 1]
    depth = np.clip(np.nan_to_num(data.y[:, 0], nan=0.3 * float(radius[0])), 0.02 * radius, radius)
    bearable = cohesion * contact_area(depth, radius, width) + tangent * data.rows.load
    for j, name, force in (
        (2, "torque/radius", data.y[:, 2] / radius),
        (1, "drawbar_pull", data.y[:, 1]),
    ):
        share = (force / bearable)[problem.used[:, j] & (data.rows.slip > 0.15)]
        if share.size > 2 and np.median(share) > 1.0:
            return (
                f"{name} is {np.median(share):.2g} times the strength that the setup's soil has "
                "under this load, in the middle of the rows with slip above 0.15"
            )
    return ""


def of_lone_rows(
    problem: Problem, noise: NoiseEstimate, finding: Finding, say: Callable[[str], None]
) -> tuple[str, ...]:
    """Return a doubt where rows that stand alone in their conditions decide what is named, none as
    a rule.
    """
    table = problem.data.table
    alone = np.flatnonzero(noise.alone)
    if not 0 < alone.size <= len(table) // FEW:
        return ()
    say("searching without the rows that stand alone")
    try:
        others, _ = calibrate(prepare(table.only(~noise.alone), problem.data.setup))
    except ParameterError:  # too little is left
        return ()
    found = search(others, lambda text: say(f"searching without the rows that stand alone: {text}"))
    if (found.verdict, {*found.names}) == (finding.verdict, {*finding.names}):
        return ()
    rows = ", line ".join(
        f"{table.row[k]} (slip {table.slip[k]:g}, load {table.load[k]:g} N)" for k in alone
    )
    named = " and ".join(LISTED[name].title for name in found.names) or "nothing"
    one = alone.size == 1
    return (
        (
            f"Line {rows} {'stands' if one else 'stand'} alone in {'its' if one else 'their'} "
            f"conditions and {'decides' if one else 'decide'} what is named: without "
            f"{'it' if one else 'them'} that is {named}. Check slip and load there."
        ),
    )
