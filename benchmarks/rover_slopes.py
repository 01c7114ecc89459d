"""Slip over the slope of published rovers, beside the same rovers simulated.

A rover is set up as its authors have it and driven by `RoverSimulation` up uniform slopes at the published speed of
its wheels until its slip no longer changes. Its soil is known in part: soils are drawn from the ranges of
rover_slopes.yaml (Latin hypercube), and the curves of all of them are the result, not one that was tuned. Apart from
that, three parameters of the soil are fitted to one campaign and the fit is judged on another.

    python -m benchmarks.rover_slopes                                 writes docs/rover_measured.md, .json and .svg
    python -m benchmarks.rover_slopes --page                          the page and its figure anew from the .json
    python -m benchmarks.rover_slopes --smoke --out /tmp/slopes       in seconds, numbers without meaning
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.stats import qmc

from benchmarks import rover_slopes_page
from benchmarks.common import check_page, machine, study_parser
from benchmarks.rover_rigs import (
    DEPTH,
    PULL_SLIPS,
    Driven,
    Published,
    Ranges,
    Rig,
    curves,
    half,
    published,
    pulls_asked,
    pulls_of,
    wheels_alone,
)
from soil_env._io.commands import command_line, leave
from soil_env._io.files import make_folder, write_json
from soil_env._io.loading import merge, read_json
from soil_env.parameters import Soil

FREE = ("friction_angle_deg", "shear_modulus", "dig_gain")  # of a fit; the others stay where `HELD` has them
_ORDER = [f.name for f in fields(Ranges)]
HELD = (0.5, 0.0, 0.5, 0.5, 0.5, 0.5)  # in the unit cube of `Ranges`: no cohesion, the middle of all others


def rms(values: np.ndarray) -> float:
    """Root of the mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def band(of: Published, count: int, seed: int) -> dict[str, Any]:
    """Slip over the slope of `count` soils drawn from the ranges, in turn for the variants of the rover."""
    places = qmc.LatinHypercube(len(fields(of.soil)), rng=np.random.default_rng(seed)).random(count)
    kinds = len(of.variants)
    found = [curves(of, v, [of.soil.soil(u) for u in places[v::kinds]], of.slopes) for v in range(kinds)]
    slips = np.concatenate([d.slip for d in found])
    low, middle, high = np.percentile(slips, (5, 50, 95), axis=0)
    measured = {}
    for name, (slopes, slip) in of.sets().items():
        at = np.array([np.interp(slopes, of.slopes, s) for s in slips])
        errors = np.sqrt(np.mean((at - slip) ** 2, axis=1))
        inside = (np.percentile(at, 5, axis=0) <= slip) & (slip <= np.percentile(at, 95, axis=0))
        measured[name] = {
            "inside": int(inside.sum()), "points": slip.size, "rms": np.percentile(errors, (0, 50, 100)),
            "rms_of_median": rms(np.median(at, axis=0) - slip),
        }  # fmt: skip
    halves = [half(of.slopes, s) for s in slips]
    return {
        "slips": np.round(slips, 3), "low": low, "median": middle, "high": high, "measured": measured,
        "median_by_variant": [np.median(d.slip, axis=0) for d in found],
        "half": np.percentile([h if h is not None else np.inf for h in halves], (5, 50, 95), method="nearest"),
        "steady": np.concatenate([d.steady for d in found]).mean(axis=0),
    }  # fmt: skip


def _place(x: Sequence[float]) -> np.ndarray:
    """The place in the unit cube of `Ranges` with `x` [3] for `FREE`."""
    place = np.array(HELD)
    place[[_ORDER.index(name) for name in FREE]] = x
    return place


def fit(of: Published, name: str, draws: int, refined: int) -> Soil:
    """The soil nearest to a set of points, in `FREE` within the ranges: the best of `draws`, of which the first
    `refined` are improved by least squares (slip leaps to 1 where a soil fails, so one start is not enough)."""
    slopes, slips = of.sets()[name]
    drawn = qmc.LatinHypercube(len(FREE), rng=np.random.default_rng(1)).random(draws)
    found = curves(of, None, [of.soil.soil(_place(x)) for x in drawn], slopes).slip
    costs = np.sum((found - slips) ** 2, axis=1)
    best, order = (float(costs.min()), drawn[costs.argmin()]), np.argsort(costs)[:refined]
    rig = Rig(of, None, slopes.size)

    def errors(x: np.ndarray) -> np.ndarray:
        return rig.drive([of.soil.soil(_place(x))] * slopes.size, slopes).slip - slips

    for start in drawn[order]:
        improved = least_squares(errors, start, bounds=(0.0, 1.0), diff_step=0.02, max_nfev=30)
        best = min(best, (2.0 * improved.cost, improved.x), key=lambda pair: pair[0])
    return of.soil.soil(_place(best[1]))


def alternatives(of: Published, draws: int) -> dict[str, Any]:
    """The best of `draws` soils for the first set with each alternative of the rover's contact, judged on all sets."""
    found = {}
    for label, changes in ({"as it is": {}} | of.alternatives).items() if of.alternatives else ():
        other = replace(of, variants=(merge(of.variants[of.usual], changes),), usual=0)
        soil = fit(other, of.fitted[0], draws, refined=0)
        errors = {n: rms(curves(other, None, [soil], s).slip[0] - slip) for n, (s, slip) in of.sets().items()}
        found[label] = {"soil": of.soil.named(soil), "rms": errors}
    return found


def judge(of: Published, soil: Soil) -> dict[str, Any]:
    """A soil against all sets of points, and what the rover does on it over the slope."""
    measured = {}
    for name, (slopes, slips) in of.sets().items():
        d = curves(of, None, [soil], slopes)
        measured[name] = {"slip": d.slip[0], "rms": rms(d.slip[0] - slips), "rms_early": rms(d.early[0] - slips)}
    driven = Driven(*(a[0] for a in curves(of, None, [soil], of.slopes)))
    variants = [curves(of, v, [soil], of.slopes).slip[0] for v in range(len(of.variants))]
    speeds = of.law.speeds if of.law is not None else (0.5 * of.speed, of.speed)
    by_speed = [curves(replace(of, speed=v), None, [soil], of.slopes).slip[0] for v in speeds]
    return {
        "soil": of.soil.named(soil), "measured": measured, "half": half(of.slopes, driven.slip),
        "driven": driven._asdict(), "variants": variants,
        "by_speed": dict(zip(map(str, speeds), by_speed, strict=True)),
        "pull": pulls_of(of, soil), "one_wheel": wheels_alone(of, soil, of.slopes),
        "two_wheels": wheels_alone(of, soil, of.slopes, driven.load),
    }  # fmt: skip


def study(of: Published, soils: int, draws: int, refined: int, seed: int) -> dict[str, Any]:
    """All results of one rover."""
    points = of.sets()
    return {
        "slopes": of.slopes,
        "points": {
            name: {"slope": a, "slip": s, "half": half(a, s), "pull": pulls_asked(a, s)}
            for name, (a, s) in points.items()
        },
        "pull_slips": PULL_SLIPS,
        "between": {
            f"{one} for {other}": rms(np.interp(points[other][0], *points[one]) - points[other][1])
            for one in of.campaigns for other in of.campaigns if one != other
        },
        "bevameter": stiffness(of),
        "band": band(of, soils, seed),
        "fits": {name: judge(of, fit(of, name, draws, refined)) for name in of.fitted},
        "alternatives": alternatives(of, draws),
    }  # fmt: skip


def stiffness(of: Published) -> list[dict[str, Any]]:
    """Pressure [Pa] at `DEPTH` of the published plate tests, for each plate."""
    return [
        {
            "figure": f["figure"], "density": f["density"],
            "pressure": [1e3 * (f["k_c"] / b + f["k_phi"]) * DEPTH ** f["n"] for b in of.bevameter["plates"]],
        }
        for f in of.bevameter.get("fits", ())
    ]  # fmt: skip


@command_line("benchmarks.rover_slopes")
def main(arguments: list[str] | None = None) -> int:
    """Drive the rovers, and write the page; returns the exit status."""
    p = study_parser("python -m benchmarks.rover_slopes", __doc__, "rover_measured.json, .md and rover_slopes.svg")
    p.add_argument("--page", action="store_true", help="only the page and its figure, from rover_measured.json")
    options = p.parse_args(arguments)
    folder = Path(options.out)
    check_page(rover_slopes_page.PAGE, *rover_slopes_page.PARTS)
    make_folder(folder)
    file = folder / "rover_measured.json"
    if not options.page:
        soils, refined = (3, 0) if options.smoke else (96, 3)
        rovers = published()
        draws = {name: 2 if options.smoke else of.draws for name, of in rovers.items()}
        results = {
            "made": {"machine": machine(), "soils": soils, "draws": draws, "seed": 0},
            "rovers": {name: study(of, soils, draws[name], refined, 0) for name, of in rovers.items()},
        }
        write_json(file, results, None)
    rover_slopes_page.write(read_json(file), folder)
    return 0


if __name__ == "__main__":
    leave(main())
