"""Comparison of controllers on the same courses: rates and means with 95 % intervals, paired
differences.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from soil_env._io.document import Table
from soil_env.parameters import Scenario

from . import statistics as st
from .driving import MEANINGS, RATES, Runs
from .tables import COLUMNS, OF_ROVERS, legend, metric_table

ORACLE = "oracle"  # its name in tables; no contestant may have it
#: Courses that it drives side by side: it is slow, and a block is what an interruption loses.
ORACLE_BLOCK = 10
#: Metrics that are compared course by course; the last two are of rovers.
PAIRED = ("immobilised", "finished", "return", "energy_per_metre", "fighting", "wheel_force")
_UNDEFINED = {"value": None, "low": None, "high": None}
#: Metrics that are shown by training seed, in differences and in the figure of a study.
MAIN = ("immobilised", "finished", "return")


def comparison(
    scenario: Scenario,
    seed: int,
    runs: Mapping[str, Sequence[Runs]],
    settings: Mapping | None = None,
    oracle: Runs | None = None,
    *,
    resamples: int,
) -> dict:
    """The comparison of controllers; `runs`: for each controller one `Runs` a
    training seed.

    `seed` is that of the courses and of the bootstrap; `settings`, {name: settings} of controllers
    that have some, are passed on. The result has the keys

    - scenario, courses, seed, settings: what was compared
    - members: {name: number of training seeds}
    - metrics: {metric: its unit and meaning}
    - controllers: {name: {metric: interval}}
    - by_seed: {name: {metric: [mean of each training seed]}}, of `MAIN`
    - iqm: {name: interval of the interquartile mean of the return}
    - paired: {a: {b: {metric: interval of a - b on the same courses}}}, of `PAIRED`
    - improvement: {a: {b: interval of the probability of the higher return}}, where ties
      count half
    - limit: see `_limit`, where the `oracle` has driven the first courses

    An interval is {"value", "low", "high"} at 95 % (`statistics`), in "controllers" and "limit"
    with None where the metric is not defined.
    """
    first = next(iter(runs.values()))[0]
    names = first.names  # of metrics
    courses = first.cause.size
    drawn = st.draws(seed, courses, resamples)
    members = {name: drawn.members(name, len(own)) for name, own in runs.items()}
    # By controller and metric, [members, courses] and the means of bootstrap draws [resamples].
    scores = {
        name: {m: np.array([r.metric(m) for r in own]) for m in names} for name, own in runs.items()
    }
    paired = [m for m in PAIRED if m in names]
    samples = {
        n: {m: st.mean_samples(scores[n][m], members[n], drawn.courses) for m in names}
        for n in runs
    }

    def difference(a: str, b: str, m: str) -> dict:
        """Bounds of the metric `m` of `a` less that of `b`, on the same courses."""
        x = scores[a][m]
        y = scores[b][m]
        of_draws = samples[a][m] - samples[b][m]
        return (
            st.difference_bounds(x, y, of_draws)
            if m in RATES
            else st.bounds(st.mean(x) - st.mean(y), of_draws)
        )

    def iqm(name: str) -> dict:
        """Bounds of the interquartile mean of the return."""
        own = scores[name]["return"]
        return st.bounds(st.iqm(own), st.iqm_samples(own, members[name], drawn.courses))

    def improvement(a: str, b: str) -> dict:
        """Bounds of the probability that a has a higher return than b."""
        x = scores[a]["return"]
        y = scores[b]["return"]
        of_draws = st.improvement_samples(x, y, members[a], members[b], drawn.courses)
        return st.bounds(st.probability_of_improvement(x, y), of_draws)

    others = {a: [b for b in runs if b != a] for a in runs}  # whom each is compared with
    return {
        "scenario": scenario.name,
        "courses": int(courses),
        "seed": seed,
        "settings": dict(settings or {}),
        "members": {name: len(own) for name, own in runs.items()},
        "metrics": {m: dict(zip(("unit", "meaning"), MEANINGS[m], strict=True)) for m in names},
        "controllers": {
            n: {m: _metric(m, scores[n][m], samples[n][m]) for m in names} for n in runs
        },
        "by_seed": {n: {m: [st.mean(row) for row in scores[n][m]] for m in MAIN} for n in runs},
        "iqm": {n: iqm(n) for n in runs},
        "paired": {
            a: {b: {m: difference(a, b, m) for m in paired} for b in others[a]} for a in runs
        },
        "improvement": {a: {b: improvement(a, b) for b in others[a]} for a in runs},
        **({"limit": _limit(oracle, runs, names, seed, resamples)} if oracle else {}),
    }


def _metric(name: str, scores: np.ndarray, samples: np.ndarray) -> dict:
    """{"value", "low", "high"} of a metric with `scores` [members, courses] and the means of its
    bootstrap draws, `samples` [resamples]; all None where every score is NaN.
    """
    known = int(np.isfinite(scores).sum())
    if known == 0:
        return _UNDEFINED
    if name in RATES:
        # The trials are the courses on which a member has a score, on average.
        return st.rate_bounds(st.mean(scores), samples, known / len(scores), len(scores))
    return st.bounds(st.mean(scores), samples)


def _limit(
    oracle: Runs,
    runs: Mapping[str, Sequence[Runs]],
    names: Sequence[str],
    seed: int,
    resamples: int,
) -> dict:
    """{"courses", "metrics", "nobody"} of the oracle, which has driven the first courses of the
    controllers.

    "courses" is how many. "metrics" has all `names`, undefined where the oracle has none of a
    metric. "nobody" lists the courses, counted from 0, that neither the oracle nor a controller
    finished: some slopes are too steep.
    """
    finished = oracle.metric("finished") > 0.0
    for own in runs.values():
        for r in own:
            finished |= r.metric("finished")[: finished.size] > 0.0
    drawn = st.draws(seed, oracle.cause.size, resamples)
    members = drawn.members(ORACLE, 1)
    metrics = dict.fromkeys(names, _UNDEFINED)
    for m in oracle.names:
        scores = oracle.metric(m)[None]
        metrics[m] = _metric(m, scores, st.mean_samples(scores, members, drawn.courses))
    nobody = np.flatnonzero(~finished).tolist()
    return {"courses": int(oracle.cause.size), "metrics": metrics, "nobody": nobody}


def table(result: Mapping) -> tuple[Table, str]:
    """The main metrics of all controllers, and a line with the meaning of the columns."""
    columns = OF_ROVERS if "fighting" in result["metrics"] else COLUMNS
    title = (
        f"{result['courses']} courses of {result['scenario']!r}{other_world(result)}, the same for "
        "all; 95 % intervals"
    )
    seeds = {
        name: f" ({count} seeds)" if count > 1 else "" for name, count in result["members"].items()
    }
    entries = {name + seeds[name]: row for name, row in result["controllers"].items()} | limit_rows(
        result
    )
    return metric_table(entries, columns, title), legend(columns)


def other_world(result: Mapping) -> str:
    """Words for what acts in a world of `--model`, after the scenario's name; "" without one."""
    model = result.get("model") or {}
    acting = [*model.get("effects", {}), *(k for k in ("residual", "remainder") if model.get(k))]
    return f" in a world with {', '.join(acting) or 'no effect'}" if model else ""


def nobody(result: Mapping) -> list[str]:
    """A line on the courses that nobody finished; none where the oracle has not driven."""
    entry = result.get("limit")
    if not entry:
        return []
    first = f"Of the first {entry['courses']} courses, which the oracle drove too,"
    if not entry["nobody"]:
        return [f"{first} each was finished by somebody."]
    return [f"{first} nobody finished {', '.join(map(str, entry['nobody']))}."]


def limit_rows(result: Mapping) -> dict[str, Mapping]:
    """The oracle's row of a table of controllers, {name: metrics}; none where it has not driven."""
    entry = result.get("limit")
    return {f"{ORACLE} (first {entry['courses']} courses)": entry["metrics"]} if entry else {}
