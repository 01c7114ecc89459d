"""Detection limits, imitations, and the files of the blind cases."""

import json
from collections import Counter
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from scipy.optimize import least_squares

from benchmarks.blind.cases import write_case
from benchmarks.blind.easy import limits as blind_limits
from benchmarks.blind.easy.cases import draw_case
from benchmarks.blind.easy.forms import EFFECTS, FORMS
from benchmarks.blind.easy.groups import GROUPS, PAIRS
from benchmarks.blind.easy.limits import detection_limit, gap, imitation, noncentrality
from benchmarks.blind.easy.plan import Options, draw_bench
from benchmarks.blind.entrants import Answer
from benchmarks.blind.score import judged
from benchmarks.blind.sets import set_of, task_of
from benchmarks.blind.world import Ground, predict
from soil_env.measurement.table import read_setup, read_table
from tests.benchmarks.blind_bench import BENCH, GROUND, NAMES, WHEEL, grid, hidden, table

# --- limits -----------------------------------------------------------------------------------------------------------


def test_noncentrality_of_one_parameter():
    """(1.6449 + 2.5758)^2 = 17.81: the far tail adds nothing."""
    assert noncentrality(1) == pytest.approx((1.644854 + 2.575829) ** 2, rel=1e-5)
    assert noncentrality(2) == pytest.approx(20.65, abs=0.1)


def test_gap_is_the_least_refit():
    """Against scipy with finite differences and the plain definition of the sum of squares."""
    target = table(hidden("rankine", 0.4))
    true = np.array([getattr(GROUND, name) for name in blind_limits.SOIL])
    sd = np.array([BENCH.prior_sd[name] for name in blind_limits.SOIL])
    noise = np.array(BENCH.noise)[:, None]

    def residual(x):
        soil = Ground(*(true + sd * x), density=GROUND.density)
        return np.concatenate([((predict(soil, WHEEL, grid()).stack() - target) / noise).ravel(), x])

    fit = least_squares(residual, np.full(5, 0.1), xtol=1e-10, ftol=1e-10)
    assert gap(BENCH, target) == pytest.approx(2.0 * fit.cost, rel=1e-3)
    assert gap(BENCH, table()) < 1e-6
    assert gap(BENCH, target, [hidden("rankine", 0.3)]) < 1e-3


@pytest.mark.parametrize(
    "name", ["rankine", "lyasko", "proportional_exit", "coulomb", "pass_power", "weight_component"]
)
def test_limit_is_where_the_gap_reaches_the_noncentrality(name):
    effect = hidden(name, 1.0)
    limit = detection_limit(BENCH, effect)
    assert limit < effect.form.cap(BENCH.context)
    wanted = noncentrality(effect.form.freedom)
    assert gap(BENCH, BENCH.truth([effect.at(limit)])) == pytest.approx(wanted, rel=0.06)
    assert gap(BENCH, BENCH.truth([effect.at(2.0 * limit)])) > 3.0 * wanted


def test_limit_scales_with_the_noise():
    louder = replace(BENCH, noise=tuple(3.0 * s for s in BENCH.noise))
    effect = hidden("rankine", 1.0)
    assert 1.3 < detection_limit(louder, effect) / detection_limit(BENCH, effect) < 3.1  # the priors do not grow


def test_what_the_design_cannot_show_has_no_limit():
    fresh = replace(BENCH, rows=replace(BENCH.rows, passes=np.ones(45), grade_deg=np.zeros(45)))
    assert detection_limit(fresh, hidden("pass_power", 1.0)) is None
    assert detection_limit(fresh, hidden("weight_component", 1.0)) is None


def test_imitation_agrees_with_the_refit_of_the_rival():
    effect = hidden("coulomb", 0.06, proportional=0.5)
    target = table(effect)
    found = imitation(BENCH, target, [], {"drivetrain_friction"}, np.random.default_rng(0))
    assert found.none == pytest.approx(gap(BENCH, target), rel=0.02)
    assert found.two <= found.one <= found.none
    assert found.one_name == "bulldozing"
    best = min(gap(BENCH, target, [hidden(n, 0.1)]) for n in ("rankine", "hegedus", "bekker"))
    assert found.one == pytest.approx(best, rel=0.15)


# --- cases ------------------------------------------------------------------------------------------------------------


@cache
def drawn(kind: str, design: str):
    return draw_case(np.random.default_rng(11), kind, design)


@pytest.mark.parametrize(
    ("kind", "design"), [("none", "rich"), ("one", "rich"), ("two", "rich"), ("unlisted", "rich"), ("one", "poor")]
)
def test_cases_are_read_by_the_workflows_reader(tmp_path, kind, design):
    case = drawn(kind, design)
    write_case(case, tmp_path / "case", tmp_path / "truth" / "case.json")
    assert sorted(p.name for p in (tmp_path / "case").iterdir()) == ["data.csv", "setup.yaml"]
    setup = read_setup(tmp_path / "case" / "setup.yaml")
    data = read_table(tmp_path / "case" / "data.csv", setup.wheel)
    assert len(data) == (162 if design == "rich" else case.clean.shape[1])
    assert setup.noise.sinkage == pytest.approx(case.bench.noise[0], rel=1e-2)
    assert setup.soil.density.known and not setup.soil.cohesion.known
    np.testing.assert_allclose(data.slip, case.bench.rows.slip)
    truth = json.loads((tmp_path / "truth" / "case.json").read_text())
    assert [e["name"] for e in truth["effects"]] == [e.form.effect for e in case.effects]
    assert len(truth["effects"]) == {"none": 0, "two": 2}.get(kind, 1)
    written = (tmp_path / "case" / "data.csv").read_text() + (tmp_path / "case" / "setup.yaml").read_text()
    assert not any(e.form.effect in written or e.form.name in written for e in case.effects)


def test_a_seed_gives_the_same_case():
    a, b, c = (draw_case(np.random.default_rng(seed), "one", "poor") for seed in (5, 5, 6))
    assert a.columns == b.columns and a.setup == b.setup and a.truth == b.truth
    assert a.columns != c.columns


def measured(case) -> np.ndarray:
    return np.array([case.columns[name] for name in NAMES])


def test_noise_is_as_stated():
    case = draw_case(np.random.default_rng(2), "none", "rich")
    z = (measured(case) - case.clean) / np.array(case.bench.noise)[:, None]
    assert np.all(np.abs(z.std(axis=1) - 1.0) < 0.2)  # 162 values: sd of the sd is 0.056
    assert np.all(np.abs(z.mean(axis=1)) < 0.3)
    assert np.max(np.abs(z)) < 5.0


def test_outliers_are_few_and_gross():
    case = draw_case(np.random.default_rng(2), "none", "rich", outliers=True)
    z = np.abs((measured(case) - case.clean) / np.array(case.bench.noise)[:, None])
    assert 1 <= np.sum(z > 4.9) == case.truth["wrong_cells"] <= 20  # 9.7 +- 3.1
    assert 10.0 < z.max() < 15.1


@pytest.mark.parametrize(("error", "size"), [("2sd", 2.0), ("none", 0.0)])
def test_priors_are_off_by_what_is_asked(error, size):
    case = draw_case(np.random.default_rng(4), "none", "poor", prior_error=error)
    for name in blind_limits.SOIL:
        off = (case.setup["soil"][name]["value"] - getattr(case.bench.ground, name)) / case.bench.prior_sd[name]
        assert abs(off) == pytest.approx(size, abs=1e-3), name


def test_repeats_share_their_conditions_and_differ_in_run():
    case = draw_case(np.random.default_rng(4), "none", "rich", noise="repeats")
    assert "noise" not in case.setup
    keys = list(zip(*(case.columns[n] for n in ("slip", "load", "speed", "pass", "grade_deg")), strict=True))
    assert {keys.count(k) for k in keys} == {3}
    for k in set(keys):
        runs = [r for r, other in zip(case.columns["run"], keys, strict=True) if other == k]
        assert len(set(runs)) == 3


def test_rich_design_is_balanced():
    rows = draw_bench(np.random.default_rng(8), Options())[0].rows
    for other in (rows.load, rows.speed, rows.passes):
        for value in np.unique(other):
            same = rows.grade_deg[other == value]
            counts = [np.sum(same == g) for g in np.unique(rows.grade_deg)]
            assert len(counts) == 3 and len(set(counts)) == 1


def test_repeats_follow_a_graeco_latin_square():
    rows = draw_bench(np.random.default_rng(8), Options(noise="repeats"))[0].rows
    factors = (rows.load, rows.speed, rows.passes, rows.grade_deg)
    for k, a in enumerate(factors):
        for b in factors[:k]:
            pairs, counts = np.unique(np.stack([a, b]), axis=1, return_counts=True)
            assert pairs.shape[1] == 9 and set(counts) == {18}


def test_sinkage_of_the_base_world_is_sensible():
    for seed in range(10):
        bench, _, _ = draw_bench(np.random.default_rng(seed), Options())
        z = bench.truth()[0] / bench.wheel.radius
        assert 0.03 <= z.min() and z.max() <= 0.35


def test_strengths_are_multiples_of_the_limit_within_the_cap():
    for seed in range(2):
        effect = draw_case(np.random.default_rng(seed), "one", "rich").truth["effects"][0]
        assert effect["multiple"] >= 2.0 - 1e-9 and abs(effect["strength"]) <= effect["cap"] * (1 + 1e-9)
    weak = draw_case(np.random.default_rng(1), "one", "rich", names=("bulldozing",), multiple=(0.3, 0.5))
    assert 0.3 <= weak.truth["effects"][0]["multiple"] <= 0.5
    assert 0.25 < weak.truth["effects"][0]["shown"] < 0.6


def test_naming_scale_keeps_the_best_rival_at_bay():
    case = draw_case(np.random.default_rng(3), "one", "rich", names=("drivetrain_friction",), scale="naming")
    assert case.truth["effects"][0]["named"] > 1.9


def test_hidden_unlisted_effects_are_not_imitated():
    case = drawn("unlisted", "rich")
    effect = case.truth["effects"][0]
    assert effect["rival_pair"]["named"] > 1.9
    assert effect["name"] not in EFFECTS


def test_two_effects_are_both_needed():
    case = drawn("two", "rich")
    for k, effect in enumerate(case.effects):
        other = [case.effects[1 - k]]
        assert gap(case.bench, case.clean, other) > 3.5 * noncentrality(effect.form.freedom)
    assert gap(case.bench, case.clean, case.effects) < 0.1


def test_impossible_cases_and_bad_names_are_refused():
    with pytest.raises(RuntimeError, match="no detectable case of pass_"):
        draw_case(np.random.default_rng(0), "one", "poor", names=("multipass",))
    with pytest.raises(ValueError, match="bulldosing"):
        draw_case(np.random.default_rng(0), "one", names=("bulldosing",))
    with pytest.raises(ValueError, match="multiple 8 2"):
        draw_case(np.random.default_rng(0), "one", multiple=(8.0, 2.0))
    with pytest.raises(ValueError, match="'some'"):
        draw_case(np.random.default_rng(0), "some")


# --- the set ----------------------------------------------------------------------------------------------------------


def test_groups_cover_effects_forms_and_pairs():
    for name, group in GROUPS.items():
        assert name.startswith("easy-") and group.name == name
    one = GROUPS["easy-one-rich"]
    drawn_forms = Counter(one.effects(k)["forms"][0] for k in range(one.count))
    assert set(drawn_forms) == {f.name for f in FORMS}
    assert Counter(one.effects(k)["names"][0] for k in range(one.count)) == dict.fromkeys(EFFECTS, one.count // 13)
    two = GROUPS["easy-two-rich"]
    assert Counter(two.effects(k)["names"] for k in range(two.count)) == dict.fromkeys(PAIRS, 2)


@pytest.mark.parametrize("name", ["easy-one-rich-003", "easy-unlisted-rich-001", "easy-none-rich-priors-000"])
def test_truths_are_those_of_the_benchmark(tmp_path, name):
    """A case of the easy set is scored as any other; the true names earn what they should."""
    case = set_of(name).draw(100003, task_of(name))
    write_case(case, tmp_path / name, tmp_path / "truth.json")
    truth = json.loads((tmp_path / "truth.json").read_text())
    names = tuple(e["name"] for e in truth["effects"] if e["name"] in EFFECTS)
    right = Answer({"one": "named"}.get(truth["kind"], truth["kind"]), names, (), dict.fromkeys(names, 0.9))
    worth = judged(truth, right)
    assert truth["counts"] and not worth.wrong and (worth.first if truth["kind"] == "one" else worth.silent)
    text = (tmp_path / name / "data.csv").read_text() + (tmp_path / name / "setup.yaml").read_text()
    assert not any(e["form"] in text for e in truth["effects"])
