"""The report of a result: report.json, the page, its equations, sentences and cautions."""

import dataclasses
import json
import math
import re
from html import escape
from types import SimpleNamespace

import numpy as np
import pytest

from soil_env.discovery import report as drawn, run
from soil_env.discovery.calibrate import PRIOR_WIDTH
from soil_env.discovery.corrected import Guess
from soil_env.discovery.instrument import LISTED
from soil_env.discovery.judgement import Gap, Interval
from soil_env.discovery.next_for_prediction import SurerRun
from soil_env.discovery.next_tests import NextTest, open_checks
from soil_env.discovery.prediction import fit_prediction
from soil_env.discovery.report import equations, sentences, tables, words
from soil_env.discovery.report.pictures import curves
from soil_env.identification.table import identify_table
from soil_env.identification.table.data import CHANNELS
from soil_env.measurement.doubts import one_load
from soil_env.measurement.setup import Calibration, SoilPriors
from soil_env.terramechanics.steady import DEEPEST
from tests.discovery.files import (
    PLANTED,
    SETUP,
    data_of,
    problem_of,
    table_text,
    with_data,
    write_files,
)


def of_data(report, **changes):
    """The report of a problem with other fields of its data."""
    return dataclasses.replace(report, problem=with_data(report.problem, **changes))


def with_hypotheses(report, found, **more):
    """The report with other hypotheses."""
    finding = dataclasses.replace(report.finding, hypotheses=tuple(found))
    return dataclasses.replace(report, finding=finding, **more)


def with_setup(report, **keys):
    """The report with other keys in its setup."""
    return of_data(report, setup=report.problem.data.setup.changed(**keys))


def test_report_json_has_the_keys_of_the_contract(planted_files, nothing):
    report, folder = planted_files
    content = json.loads((folder / "report.json").read_text(), parse_constant=pytest.fail)
    assert content == json.loads(json.dumps(drawn.content(report), allow_nan=False))
    assert {"next_tests", "detectable"} < set(content) and content["verdict"] == "named"
    for effect in content["effects"]:
        assert {"name", "parameters", "share", "alternatives"} <= set(effect)
        assert effect["name"] in LISTED
        assert all(p["low"] <= p["value"] <= p["high"] for p in effect["parameters"].values())
    assert all({"channel", "region", "size", "p_value"} <= set(d) for d in content["where"])
    assert set(content["gap"]) == set(content["remainder"]) == set(CHANNELS)
    tried = {r["name"] for r in content["ranking"]} | {u["name"] for u in content["untestable"]}
    assert tried == set(LISTED) and content["ranking"][0]["name"] == "slip_sinkage"
    assert content["closed_interval"][0] <= content["closed"] <= content["closed_interval"][1]
    assert report.model.validity == {k: tuple(v) for k, v in content["trust"].items()}
    assert set(content["prediction"]) == {"slip", "load"}
    for split in content["prediction"].values():
        assert set(split) == set(CHANNELS)
        for found in split.values():
            assert 0.0 < found["corrected"] < 3.0 * found["noise"]
            assert set(found) == {"base", "corrected", "curve", "noise"}
    # twice the largest load of the table
    assert content["guess"]["conditions"]["load"] == pytest.approx(440.0)
    assert "It guesses at slip" in content["foreseen"]
    assert content["foreseen"] in (folder / "report.html").read_text()
    empty = drawn.content(nothing)
    assert set(empty) == set(content) and empty["verdict"] == "none" and empty["closed"] is None
    assert empty["effects"] == empty["where"] == [] and empty["probability"]["none"] > 0.5


def test_a_guess_where_only_the_slip_varies_is_told(planted):
    """As of a rig with one load."""
    guess = planted.guess._replace(conditions={"slip": 0.9}, times=5.0)
    told = sentences.foreseen(dataclasses.replace(planted, guess=guess))
    assert "It guesses at slip 0.9 (drawbar pull " in told and "not to learn what is" in told


def test_a_strength_that_no_effect_may_have_is_no_smallest_one(planted):
    """The largest `rim_flow` is 0.12; a table that would show 0.84 shows none."""

    def smallest(size):
        """What is told of a `rim_flow` that would have been seen from this size on."""
        found = planted.finding.detectable["soil_flow"]._replace(parameter="rim_flow", size=size)
        finding = dataclasses.replace(planted.finding, detectable={"soil_flow": found})
        ((_, _, told, *_),) = tables.detectable(dataclasses.replace(planted, finding=finding)).rows
        return told

    assert smallest(0.84) == "none up to 0.12" and smallest(0.08) == "0.08"


@pytest.mark.parametrize(
    ("base", "corrected", "curve", "said"),
    [
        (1.8, 3.1, math.nan, "with the soil of `soil-env identify` alone"),
        (1.8, 3.1, 2.0, "with the soil of `soil-env identify` alone"),
        (1.8, 3.1, 1.7, "trust a plain curve through the rows more"),
        (3.3, 3.1, 1.7, "trust a plain curve through the rows more"),
        (3.1, 1.8, 1.7, ""),
        (0.5, 0.9, 0.4, ""),
    ],
)
def test_it_is_told_where_another_model_predicts_better(planted, base, corrected, curve, said):
    """Not by less than a tenth, or where all err by less than the noise."""
    (way, *_) = planted.outlook.left_out
    over = way.over_noise._replace(base=base, corrected=corrected, curve=curve)
    outlook = planted.outlook._replace(left_out=(way._replace(over_noise=over),))
    told = words.next_step(dataclasses.replace(planted, outlook=outlook))
    assert told.count("for a slip that you have not measured") == bool(said) and said in told


def test_the_soil_of_identify_is_not_recommended_where_identify_refuses_the_table(planted):
    (way, *_) = planted.outlook.left_out
    way = way._replace(over_noise=way.over_noise._replace(base=1.8, corrected=3.1, curve=2.0))
    report = dataclasses.replace(planted, outlook=planted.outlook._replace(left_out=(way,)))
    for kept, said in (((0,), False), ((1,), False), ((0, 1), True)):
        values = np.tile(np.isin(np.arange(3), kept), (len(planted.problem.data.table), 1))
        table = planted.problem.data.table.with_values(values)
        there = with_setup(of_data(report, table=table), soil=SoilPriors())
        told = sentences.simulate_with(there)
        assert ("identify" in told) == said and ("plain curve" in told) != said
    all_known = dataclasses.replace(report.problem)
    all_known.soil = ()
    assert "identify" not in sentences.simulate_with(dataclasses.replace(report, problem=all_known))


def test_a_table_of_two_rows_has_a_report(tmp_path):
    """Without headings over nothing."""
    text = "\n".join(table_text({}, (100,)).split("\n")[:3]) + "\n"
    report = run(*write_files(tmp_path, text), next_runs=0)
    assert report.verdict == "undetermined" and not report.outlook.left_out
    told = drawn.text(report)
    assert "Predictions of what was left out" not in told
    assert "Held-out error of the base model alone" in told


def test_it_is_told_that_slips_are_by_the_rim_where_the_table_has_those_by_the_tips(planted):
    assert not any("by the lug tips" in said for said in sentences.cautions(planted))
    said = sentences.cautions(with_setup(planted, slip_reference="tip"))
    assert any("those of the table by the lug tips" in caution for caution in said)


@pytest.mark.parametrize(
    ("form", "simulated", "words"),
    [
        ("excavation", {"gain": 0.0, "recovery": 0.5, "exponent_slope": 0.1}, 'not "excavation"'),
        ("ratio", {"gain": 1.4, "recovery": 0.5}, 'the form "ratio",'),
        ("ratio", None, "no equation"),
    ],
)
def test_the_summary_says_what_the_model_simulates_of_a_name(planted, form, simulated, words):
    """A name is stated in the form that fits best, which need not be that of model.yaml."""
    own = {} if simulated is None else {"slip_sinkage": simulated}
    report = dataclasses.replace(
        planted,
        effects=(dataclasses.replace(planted.effects[0], form=form),),
        model=dataclasses.replace(planted.model, effects=own),
    )
    first, second, *_ = sentences.summary(report).replace("%).", "%)|").split("|")
    assert "slip-sinkage" in first and words in second.partition(". ")[0]
    assert ('"ratio" and "exponent"' in second) == (form == "excavation")


def test_a_second_effect_that_the_table_does_not_decide_is_said_first(planted):
    known = planted.finding.hypotheses
    pairs = [h for h in known if len(h.names) == 2 and "slip_sinkage" in h.names and not h.free]
    share = {pairs[0]: 0.4, pairs[1]: 0.3, planted.finding.best("slip_sinkage"): 0.3}
    report = with_hypotheses(
        planted, (dataclasses.replace(h, probability=share.get(h, 0.0)) for h in known)
    )
    finding = report.finding
    assert report.verdict == "partly" and finding.names == ("slip_sinkage",)
    others = [n for h in pairs[:2] for n in h.names if n != "slip_sinkage"]
    assert list(finding.candidates) == others
    first, second = map(sentences.title, others)
    assert f"most probable {first} or {second}." in words.conclusion(report)
    said = sentences.summary(report)
    assert "(40 %); " in said and "a further effect" in said


def test_an_error_of_the_rig_is_in_no_model(planted):
    effect = dataclasses.replace(planted.effects[0], name="tilt", form="constant", parameters={})
    said = sentences.simulated(dataclasses.replace(planted, effects=(effect,)))
    assert "simulates nothing" in said


def test_curves_have_the_tilt_of_a_rig_once(tmp_path):
    """Where the load is vertical it is a part of the grade."""
    setup = SETUP + "tilt_deg: {value: 4, sd: 0.01}\nload: vertical\n"
    problem = problem_of(tmp_path, table_text({}, loads=(100, 200)), setup)
    model = fit_prediction(problem, (), with_remainder=False)
    report = SimpleNamespace(
        problem=problem, base=problem.fit(), outlook=SimpleNamespace(model=model)
    )
    rows = problem.data.groups[0]
    slip, *drawn_curves = curves(report, rows)
    for curve, known in zip(drawn_curves, (report.base.output, model.output), strict=True):
        found = np.interp(problem.data.rows.slip[rows], slip, curve[:, 1])
        assert found == pytest.approx(known[rows, 1], abs=0.5)


def test_a_misfit_without_a_name_is_no_agreement(nothing):
    missed = dataclasses.replace(nothing, gap=nothing.gap | {"torque": Gap(2.0, 2.0, 1.0)})
    assert "agrees" in words.conclusion(nothing) and "misses these runs" in words.conclusion(missed)


@pytest.mark.parametrize(("share", "word"), [(0.81, ""), (0.79, " likely")])
def test_a_name_that_larger_errors_of_the_laws_explain_is_likely(planted, share, word):
    """Below 80 % where the laws err by 10 %."""
    finding = planted.finding
    total = finding.if_laws_err("slip_sinkage")[-1]
    scaled = [
        dataclasses.replace(h, if_laws_err=(h.if_laws_err[0], share / total * h.if_laws_err[-1]))
        for h in finding.hypotheses
    ]
    other = with_hypotheses(planted, scaled)
    assert words.conclusion(other).startswith(f"Slip-sinkage{word} explains")
    missing = "Likely missing" if word else "Missing"
    assert sentences.summary(other).startswith(f"{missing} from the model: slip-sinkage")


def test_checks_are_asked_for_where_they_are_likely_to_find_something(nothing):
    base = nothing.finding.best()

    def step(p):
        """Next step where two errors of gain have the probability p each."""
        found = [
            dataclasses.replace(base, names=(n,), probability=p)
            for n in ("force_gain", "torque_gain")
        ]
        rest = dataclasses.replace(base, probability=1.0 - 2.0 * p)
        there = with_hypotheses(
            nothing, (rest, *found), next_checks=open_checks()[3:4], next_tests=()
        )
        return words.next_step(there)

    assert step(0.04) == "Simulate with model.yaml." and "known weights" in step(0.06)


def test_a_gap_that_is_left_is_never_closed_by_100_percent(planted):
    there = dataclasses.replace(planted, closed=0.9985, closed_interval=(0.93, 0.9991))
    said = sentences.summary(there)
    assert "more than 99 % of the gap" in said
    assert "interval 93 to more than 99 %" in said
    whole = dataclasses.replace(planted, closed=1.0, closed_interval=(1.0, 1.0))
    assert "100 % of the gap" in (said := sentences.summary(whole)) and "interval" not in said
    effect = dataclasses.replace(planted.effects[0], share=0.9985)
    table = tables.effects(dataclasses.replace(planted, effects=(effect,)))
    assert "(closes more than 99 %)" in table.rows[0][0]


def test_a_probability_is_never_100_percent(planted):
    certain = (
        dataclasses.replace(h, if_laws_err=(0.0, float("slip_sinkage" in h.names)))
        for h in planted.finding.hypotheses
    )
    said = sentences.if_laws_err(with_hypotheses(planted, certain))
    assert said.endswith("slip-sinkage has more than 99.9 %.")


def test_every_name_has_its_probability_if_laws_err(planted):
    pair = next(h for h in planted.finding.hypotheses if len(h.names) == 2 and not h.free)
    first, second = sorted(pair.names, key=lambda name: name != "slip_sinkage")
    share = {pair.names: (0.9, 0.6), (first,): (0.1, 0.4)}
    found = []
    for h in planted.finding.hypotheses:
        now, then = share.get(h.names, (0.0, 0.0)) if not h.free else (0.0, 0.0)
        found.append(dataclasses.replace(h, probability=now, if_laws_err=(now, then)))
    report = with_hypotheses(planted, found)
    assert {*report.finding.names} == {first, second}
    said = sentences.if_laws_err(report)
    assert said.endswith(f"has more than 99.9 % and {sentences.title(second)} has 60 %.")


def test_runs_that_tell_listed_effects_apart_say_so_where_none_may_be_right(planted):
    """Their probabilities add up to 1 without what is in no catalogue."""
    test = NextTest({"slip": 0.1}, (), ("a", "b"), "torque", 1.0, 0.9, 1.0, 0.1)
    for unlisted, end in ((0.96, ", if listed"), (0.02, "")):
        base = dataclasses.replace(planted.finding.best(), probability=1.0 - unlisted)
        other = dataclasses.replace(base, free=True, probability=unlisted)
        there = with_hypotheses(planted, (other, base), next_tests=(test,))
        assert tables.next_runs(there).header[-1] == f"right one then{end}"
        assert f"p{end}" in tables.next_predictions(there).header


def with_wheels(report, wheels):
    """The report of rows with other wheels [N, 3]."""
    return of_data(report, rows=report.problem.data.rows._replace(wheels=wheels))


def test_a_wheel_is_buried_by_the_radius_of_its_row(planted):
    output = planted.fit.output.copy()
    output[0, 0] = DEEPEST * planted.problem.data.wheel.radius
    fit = dataclasses.replace(planted.fit, output=output)
    for factor in (1.0, 2.0):
        there = with_wheels(planted, planted.problem.data.rows.wheels * factor)
        cautions = sentences.cautions(dataclasses.replace(there, fit=fit))
        assert any("does not carry the load in 1 row." in x for x in cautions) == (factor == 1.0)


def test_the_work_of_a_check_reads_one_thing_at_a_time():
    """With commas in the parts, or three of them, semicolons part them."""
    work = {check.name: check.work for check in open_checks()}
    assert work["weights"].count("; ") == 3 and " and the " not in work["weights"]
    assert "which has to be 0; the slip" in work["plate"]
    (lifted,) = (c for c in open_checks(("torque_offset",)) if c.name == "lifted")
    assert "the pull at rest and the torque that it takes to turn" in lifted.work


def test_no_check_is_asked_for_what_the_setup_declares_exact(nothing):
    """Zeros that are exact: of the lifted wheel only its friction is read."""
    base = nothing.finding.best()
    rig = dataclasses.replace(base, names=("drivetrain_friction",), probability=0.5)
    rest = dataclasses.replace(base, probability=0.5)
    report = with_hypotheses(nothing, (rest, rig), next_checks=open_checks()[1:2], next_tests=())
    zeros = Calibration(force_offset=0.0, torque_offset=0.0)
    assert "force_offset" in words.next_step(with_setup(report, calibration=Calibration()))
    said = words.next_step(with_setup(report, calibration=zeros))
    assert "the torque that it takes to turn" in said and "pull" not in said
    assert "checked: [drivetrain_friction]" in said and "offset" not in said
    checked = with_setup(report, calibration=zeros, checked=("drivetrain_friction",))
    assert "Lift the wheel" not in words.next_step(checked)


def test_the_screen_names_the_first_of_the_runs_that_serve_the_prediction(nothing):
    guess = Guess({"slip": 0.7, "load": 210.0}, np.zeros(3), np.ones(3), 2.0)
    runs = tuple(SurerRun({"slip": s, "load": 150.0}, 0.9, 1.0) for s in (0.25, 0.45))
    for there in (guess, None):
        said = sentences.foreseen(dataclasses.replace(nothing, guess=there, surer_runs=runs))
        assert "measure at slip 0.25 at load 150 N, the first of the runs below" in said
    alone = sentences.foreseen(dataclasses.replace(nothing, guess=guess, surer_runs=()))
    assert "measure there" in alone


def test_no_further_run_is_asked_for_where_the_answer_is_sure(nothing):
    base = nothing.finding.best()
    for p, said in ((1.0, True), (0.7, False)):
        other = dataclasses.replace(base, names=("bulldozing",), probability=1.0 - p)
        sure = dataclasses.replace(base, probability=p)
        report = with_hypotheses(nothing, (sure, other), next_tests=())
        assert ("No further run is needed" in drawn.text(report)) == said
    base = dataclasses.replace(base, probability=0.999)
    other = dataclasses.replace(other, probability=0.001)
    report = with_hypotheses(nothing, (base, other), next_tests=())
    assert "the right candidate has more than 99 % now" in sentences.after_next(report)
    assert "gap remains" not in sentences.after_next(report)
    partly = SimpleNamespace(next_tests=(), verdict="partly", finding=report.finding)
    assert "gap remains" in sentences.after_next(partly)
    last = SimpleNamespace(predicted=[SimpleNamespace(probability=0.5)] * 2, sure=1.0, repeat=False)
    runs = SimpleNamespace(next_tests=[last], verdict="ambiguous")
    assert "100 % after them. No further run is needed" in sentences.after_next(runs)


def test_a_table_of_one_load_says_what_it_cannot_tell(tmp_path):
    said = []
    for loads in ((100,), (100, 150)):
        data = data_of(tmp_path, table_text({}, loads=loads))
        warnings = identify_table(data.table, data.setup).warnings
        said.append([w for w in warnings if "same load, about 100 N" in w])
    assert len(said[0]) == 1 and not said[1] and "friction angle" in said[0][0]
    wheels = table_text({}, loads=(100,), wheel_radius=(0.12, 0.15))
    data = data_of(tmp_path, wheels)
    assert not one_load(data.table, data.setup)
    report = run(*write_files(tmp_path, table_text({}, loads=(100,))), next_runs=0)
    assert any("same load, about 100 N" in caution for caution in sentences.cautions(report))


@pytest.mark.usefixtures("unrendered")
def test_the_page_escapes_what_a_file_name_brings(nothing):
    page = drawn.page(nothing, drawn.content(nothing))
    assert "<b>" not in page and "&lt;b&gt;&amp;" in page


def test_the_page_needs_no_other_file(planted_files):
    page = (planted_files[1] / "report.html").read_text()
    assert not re.search(r"<(script|link|iframe)|@import|(?:src|href)=.(?!data:|#)", page)


def test_a_named_effect_is_shown_as_an_equation(planted_files):
    report, folder = planted_files
    (effect,) = json.loads((folder / "report.json").read_text())["effects"]
    (block,) = equations.blocks(report)
    terminal = drawn.text(report)
    page = (folder / "report.html").read_text()
    for name, value in effect["parameters"].items():
        if name in effect["symbols"]:
            assert f"{effect['symbols'][name]} = {value['value']:.3g}" in terminal
            assert f"{value['value']:.3g}" in effect["fitted"]
    assert all(line in terminal for line in (*block.equation, *block.fitted, block.source))
    assert all(escape(line, quote=False) in page for line in (*block.equation, *block.fitted))
    assert effect["source"] and effect["where"]["i"] == "slip"


def test_an_equation_tells_the_sizes_of_a_wheel_that_all_rows_have(planted):
    effect = dataclasses.replace(planted.effects[0], name="grousers", form="shear_radius")
    effect = dataclasses.replace(effect, parameters={"shear_share": Interval(1.0, 0.5, 1.5)})
    wheels = planted.problem.data.rows.wheels.copy()
    wheels[0, 2] = 0.0
    for there, height in ((planted, ", 0.01 m"), (with_wheels(planted, wheels), "")):
        where = equations.blocks(dataclasses.replace(there, effects=(effect,)))[0].where
        assert where["h"] == f"lug height{height}" and where["r"] == "wheel radius, 0.15 m"


def test_the_summary_follows_the_probabilities(planted):
    """One sentence for each verdict, with the probability of `Finding`; the same as in the table
    and report.json.
    """
    finding = planted.finding
    one = finding.best("slip_sinkage")
    other = finding.best("bulldozing")
    base = finding.best()

    def report_of(*shares):
        """The report under these probabilities: slip-sinkage, bulldozing, slip-sinkage beside
        something unlisted, nothing, something unlisted alone.
        """
        parts = (
            one,
            other,
            dataclasses.replace(one, free=True),
            base,
            dataclasses.replace(base, free=True),
        )
        found = [dataclasses.replace(h, probability=p) for h, p in zip(parts, shares, strict=True)]
        there = with_hypotheses(planted, sorted(found, key=lambda h: -h.probability))
        effect = planted.effects[0]
        effect = dataclasses.replace(
            effect,
            probability=there.finding.share(effect.name),
            alternatives=there.finding.alternatives(effect.name),
        )
        return dataclasses.replace(there, effects=(effect,))

    ambiguous = sentences.summary(report_of(0.45, 0.4, 0.0, 0.15, 0.0))
    assert "85 %" in ambiguous and "slip-sinkage (45 %); bulldozing (40 %)" in ambiguous
    besides = sentences.summary(report_of(0.05, 0.3, 0.4, 0.05, 0.2))
    assert "in no catalogue, beside these or without them, is 60 %" in besides
    assert "in no catalogue (probability 90 %)" in sentences.summary(
        report_of(0.1, 0.0, 0.0, 0.0, 0.9)
    )
    assert "nothing is missing" in sentences.summary(report_of(0.0, 0.1, 0.0, 0.9, 0.0)).lower()
    beside = report_of(0.83, 0.0, 0.05, 0.1, 0.02)
    assert "in no catalogue is 7 %" in sentences.summary(beside)
    assert drawn.content(beside)["probability"]["remainder"] == pytest.approx(0.07)


@pytest.mark.parametrize(
    "before, after, verdict", [(9.0, 1.2, "named"), (9.0, 4.0, "partly"), (1.0, 1.38, "partly")]
)
def test_a_stated_remainder_makes_a_name_partly(planted, before, after, verdict):
    """An error that stays above the noise, or that the named effect makes larger, is stated with
    the name.
    """
    floor = planted.gap["drawbar_pull"].noise_floor
    gap = planted.gap | {"drawbar_pull": Gap(before * floor, after * floor, floor)}
    report = dataclasses.replace(planted, gap=gap)
    assert report.verdict == drawn.content(report)["verdict"] == verdict
    said = sentences.summary(report)
    assert (f"{floor * math.sqrt(after**2 - 1.0):.2g} N of drawbar pull" in said) == (
        verdict == "partly"
    )
    assert ("rises by 38 %" in said) == (after > before)


def test_beside_two_names_a_third_effect_may_be_what_is_left(planted):
    """A hypothesis has two listed effects at most."""
    gap = planted.gap | {"torque": Gap(9.0, 4.0, 1.0)}
    for effects in (planted.effects, 2 * planted.effects):
        report = dataclasses.replace(planted, gap=gap, effects=effects)
        (said,) = (x for x in sentences.cautions(report) if "torque stays at 4.0 times" in x)
        assert ("a third effect" in said) == (len(effects) == 2)
        assert said.endswith("or something that is not listed.")


def moved(report, name, far):
    """The report with a parameter so many standard deviations of the setup from its prior."""
    u = report.fit.u.copy()
    u[[unknown.name for unknown in report.fit.unknowns].index(name)] = far / PRIOR_WIDTH
    return dataclasses.replace(report, fit=dataclasses.replace(report.fit, u=u))


def test_a_soil_far_from_the_setup_is_a_caution(planted):
    """Moved to 3.5 and 9 standard deviations of the setup, in the fit of the corrected model
    alone.
    """
    for far in (-3.5, 9.0):
        there = moved(planted, "cohesion", far)
        for effects, model in ((there.effects, "named effects"), ((), "base model")):
            report = dataclasses.replace(there, effects=effects)
            (said,) = (said for said in sentences.cautions(report) if "Cohesion c" in said)
            assert f" {abs(far)} " in said and said.endswith(f"in the fit of the {model} alone.")
    assert not any("standard deviations" in said for said in sentences.cautions(planted))


def test_a_bound_is_said_of_the_fit_that_is_there(planted):
    """Stated are the numbers of another fit, which may be elsewhere."""
    fit = planted.fit
    k = [u.name for u in fit.unknowns].index("slip_sinkage_gain")
    u = fit.u.copy()
    u[k] = fit.unknowns[k].bounds[1]
    at_bound = dataclasses.replace(planted, fit=dataclasses.replace(fit, u=u))
    for report, named in (
        (at_bound, "named effects"),
        (dataclasses.replace(at_bound, effects=()), "base model"),
    ):
        (said,) = (said for said in sentences.cautions(report) if "bound of its range" in said)
        assert said.endswith(f"(10) in the fit of the {named} alone.")


def test_lugs_of_which_nothing_is_stated_are_a_caution(planted):
    """Not taken for 0 nor for any height in silence."""
    assert not any("grouser_height" in said for said in sentences.cautions(planted))
    wheel = dataclasses.replace(planted.problem.data.setup.wheel, grouser_height=None)
    said = sentences.cautions(with_setup(planted, wheel=wheel))
    assert any("gives no grouser_height: the base model has a smooth wheel" in x for x in said)


def test_digging_of_the_setup_is_no_missing_effect(tmp_path):
    setup = SETUP.replace("soil:\n", "soil:\n  dig_gain: 1.5\n")
    report = run(*write_files(tmp_path, table_text(PLANTED), setup), leave_out=False)
    assert report.verdict == "none"
    assert any(
        "has the slip-sinkage of the setup (dig_gain 1.5)" in said
        for said in sentences.cautions(report)
    )


@pytest.mark.parametrize(
    ("sure", "words"),
    [
        (0.75, "would hardly help"),
        (0.9, "at least 90 % after them"),
        (0.996, "at least 99 % after them"),
    ],
)
def test_runs_that_separate_nothing_are_not_recommended(sure, words):
    """Candidates with 0.85 and 0.15: the right one has 0.745 on average now."""
    predicted = [SimpleNamespace(probability=p) for p in (0.85, 0.15)]
    report = SimpleNamespace(
        next_tests=[SimpleNamespace(predicted=predicted, sure=sure, repeat=False)],
        verdict="ambiguous",
    )
    assert sentences.right_now(report) == pytest.approx(0.745)
    assert words in sentences.after_next(report)
    assert "what is missing" in sentences.after_next(report)
    assert sentences.runs_help(report) == (sure > 0.8)
    assert not sentences.runs_help(SimpleNamespace(next_tests=[]))


def test_a_soil_parameter_at_a_bound_is_not_said_to_be_assumed(planted):
    soil = planted.soil | {"cohesion": Interval(0.0, 0.0, 0.0)}
    rows = {row[0]: row[2] for row in tables.soil(dataclasses.replace(planted, soil=soil)).rows}
    assert rows["cohesion c"] == "at a bound" and rows["density"] == "given"


def test_a_heavy_load_is_told_without_an_exponent():
    assert sentences._place({"slip": 0.3, "load": 24000.0}) == "slip 0.3 at load 24000 N"


def test_a_wheel_of_the_setup_that_no_row_has_is_told(planted):
    """The corrected model and the priors are of it."""
    for factor, told in ((1.0, False), (0.5, True)):
        wheels = planted.problem.data.rows.wheels * [factor, 1.0, 1.0]
        said = sentences.cautions(with_wheels(planted, wheels))
        assert any("No row has the wheel of the setup" in line for line in said) == told
