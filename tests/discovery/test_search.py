"""Calibration and search: what is named and what is not, and the verdict that follows from the
probabilities.
"""

import dataclasses

import numpy as np
import pytest

from soil_env.discovery import judgement
from soil_env.discovery.evidence import Detectable
from soil_env.discovery.search import Finding, Hypothesis, candidates, search
from tests.discovery.files import SAND_SETUP, SETUP, csv_text, problem_of, sand_text
from tests.discovery.tables import law_error, problem, table


def planted(effects, seed=0):
    """A noisy table of 80 rows in which all conditions vary."""
    data = table(
        effects, (0.05, 0.15, 0.3, 0.45, 0.6), (100.0, 200.0), (0.03, 0.2), (1, 2), (-6.0, 6.0)
    )
    return problem(data, np.random.default_rng(seed))


def test_what_the_table_cannot_show_is_untestable(tmp_path):
    rows = [(0.1 * k + 0.05, 100.0, 0.007 - 0.0003 * k, 6.0 * k - 8.0) for k in range(5)]
    text = csv_text(("slip", "load", "sinkage", "drawbar_pull"), rows)
    smooth = SETUP.replace("grouser_height: 0.01", "grouser_height: 0")
    names, reasons = candidates(problem_of(tmp_path, text, smooth))
    of_torque = {"drivetrain_friction", "torque_gain", "torque_offset", "torque_crosstalk"}
    of_load = {"pressure_dependent_friction", "pressure_dependent_modulus"}
    others = {"grousers", "multipass", "penetration_rate", "shear_rate", "grade"}
    assert set(reasons) == others | of_torque | of_load
    assert "speed" in reasons["penetration_rate"] and "torque" in reasons["drivetrain_friction"]
    assert not set(names) & set(reasons)


def test_a_law_error_of_ten_per_cent_is_no_effect():
    data = planted({}).data
    rng = np.random.default_rng(0)
    finding = search(problem(data, rng, law_error(data, rng, 0.1)))
    assert finding.names == ()


def test_a_modulus_that_goes_with_the_load_is_named():
    effect = {"pressure_dependent_modulus": {"exponent": 0.8}}
    data = table(effect, (0.05, 0.15, 0.3, 0.45, 0.6), (60.0, 100.0, 160.0, 250.0))
    finding = search(problem(data, np.random.default_rng(1)))
    assert finding.names == tuple(effect)


@pytest.mark.parametrize(("slips", "sure"), [((-0.5, -0.3, -0.15, -0.05), True), ((), False)])
def test_flow_of_a_soil_of_the_library_is_named(tmp_path, slips, sure):
    """Surely from braked rows beside driven ones, else it is a candidate, as docs/guide/tables.md
    says.
    """
    text = sand_text((*slips, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7), noise=1.0)
    finding = search(problem_of(tmp_path, text, SAND_SETUP))
    assert finding.is_sure("soil_flow") == sure
    assert (finding.names or finding.candidates[:1]) == ("soil_flow",)
    assert bool(finding.names) == sure


@pytest.mark.parametrize("effect", [{"multipass": {"hardening": 0.3}}, {"grade": {"share": 1.0}}])
def test_an_effect_is_named_under_a_law_error(effect):
    data = table(
        effect, (0.05, 0.15, 0.3, 0.45, 0.6), (100.0, 200.0), (0.03, 0.2), (1, 2, 4), (-6.0, 6.0)
    )
    rng = np.random.default_rng(1)
    finding = search(problem(data, rng, law_error(data, rng, 0.1)))
    assert finding.names[:1] == tuple(effect)
    assert finding.stated.evidence.typical("law") > 0.03
    ((name, strength),) = next(iter(effect.values())).items()
    result = judgement.intervals(finding, finding.stated.evidence)[f"{next(iter(effect))}_{name}"]
    assert (
        0.0 < result.low < result.value < result.high
        and abs(result.value - strength) < 0.5 * strength
    )


def test_a_slip_error_is_named_in_a_form_that_no_catalogue_has():
    """A zero error of the travel speed: the slower the run, the more wrong its slip."""
    data = table({}, (0.1, 0.2, 0.35, 0.5), (100.0, 200.0), (0.03, 0.08, 0.2), (1, 2))
    speed = data.rows.conditions[:, 0]
    rows = data.rows._replace(slip=1.0 - (1.0 - data.rows.slip) / (1.0 - 0.003 / speed))
    finding = search(problem(dataclasses.replace(data, rows=rows), np.random.default_rng(0)))
    assert finding.names == ("slip_bias",)


def test_what_depends_on_time_alone_is_unlisted():
    """A drift of the torque over the campaign: no effect of the catalogue knows the time."""
    data = planted({}).data
    rng = np.random.default_rng(3)
    time = rng.permutation(len(data.table)).astype(float)
    names = {**vars(data.table), "time": time}
    data = dataclasses.replace(data, table=type(data.table)(**names))
    drift = np.outer(3.0 * np.sin(4.0 * time / time.max()), [0.0, 0.0, 1.0])
    finding = search(problem(data, rng, drift))
    assert finding.verdict == "unlisted" and finding.names == () and finding.unlisted > 0.9


SEEN = Detectable(0.1, "x", "form", 0.9)
TESTED = {"a": SEEN}


def stated(shares, detectable=TESTED, if_laws_err=None):
    """`Finding` of {letters of the effects: probability}; "?": beside something unlisted.

    `if_laws_err`: the same if the laws err, where it is another.
    """
    then = if_laws_err or shares
    found = (
        Hypothesis(
            tuple(names.rstrip("?")), "?" in names, p, 0.0, None, if_laws_err=(p, then[names])
        )
        for names, p in shares.items()
    )
    return Finding(tuple(found), {}, detectable)


def test_refuted_effects_leave_their_probability_to_the_others():
    """All sets with the refuted effects go, the ratios of the rest stay."""
    found = stated({"ab": 0.6, "a": 0.2, "b?": 0.1, "": 0.1})
    left = found.without(("a", "b"))
    assert {h.names: h.probability for h in left.hypotheses} == pytest.approx(
        {("a",): 0.5, ("b",): 0.25, (): 0.25}
    )
    assert left.refuted == (("a", "b"),) and left.names == ("a",)
    last = left.without(("a",)).without(("b",))
    assert [h.names for h in last.hypotheses] == [()] and last.none == pytest.approx(1.0)
    # The pair may explain what the effect by itself leaves.
    alone = found.without(("a",), alone=True)
    assert alone.share("a", "b") == pytest.approx(0.75) and alone.best("a").probability == 0.0
    sure = stated({"a": 1.0, "": 0.0}).without(("a",), alone=True)  # all goes to the other
    assert {h.names: h.probability for h in sure.hypotheses} == {(): 1.0, ("a",): 0.0}
    certain = stated({"a": 1.0, "": 0.0, "?": 0.0}).without(("a",))
    assert [h.probability for h in certain.hypotheses] == [0.5, 0.5]


@pytest.mark.parametrize(
    "shares, verdict, names",
    [
        ({"a": 0.6, "": 0.4}, "named", "a"),
        ({"a?": 0.6, "a": 0.3, "": 0.1}, "partly", "a"),
        ({"a": 0.4, "b": 0.35, "": 0.25}, "ambiguous", ""),
        ({"": 0.5, "a": 0.3, "b": 0.2}, "none", ""),
        ({"?": 0.4, "": 0.2, "a": 0.4}, "ambiguous", ""),
        ({"?": 0.6, "": 0.2, "a": 0.2}, "unlisted", ""),
        ({"ab": 0.55, "a": 0.45, "": 0.0}, "named", "ab"),
        # each has more than half, but not both together
        ({"a": 0.4, "b": 0.35, "ab": 0.2, "": 0.05}, "named", "a"),
        # a second one is missing, and the table does not decide which
        ({"ab": 0.4, "ac": 0.35, "a": 0.22, "": 0.03}, "partly", "a"),
    ],
)
def test_the_verdict_is_that_of_the_probabilities(shares, verdict, names):
    finding = stated(shares)
    assert (finding.verdict, finding.names) == (verdict, tuple(names))


def test_a_name_is_stated_if_it_holds_where_laws_err():
    """The second one of a pair too."""
    shares = {"ab": 0.7, "a": 0.2, "": 0.1}
    for then, names in (
        ({"ab": 0.1, "a": 0.3, "": 0.6}, ()),
        ({"ab": 0.3, "a": 0.3, "": 0.4}, ("a",)),
        ({"ab": 0.6, "a": 0.3, "": 0.1}, ("a", "b")),
    ):
        finding = stated(shares, if_laws_err=then)
        assert finding.names == names
        assert finding.candidates == tuple("ab"[len(names) :])
    finding = stated(shares, if_laws_err={"ab": 0.1, "a": 0.3, "": 0.6})
    assert finding.verdict == "ambiguous" and not finding.is_sure("a")
    even = stated({"a": 0.55, "": 0.45}, if_laws_err={"a": 0.9, "": 0.1})
    assert even.names == ("a",) and not even.is_sure("a")


def test_candidates_are_those_beside_the_names_too():
    finding = stated({"ab": 0.3, "ac": 0.1, "a": 0.5, "?": 0.1})
    assert finding.names == ("a",) and finding.candidates == ("b", "c")
    assert finding.more == pytest.approx(0.4) and finding.alternatives("a") == ()


@pytest.mark.parametrize(
    ("detectable", "verdict"),
    [
        ({}, "undetermined"),
        ({"a": SEEN, "b": SEEN._replace(power=0.05)}, "undetermined"),
        (TESTED, "none"),
    ],
)
def test_none_that_would_have_been_overlooked_is_undetermined(detectable, verdict):
    assert stated({"": 0.9, "a": 0.1}, detectable).verdict == verdict
