"""Cases of the benchmark: sets, groups, hidden effects, and a table and a setup as files with the
truth apart.

A case follows from the seed, its group and its number alone. Loads of a table are normal to the
ground, and sinkage is below the surface in front of the wheel. Pull is the net forward force on the
axle, less the weight component where a grade effect is hidden. Laws err by 10 %, in all kinds of
ways (`laws.smooth`, `laws.log_slip`, `laws.regimes`).
"""

import csv
import hashlib
import zlib
from collections.abc import Callable
from dataclasses import asdict, dataclass
from itertools import combinations
from pathlib import Path
from typing import NamedTuple

import numpy as np
import yaml

from benchmarks.common import short
from benchmarks.discovery.forms import MECHANISMS, forms_of
from benchmarks.discovery.fresh import FRESH
from benchmarks.discovery.hidden import CHANNELS, Form, Hidden
from benchmarks.discovery.laws import log_slip, regimes, smooth
from benchmarks.discovery.plan import PRIOR_SD, SOIL, Bench, Measure, draw_bench
from benchmarks.discovery.unlisted import INSTRUMENT, UNLISTED
from soil_env._io.files import write_json
from soil_env._io.loading import ParameterError

ERROR = 0.1  # size of the law errors
LEAST = 2.0  # detection limits from which a case counts for the targets
SEEN = (LEAST, 8.0)  # sizes that are sought, in detection limits
PAIRS = tuple(combinations(MECHANISMS, 2))
ATTEMPTS = 8  # tables that are drawn in search of one in which the effects can be seen
DEEPEST = 0.7  # sinkage over the radius, with effects


@dataclass(frozen=True)
class Group:
    """Cases of one sort."""

    kind: str  # one, two, none, unlisted or instrument
    count: int
    sort: str = ""  # held: unlisted kinds that are held back
    of_slip: Callable = smooth  # kind of the law errors

    @property
    def name(self) -> str:
        """Kind, sort, size of the law errors in percent and their kind, as in the names of the
        cases.
        """
        kind = "" if self.of_slip is smooth else self.of_slip.__name__
        return "-".join(filter(None, (self.kind, "rich", self.sort, f"{100 * ERROR:.0f}", kind)))

    def hidden(self, index: int) -> list[Form]:
        """Return the forms that are hidden in a case: mechanisms and forms take turns."""
        index += zlib.crc32(self.name.encode()) % 1009  # groups do not all begin with the same ones
        if self.kind == "none":
            return []
        if self.kind in ("unlisted", "instrument"):
            kinds = (
                INSTRUMENT
                if self.kind == "instrument"
                else FRESH
                if self.sort == "held"
                else UNLISTED
            )
            return [kinds[index % len(kinds)]]
        if self.kind == "two":
            names = PAIRS[31 * index % len(PAIRS)]  # all pairs before any comes again
        else:
            names = (MECHANISMS[index % len(MECHANISMS)],)
        turn = index // len(MECHANISMS) if self.kind == "one" else index
        return [forms_of(n)[(turn + k) % len(forms_of(n))] for k, n in enumerate(names)]


ALL = [
    Group(kind, count, sort, of_slip)
    for kind, sort, count in (
        ("one", "", len(MECHANISMS)),
        ("two", "", 9),
        ("none", "", 7),
        ("unlisted", "", 8),
        ("unlisted", "held", 12),
        ("instrument", "", 30),
    )
    for of_slip in (smooth, log_slip, regimes)
]
GROUPS = {group.name: group for group in ALL}


class Task(NamedTuple):
    """One case."""

    group: str
    index: int

    @property
    def name(self) -> str:
        """Name of its folder and its files."""
        return f"{self.group}-{self.index:03d}"


def tasks(limit: int | None = None, held_out: bool = False) -> list[Task]:
    """Return the first `limit` cases; every beginning of the list has its share of each group.

    Groups of kinds that are held back from development come only with `held_out`.
    """
    groups = [g for g in ALL if held_out or g.sort != "held"]
    found = [((i + 0.5) / g.count, Task(g.name, i)) for g in groups for i in range(g.count)]
    return [task for _, task in sorted(found, key=lambda pair: pair[0])][:limit]


def task_of(name: str) -> Task:
    """Return the case of a name. Raises `ParameterError` where there is none."""
    group, _, index = name.rpartition("-")
    if group not in GROUPS or not index.isdigit():
        raise ParameterError(
            f"case {name!r}: expected GROUP-NUMBER, GROUP one of {', '.join(GROUPS)}"
        )
    return Task(group, int(index))


def generator() -> str:
    """Hash of the code that the cases follow from."""
    names = ("cases", "forms", "fresh", "hidden", "laws", "plan", "unlisted", "world")
    return hashlib.sha256(
        b"".join((Path(__file__).parent / f"{n}.py").read_bytes() for n in names)
    ).hexdigest()[:12]


@dataclass(frozen=True, eq=False)
class Case:
    """One case; entrants may see `columns` and `setup`, not `truth`."""

    columns: dict[str, list]  # of data.csv
    setup: dict  # setup.yaml
    truth: dict  # truth.json
    clean: np.ndarray  # noise-free table [3, N]
    bench: Bench
    effects: tuple[Hidden, ...]


def draw_case(seed: int, task: Task) -> Case:
    """Draw the case of a seed, group and number."""
    group = GROUPS[task.group]
    rng = np.random.default_rng([seed, zlib.crc32(group.name.encode()), task.index])
    forms = group.hidden(task.index)
    best = None
    measure = None
    effects = ()
    sizes = ()
    for _ in range(ATTEMPTS):
        bench = draw_bench(rng, ERROR, group.of_slip)
        measure = Measure(bench)
        effects, sizes = _strengths(rng, measure, forms, group)
        if sizes is None:
            continue
        if best is None or min(sizes, default=np.inf) > min(best[2], default=np.inf):
            best = measure, effects, sizes
        if min(sizes, default=np.inf) >= 0.97 * LEAST:
            break
    if best is None:
        raise RuntimeError(f"{task.name}: no table with a balance in {ATTEMPTS} attempts")
    return _measured(rng, seed, task, *best)


def _strengths(rng, measure: Measure, forms, group: Group):
    """(Effects whose sizes are drawn between the multiples of the limit, sizes); (.., None) if
    impossible.
    """
    bench = measure.bench
    effects = [
        Hidden(f, float(f.signs[rng.integers(len(f.signs))]), f.side(rng, bench)) for f in forms
    ]
    if group.kind == "instrument":
        cap = forms[0].cap(bench)
        floor = forms[0].floor
        effects = [effects[0].at(effects[0].strength * float(rng.uniform(floor, cap)))]
        size = measure.size(effects[0])
        return tuple(effects), (
            (size,) if np.all(np.isfinite([size, *bench.truth(effects).ravel()])) else None
        )
    wanted = [SEEN[0] * (SEEN[1] / SEEN[0]) ** rng.uniform() for _ in effects]
    sizes = [np.nan] * len(effects)
    # The first of two again, once the second is there.
    for k in [*range(len(effects)), *range(len(effects) - 1)]:
        others = [e for j, e in enumerate(effects) if j != k and np.isfinite(sizes[j])]
        strength, sizes[k] = measure.strength(effects[k], wanted[k], others)
        if strength == 0.0:
            return effects, None
        effects[k] = effects[k].at(strength)
    if group.kind == "unlisted":  # what counts is what the best listed effect would leave of it
        rival = min(measure.left(effects[0]).values())
        strength, size = measure.strength(
            effects[0], min(wanted[0] * sizes[0] / max(rival, 1e-3), 1e3)
        )
        if strength == 0.0:
            return effects, None
        effects = [effects[0].at(strength)]
        sizes = [size * rival / sizes[0]]
    table = measure.whole.truth(effects)
    if not np.all(np.isfinite(table)) or np.max(table[0] / bench.wheel.radius) > DEEPEST:
        return effects, None
    if len(effects) == 2:
        sizes = [measure.size(e, [effects[1 - k]]) for k, e in enumerate(effects)]
    return tuple(effects), (tuple(sizes) if np.all(np.isfinite(sizes)) else None)


def _measured(rng, seed: int, task: Task, measure: Measure, effects, sizes) -> Case:
    group = GROUPS[task.group]
    bench = measure.whole
    clean = bench.truth(effects)
    noise = np.array(bench.noise)[:, None]
    values = clean + noise * rng.standard_normal(clean.shape)
    stated = rng.random() < 0.8
    setup = _setup(rng, bench, stated)
    truth = {
        "case": task.name,
        "seed": seed,
        "kind": group.kind,
        "sort": group.sort,
        "law_error": ERROR,
        "law_errors": group.of_slip.__name__,
        "rows": len(bench.rows),
        "noise_stated": stated,
        "soil_type": bench.soil,
        "soil": asdict(bench.ground),
        "noise": dict(zip(CHANNELS, bench.noise, strict=True)),
        **_described(measure, effects, sizes),
    }
    return Case(_columns(bench, effects, values), setup, truth, clean, bench, effects)


def _described(measure: Measure, effects, sizes) -> dict:
    """Truth about the effects: sizes in detection limits, what listed forms leave of a single one,
    counts or not.
    """
    out = []
    counts = True
    for k, effect in enumerate(effects):
        others = [e for j, e in enumerate(effects) if j != k]
        rivals = {} if others else measure.left(effect)
        best = min(rivals, key=rivals.get) if rivals else None
        out.append(
            {
                "name": effect.form.effect,
                "form": effect.form.name,
                "source": " ".join(effect.form.source.split()),
                "strength": effect.strength,
                "unit": effect.form.strength,
                "side": {k: v for k, v in effect.side.items() if not isinstance(v, list)},
                "size": measure.size(effect, others),
                "rival": best,
                "rival_left": rivals[best] if best else None,
            }
        )
        seen = out[-1]["rival_left"] if effect.form in (*UNLISTED, *FRESH) else sizes[k]
        counts = counts and seen >= 0.97 * LEAST
    return {"effects": out, "counts": bool(counts)}


def _columns(bench: Bench, effects, values: np.ndarray) -> dict[str, list]:
    rows = bench.conditions(effects)
    columns = {
        "run": list(bench.runs),
        "time": rows.time.tolist(),
        "slip": rows.slip.tolist(),
        "load": rows.load.tolist(),
        "speed": rows.speed.tolist(),
        "pass": [int(p) for p in rows.passes],
    }
    if np.any(rows.grade_deg):
        columns["grade_deg"] = [float(np.round(g, 4)) for g in rows.grade_deg]
    return columns | {
        name: [float(f"{v:.6g}") for v in row] for name, row in zip(CHANNELS, values, strict=True)
    }


def _setup(rng, bench: Bench, noise_stated: bool) -> dict:
    """Known to the entrant: a wheel, priors of the soil that are off by their sd times N(0, 1),
    mostly the noise.
    """
    soil = {}
    for name in SOIL:
        true = getattr(bench.ground, name)
        value = -1.0
        while value <= 0.05 * true:
            value = true + bench.prior_sd[name] * rng.standard_normal()
        soil[name] = {"value": float(f"{value:.6g}"), "sd": float(f"{PRIOR_SD[name](value):.3g}")}
    setup = {"wheel": asdict(bench.wheel), "soil": soil | {"density": bench.ground.density}}
    if noise_stated:
        setup["noise"] = {
            name: float(f"{s:.3g}") for name, s in zip(CHANNELS, bench.noise, strict=True)
        }
    return setup


def write_case(case: Case, folder: Path, truth_file: Path) -> None:
    """data.csv and setup.yaml in `folder`, the truth in another place; the truth is written
    last.
    """
    folder.mkdir(parents=True, exist_ok=True)
    truth_file.parent.mkdir(parents=True, exist_ok=True)
    with (folder / "data.csv").open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream)
        writer.writerow(case.columns)
        writer.writerows(zip(*case.columns.values(), strict=True))
    (folder / "setup.yaml").write_text(
        yaml.safe_dump(case.setup, sort_keys=False), encoding="utf-8"
    )
    write_json(truth_file, short(case.truth, 6))
