"""Calibration and search: what is named and what is not, and the verdict that follows from the
probabilities.
"""

import dataclasses

import numpy as np
import pytest

from soil_env.discovery import judgement
from soil_env.discovery.calibrate import Problem, calibrate
from soil_env.discovery.evidence import Detectable
from soil_env.discovery.search import Finding, Hypothesis, candidates, search
from tests.discovery.files import SAND_SETUP, SETUP, data_of, sand_text
from tests.discovery.tables import NOISE as NOISE_SD, problem, table

SMALL = SETUP.split("noise:")[0].replace("grouser_height: 0.01", "grouser_height: 0")
NOISE = "noise:" + SETUP.split("noise:")[1]


def planted(effects, seed=0):
    """A noisy table of 80 rows in which all conditions vary."""
    data = table(
        effects, (0.05, 0.15, 0.3, 0.45, 0.6), (100.0, 200.0), (0.03, 0.2), (1, 2), (-6.0, 6.0)
    )
    return problem(data, np.random.default_rng(seed))


def test_what_the_table_cannot_show_is_untestable(tmp_path):
    text = "slip,load,sinkage,drawbar_pull\n" + "".join(
        f"{s},100,{0.007 - 0.0003 * k},{-8 + 6 * k}\n"
        for k, s in enumerate((0.05, 0.15, 0.25, 0.35, 0.45))
    )
    p, _ = calibrate(data_of(tmp_path, text, SMALL + NOISE))
    names, reasons = candidates(p)
    of_torque = {"drivetrain_friction", "torque_gain", "torque_offset", "torque_crosstalk"}
    of_load = {"pressure_dependent_friction", "pressure_dependent_modulus"}
    others = {"grousers", "multipass", "penetration_rate", "shear_rate", "grade"}
    assert set(reasons) == others | of_torque | of_load
    assert "speed" in reasons["penetration_rate"] and "torque" in reasons["drivetrain_friction"]
    assert not set(names) & set(reasons)


def law_error(data, size, seed):
    """The table with smooth relative errors of the stress laws, linear in their size, which no
    effect makes.
    """
    rng = np.random.default_rng(seed)
    p = Problem(data, NOISE_SD.copy(), data.measured)
    fit = p.fit()
    errors = np.zeros_like(data.y)
    errors[p.used] = fit.form_errors[2] @ (size * rng.normal(size=fit.form_errors[2].shape[1]))
    return errors * NOISE_SD


def test_a_law_error_of_ten_per_cent_is_no_effect():
    data = planted({}).data
    finding = search(problem(data, np.random.default_rng(0), law_error(data, 0.1, 0)))
    assert finding.names == ()


def test_a_modulus_that_goes_with_the_load_is_named():
    effect = {"pressure_dependent_modulus": {"exponent": 0.8}}
    data = table(effect, (0.05, 0.15, 0.3, 0.45, 0.6), (60.0, 100.0, 160.0, 250.0))
    finding = search(problem(data, np.random.default_rng(1)))
    assert finding.names == tuple(effect)


@pytest.mark.parametrize(("slips", "sure"), [((-0.5, -0.3, -0.15, -0.05), True), ((), False)])
def test_flow_of_a_soil_of_the_library_is_named(tmp_path, slips, sure):
    """Surely from braked rows beside driven ones, else likely, as docs/guide/tables.md says."""
    text = sand_text((*slips, 0.05, 0.1, 0.2, 0.35, 0.5, 0.7), noise=1.0)
    finding = search(calibrate(data_of(tmp_path, text, SAND_SETUP))[0])
    assert finding.names == ("soil_flow",) and finding.is_sure("soil_flow") == sure


@pytest.mark.parametrize("effect", [{"multipass": {"hardening": 0.3}}, {"grade": {"share": 1.0}}])
def test_an_effect_is_named_under_a_law_error(effect):
    data = table(
        effect, (0.05, 0.15, 0.3, 0.45, 0.6), (100.0, 200.0), (0.03, 0.2), (1, 2, 4), (-6.0, 6.0)
    )
    finding = search(problem(data, np.random.default_rng(1), law_error(data, 0.1, 5)))
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


def stated(*hypotheses):
    """`Finding` of (names, free, probability)."""
    return Finding(tuple(Hypothesis(n, f, p, 0.0, None) for n, f, p in hypotheses), {}, {"a": SEEN})


SEEN = Detectable(0.1, "x", "form", 0.9)


def test_refuted_effects_leave_their_probability_to_the_others():
    """All sets with the refuted effects go, the ratios of the rest stay."""
    found = stated(
        (("a", "b"), False, 0.6), (("a",), False, 0.2), (("b",), True, 0.1), ((), False, 0.1)
    )
    left = found.without(("a", "b"))
    assert [(h.names, h.probability) for h in left.hypotheses] == [
        (("a",), pytest.approx(0.5)),
        (("b",), pytest.approx(0.25)),
        ((), pytest.approx(0.25)),
    ]
    assert left.refuted == (("a", "b"),) and left.names == ("a",)
    last = left.without(("a",)).without(("b",))
    assert [h.names for h in last.hypotheses] == [()] and last.none == pytest.approx(1.0)
    # The pair may explain what the effect by itself leaves.
    alone = found.without(("a",), alone=True)
    assert alone.share("a", "b") == pytest.approx(0.75) and alone.best("a").probability == 0.0
    certain = stated((("a",), False, 1.0), ((), False, 0.0), ((), True, 0.0)).without(("a",))
    assert [h.probability for h in certain.hypotheses] == [0.5, 0.5]


@pytest.mark.parametrize(
    "hypotheses, verdict, names",
    [
        ([(("a",), False, 0.6), ((), False, 0.4)], "named", ("a",)),
        ([(("a",), True, 0.6), (("a",), False, 0.3), ((), False, 0.1)], "partly", ("a",)),
        ([(("a",), False, 0.4), (("b",), False, 0.35), ((), False, 0.25)], "ambiguous", ()),
        ([((), False, 0.5), (("a",), False, 0.3), (("b",), False, 0.2)], "none", ()),
        ([((), True, 0.4), ((), False, 0.2), (("a",), False, 0.4)], "ambiguous", ()),
        ([((), True, 0.6), ((), False, 0.2), (("a",), False, 0.2)], "unlisted", ()),
        ([(("a", "b"), False, 0.55), (("a",), False, 0.45), ((), False, 0.0)], "named", ("a", "b")),
        # each has more than half, but not both together
        (
            [
                (("a",), False, 0.4),
                (("b",), False, 0.35),
                (("a", "b"), False, 0.2),
                ((), False, 0.05),
            ],
            "named",
            ("a",),
        ),
        # a second one is missing, and the table does not decide which
        (
            [
                (("a", "b"), False, 0.4),
                (("a", "c"), False, 0.35),
                (("a",), False, 0.22),
                ((), False, 0.03),
            ],
            "partly",
            ("a",),
        ),
    ],
)
def test_the_verdict_is_that_of_the_probabilities(hypotheses, verdict, names):
    finding = stated(*hypotheses)
    assert (finding.verdict, finding.names) == (verdict, names)


def test_candidates_are_those_beside_the_names_too():
    finding = stated(
        (("a", "b"), False, 0.3), (("a", "c"), False, 0.1), (("a",), False, 0.5), ((), True, 0.1)
    )
    assert finding.names == ("a",) and finding.candidates == ("b", "c")
    assert finding.more == pytest.approx(0.4) and finding.alternatives("a") == ()


def test_none_that_would_have_been_overlooked_is_undetermined():
    finding = dataclasses.replace(stated(((), False, 0.9), (("a",), False, 0.1)), detectable={})
    assert finding.verdict == "undetermined"
    weak = {"a": SEEN, "b": SEEN._replace(power=0.05)}
    assert dataclasses.replace(finding, detectable=weak).verdict == "undetermined"
    assert dataclasses.replace(finding, detectable={"a": SEEN}).verdict == "none"
