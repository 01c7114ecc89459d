"""What a reader of a report should be wary of."""

import dataclasses

from soil_env.discrepancy import run
from soil_env.discrepancy.calibrate import PRIOR_WIDTH
from soil_env.discrepancy.report import cautions
from tests.discrepancy.files import PLANTED, SETUP, table_text, write_files


def test_cautions_are_of_the_soil_that_is_shown(planted):
    """Moved to 3.5 and 9 standard deviations of the setup, in the fit of the corrected model alone."""
    k = [u.name for u in planted.fit.unknowns].index("cohesion")
    for far in (3.5, 9.0):
        u = planted.fit.u.copy()
        u[k] = (-far if far * 700 < 3700 else far) / PRIOR_WIDTH
        moved = dataclasses.replace(planted, fit=dataclasses.replace(planted.fit, u=u))
        assert any("Cohesion c" in text and f" {far} " in text for text in cautions.cautions(moved))
        assert cautions.check_first(moved) == []  # a caution, no sign of a wrong unit
    assert not any("standard deviations" in text for text in cautions.cautions(planted))


def test_an_effect_whose_two_fits_do_not_agree_is_told(planted):
    assert not any("do not rely" in said for said in cautions.cautions(planted))
    (effect,) = planted.effects
    gain = effect.parameters["gain"]
    far = gain._replace(value=0.1, low=0.0, high=0.2)
    other = dataclasses.replace(effect, parameters=effect.parameters | {"gain": far})
    said = cautions.cautions(dataclasses.replace(planted, effects=(other,)))
    value = planted.model.effects["slip_sinkage"]["gain"]
    assert any(f"model.yaml has gain {value:.3g}, far outside of 0 to 0.2" in text for text in said)


def test_slip_sinkage_that_the_setup_has_is_said_to_be_in_the_base_model(tmp_path):
    digging = SETUP.replace("soil:\n", "soil:\n  dig_gain: 1.5\n")
    report = run(*write_files(tmp_path, table_text(PLANTED), digging))
    assert report.verdict == "none"
    assert any("has the slip-sinkage of the setup (dig_gain 1.5)" in said for said in cautions.cautions(report))


def test_noise_of_the_slip_is_said_to_count(tmp_path):
    told = SETUP.replace("noise: {", "noise: {slip: 0.01, ")
    said = cautions.cautions(run(*write_files(tmp_path, table_text({}), told)))
    assert any(text.startswith("The noise of slip counts as noise of what was measured") for text in said)


def test_a_speed_of_zero_is_not_a_speed_that_is_missing(tmp_path):
    text = table_text({}, loads=(100, 150), speed=(0.05,))
    lines = text.splitlines()
    k = lines[0].split(",").index("speed")
    cells = lines[1].split(",")
    cells[k] = "0"
    lines[1] = ",".join(cells)
    report = run(*write_files(tmp_path, "\n".join(lines) + "\n"))
    assert report.finding.untestable["shear_rate"] == "a speed of 0"
