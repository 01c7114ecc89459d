"""Cases of the easy set: a random soil, wheel and test plan, hidden effects, noise and priors.

The column `load` is the vertical load (weight) on the wheel, on a grade too; `sinkage` is below the surface in
front of the wheel; `drawbar_pull` is the net forward force on the axle, where a grade effect is hidden less the weight
component; where none is hidden the rig has already taken it off.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from benchmarks.blind.easy.forms import EFFECTS, forms_of
from benchmarks.blind.easy.limits import SOIL, Bench, Imitation, detection_limit, gap, imitation, noncentrality
from benchmarks.blind.easy.plan import MULTIPLES, PRIOR_SD, Options, draw_bench
from benchmarks.blind.easy.unlisted import UNLISTED
from benchmarks.blind.effect import Form, Hidden

CHANNELS = ("sinkage", "drawbar_pull", "torque")
ATTEMPTS = 60


@dataclass(frozen=True, eq=False)
class Case:
    """One blind case; `setup` and the columns are what the workflow may see, `truth` is not."""

    columns: dict[str, list]  # of data.csv
    setup: dict  # setup.yaml
    truth: dict  # truth.json
    clean: np.ndarray  # noise-free table [3, N]
    bench: Bench
    effects: tuple[Hidden, ...]


def draw_case(rng: np.random.Generator, kind: str = "one", design: str = "rich", **options) -> Case:
    """One case; keywords as in `Options`. Raises `RuntimeError` if no detectable one is found for the effects named."""
    want = Options(kind, design, **options)
    for attempt in range(ATTEMPTS):
        if attempt % 6 == 0:  # then other effects, if they are not given: not every one can be seen in every design
            forms = _draw_forms(rng, want)
        bench, runs, soil = draw_bench(rng, want)
        found = _draw_effects(rng, bench, forms, want)
        if found is not None:
            return _measure(rng, bench, runs, soil, found, want, attempt)
    raise RuntimeError(f"no detectable case of {', '.join(f.name for f in forms)} in {ATTEMPTS} attempts")


# --- the effects ------------------------------------------------------------------------------------------------------


def _draw_forms(rng, want: Options) -> list[Form]:
    if want.kind == "none":
        return []

    def one_of(forms):
        forms = [f for f in forms if not want.forms or f.name in want.forms] or forms
        return forms[rng.integers(len(forms))]

    count = 2 if want.kind == "two" else 1
    pool = [f.effect for f in UNLISTED] if want.kind == "unlisted" else EFFECTS
    names = list(want.names)
    while len(names) < count:
        name = pool[rng.integers(len(pool))]
        if name not in names:
            names.append(name)
    return [one_of([f for f in UNLISTED if f.effect == n] if want.kind == "unlisted" else forms_of(n)) for n in names]


@dataclass(frozen=True, eq=False)
class _Found:
    """Hidden effects with what is known of how well they show, in the same order."""

    effects: tuple[Hidden, ...] = ()
    limits: tuple[float, ...] = ()  # detection limits, the other effect's strength refitted
    rivals: tuple[Imitation, ...] = ()  # listed effects in place of this one, the other effect kept


def _draw_effects(rng, bench: Bench, forms: list[Form], want: Options) -> _Found | None:
    """Effects at their strengths, or None if one cannot be seen at a sensible strength or the wheel gets stuck."""
    context = bench.context
    hidden = [Hidden(f, float(f.signs[rng.integers(len(f.signs))]), f.side(rng, context)) for f in forms]
    place = rng.uniform(size=len(hidden))  # between the least and the largest strength, log-uniformly
    limits = [0.0] * len(hidden)
    for k in [*range(len(hidden)), *range(len(hidden) - 1)]:  # the first of two again, once the second is there
        others = hidden[:k] if limits[-1] == 0.0 else hidden[:k] + hidden[k + 1 :]
        limit = detection_limit(bench, hidden[k], others)
        if limit is None:
            return None
        strength = _strength(rng, bench, hidden[k].form, limit, place[k], want)
        if strength is None:
            return None
        limits[k], hidden[k] = limit, hidden[k].at(np.sign(hidden[k].strength) * strength)
    for _ in range(4):
        table = bench.truth(hidden)
        if not np.all(np.isfinite(table)) or np.max(table[0]) > 0.7 * bench.wheel.radius:
            return None
        names = _names(hidden)
        rivals = [imitation(bench, table, hidden[:k] + hidden[k + 1 :], names, rng) for k in range(len(hidden))]
        short = [_shortfall(e, p, r, want) for e, p, r in zip(hidden, place, rivals, strict=True)]
        if max(short, default=1.0) <= 1.05:
            break
        hidden = [e.at(e.strength * max(f, 1.0)) for e, f in zip(hidden, short, strict=True)]
        if any(abs(e.strength) > e.form.cap(context) for e in hidden):
            return None
    else:
        return None
    if len(hidden) == 2 and want.multiple[0] >= 2.0 and not _both_needed(rng, bench, table, hidden):
        return None
    return _Found(tuple(hidden), tuple(limits), tuple(rivals))


def _names(hidden) -> set[str]:
    return {e.form.effect for e in hidden}


def _strength(rng, bench: Bench, form: Form, limit: float, place: float, want: Options) -> float | None:
    """Strength between the multiples of the limit, at most the cap; None if the least is beyond the cap."""
    cap = form.cap(bench.context)
    low, high = (m * limit for m in want.multiple)
    if form.scales_grade and want.multiple == MULTIPLES:
        high = np.inf  # the weight component of a real slope is far above what can be seen
    low, high = max(low, form.floor), min(max(high, form.floor), cap)
    return None if low > cap else float(low * (high / low) ** place)


def _shortfall(effect: Hidden, place: float, rival: Imitation, want: Options) -> float:
    """Factor by which the strength must grow to be told from other listed effects as clearly as asked for."""
    if want.kind == "unlisted" and want.design == "rich" and want.multiple[0] >= 2.0:
        return float(np.sqrt(4.0 * noncentrality(2) / max(rival.worst, 1e-3)))
    if want.scale == "naming" and want.kind != "unlisted":
        low, high = want.multiple[0], min(want.multiple[1], 4.0 * want.multiple[0])
        multiple = low * (high / low) ** place
        return float(multiple * np.sqrt(noncentrality(effect.form.freedom) / max(rival.one, 1e-3)))
    return 1.0


def _both_needed(rng, bench: Bench, table, hidden) -> bool:
    """Whether neither effect alone, nor any third listed one alone, leaves less than at twice the detection limit."""
    for k, effect in enumerate(hidden):
        if gap(bench, table, [hidden[1 - k]]) < 0.9 * 4.0 * noncentrality(effect.form.freedom):
            return False
    return imitation(bench, table, [], _names(hidden), rng).one >= 4.0 * noncentrality(1)


# --- measuring and writing --------------------------------------------------------------------------------------------


def _measure(rng, bench: Bench, runs, soil: str, found: _Found, want: Options, rejected: int) -> Case:
    effects = found.effects
    clean = bench.truth(effects)
    noise = np.array(bench.noise)[:, None]
    measured = clean + noise * rng.standard_normal(clean.shape)
    wrong = np.zeros(clean.shape, bool)
    if want.outliers:
        wrong = rng.random(clean.shape) < 0.02
        gross = rng.uniform(5.0, 15.0, clean.shape) * rng.choice((-1.0, 1.0), clean.shape)
        measured = np.where(wrong, clean + noise * gross, measured)
    conditions = bench.conditions(effects)
    columns = {
        "run": runs,
        "time": conditions.time.tolist(),
        "slip": conditions.slip.tolist(),
        "load": conditions.load.tolist(),
        "speed": conditions.speed.tolist(),
        "pass": [int(p) for p in conditions.passes],
    }
    if want.design == "rich":
        columns["grade_deg"] = [float(np.round(g, 4)) for g in conditions.grade_deg]
    columns |= {name: [float(f"{v:.6g}") for v in row] for name, row in zip(CHANNELS, measured, strict=True)}
    setup = {
        "wheel": {"radius": bench.wheel.radius, "width": bench.wheel.width},
        "soil": _priors(rng, bench, want.prior_error) | {"density": bench.ground.density},
    }
    if want.noise == "given":
        setup["noise"] = {name: float(f"{s:.3g}") for name, s in zip(CHANNELS, bench.noise, strict=True)}
    truth = {
        **asdict(want),
        "multiple": [m if np.isfinite(m) else None for m in want.multiple],
        "rejected": rejected,  # draws before this one that could not be seen
        "wrong_cells": int(wrong.sum()),
        "soil_type": soil,
        "soil": asdict(bench.ground),
        "noise_levels": dict(zip(CHANNELS, bench.noise, strict=True)),
        "gap": gap(bench, clean) if effects else 0.0,  # of all effects together
        "effects": [_described(bench, clean, found, k) for k in range(len(effects))],
    }
    return Case(columns, setup, truth, clean, bench, effects)


def _described(bench: Bench, clean, found: _Found, k: int) -> dict:
    """Truth about one effect; `multiple` is of strengths, `shown` and `named` are roots of gap over noncentrality."""
    effect, limit, rival = found.effects[k], found.limits[k], found.rivals[k]
    others = found.effects[:k] + found.effects[k + 1 :]
    wanted = noncentrality(effect.form.freedom)
    return {
        "name": effect.form.effect,
        "form": effect.form.name,
        "strength": effect.strength,
        "unit": effect.form.strength,
        "side": effect.side,
        "channels": list(effect.form.channels),
        "source": effect.form.source,
        "cap": effect.form.cap(bench.context),
        "limit": limit,
        "multiple": abs(effect.strength) / limit,
        "shown": float(np.sqrt(gap(bench, clean, others) / wanted)),  # against the model without it
        "named": float(np.sqrt(rival.one / wanted)),  # against the best other listed effect in its place
        "rival": rival.one_name,
        "rivals": {name: float(np.sqrt(value / wanted)) for name, value in sorted(rival.each.items())},
        "rival_pair": {"names": rival.two_names, "named": float(np.sqrt(rival.worst / wanted))},
    }


def _priors(rng, bench: Bench, error: str) -> dict:
    """Prior of each soil parameter, its value off the truth by its sd times N(0, 1), or by 2 sd either way."""
    out = {}
    for name in SOIL:
        true, sd = getattr(bench.ground, name), bench.prior_sd[name]
        value = -1.0
        while value <= 0.02 * true:
            off = {"normal": rng.standard_normal(), "2sd": rng.choice((-2.0, 2.0)), "none": 0.0}[error]
            value = true + sd * off
        out[name] = {"value": float(f"{value:.6g}"), "sd": float(f"{PRIOR_SD[name](value):.3g}")}
    return out
