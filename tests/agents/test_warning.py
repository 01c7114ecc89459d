"""Warning of immobilisation: its alarms and events against a script, the shipped weights on
courses.
"""

from types import SimpleNamespace

import numpy as np
import pytest

from soil_env.identification.online.immobilisation import FILE, Assessed, shipped
from soil_env.parameters import load_scenario
from soil_env.simulation.world.wheel import WHEEL
from soil_env_agents.controllers import make_controller
from soil_env_agents.evaluate.driving import run_courses
from soil_env_agents.evaluate.warning import KEPT, RELEASE, Foresight


def spell(share=0.0, seconds=1.0, halted=False, goes_on=True):
    """Control periods of 0.1 s, [(probability over the threshold of the alarm, halted, True if the
    wheel gets further at 0.1 m/s)].
    """
    return [(share, halted, goes_on and not halted)] * round(10 * seconds)


END = spell(1.0) + spell(0.9, goes_on=False)
LEADS = {  # name: (script, distance [m] and time [s] from the alarm to the last mobile moment)
    "on at the threshold": (
        spell(0.99, 3) + spell(1.0, 2) + spell(0.9, 4, goes_on=False),
        (0.19, 1.9),
    ),
    "on when the wheel is stuck": (
        spell(seconds=2) + spell(1.0, 4, goes_on=False),
        (np.nan, np.nan),
    ),
    "kept over half of the threshold": (spell(1.0) + spell(0.51, 3) + END, (0.49, 4.9)),
    "kept over 0.9 s": (spell(1.0) + spell(0.4, 0.9) + END, (0.28, 2.8)),
    "off after 1 s": (spell(1.0) + spell(0.4) + END, (0.09, 0.9)),
    "no sign in a halt": (
        spell() + spell(1.0, 3, halted=True) + spell(1.0, 0.2) + END[10:],
        (0.01, 0.1),
    ),
    "no end in a halt": (
        spell(1.0) + spell(0.4, 3, halted=True) + spell(1.0) + END[10:],
        (0.19, 4.9),
    ),
}


@pytest.mark.parametrize("name", LEADS)
def test_an_alarm_comes_on_and_goes_off_after_a_while_of_driving(name, monkeypatch):
    """Scripts of `LEADS`, in control periods of 0.1 s; a wheel that goes on gets 0.01 m further in
    each.
    """
    scenario = load_scenario("mixed", {"control": {"action": "torque"}})
    assert (KEPT, RELEASE, scenario.control.period) == (0.5, 1.0, 0.1)
    foresight = Foresight(scenario, 1)
    (script, lead) = LEADS[name]
    worlds = SimpleNamespace(
        state=np.zeros(1, WHEEL), recent=None, ids=SimpleNamespace(estimate=None, sd=None)
    )
    for share, halted, goes_on in script:
        found = Assessed(np.empty(0), np.array([[0.0, share * foresight.alarms.threshold]]))
        monkeypatch.setattr(foresight.warning, "assess", lambda *_, found=found: found)
        worlds.state["halt_left"] = float(halted)
        worlds.state["best_x"] += 0.01 * goes_on
        foresight.step(worlds, np.array([True]))
    assert foresight.lead(worlds, np.array([False]))[0] == pytest.approx(lead, nan_ok=True)
    if name == "on when the wheel is stuck":  # a bogged wheel was mobile to the end
        assert foresight.lead(worlds, np.array([True]))[0] == pytest.approx([0.0, 3.9])
        assert [*foresight.under, *foresight.driven] == pytest.approx([4.0, 6.0])


@pytest.fixture(scope="module")
def warned():
    """{speed: (foreseen, time ahead [s], false share)} of courses on which neither weights nor
    threshold were set.
    """
    card = shipped()["card"]
    scenario = load_scenario("two_lines", {"control": {"action": "torque"}})
    assert "two_lines" in card["scenarios"] and FILE.stat().st_size < 100_000
    found = {}
    for speed in (0.2, 0.3, 0.4, 0.6):
        controller = make_controller("constant_speed", scenario, speed=speed)
        runs = run_courses(controller, scenario, card["sets"]["test"], 60, detailed=True)
        names = ("foreseen", "foreseen_time", "false_foresight")
        found[speed] = [runs.metric(name) for name in names]
    return found


def at_speeds(warned, *speeds):
    """(foreseen, time ahead [s], false share) at some of the speeds."""
    return [np.concatenate(values) for values in zip(*(warned[s] for s in speeds), strict=True)]


def test_the_shipped_weights_warn_in_time(warned):
    for speeds in ((0.2, 0.3, 0.4), (0.2, 0.4, 0.6)):
        foreseen, lead, _ = at_speeds(warned, *speeds)
        assert np.isfinite(foreseen).sum() > 40
        assert np.nanmean(foreseen) > 0.9 and np.nanmedian(lead) > 4.0


def test_the_shipped_weights_warn_seldom_for_nothing(warned):
    """The threshold is that of 5 % false alarm over all drivers."""
    false = at_speeds(warned, 0.2, 0.3, 0.4)[2]
    assert np.isfinite(false).sum() > 40 and np.nanmean(false) < 0.12


@pytest.mark.xfail(strict=True, reason="14 % false at these speeds, 23 % at 0.6 m/s")
def test_the_shipped_weights_warn_seldom_for_nothing_at_speed(warned):
    assert np.nanmean(at_speeds(warned, 0.2, 0.4, 0.6)[2]) < 0.12
