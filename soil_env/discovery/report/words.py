"""Result in a sentence, next step, and each effect in plain words: the head of the report."""

from soil_env.discovery.instrument import INSTRUMENT, exact
from soil_env.discovery.next_tests import open_checks
from soil_env.discovery.result import LEFT, Report
from soil_env.discovery.unnamed import OF_SENSORS

from .sentences import filled, runs_help, title

#: The page on which every effect has its equations and sources.
PAGE = "docs/physics/effects.md"
LIKELY = 0.1  # least probability of what is named as possible, and of what a check would find
EXPLAINED = {
    "slip_sinkage": (
        "A wheel that slips digs soil out from under itself and sinks deeper the more it slips."
    ),
    "rear_contact": (
        "Soil that rebounds touches the wheel behind its lowest point too, and carries and shears "
        "there."
    ),
    "stress_peak_shift": (
        "The place under the wheel where the soil presses hardest moves forward as the slip grows."
    ),
    "grousers": (
        "Lugs shear the soil at their tips, on a larger circle than the rim, or push against it "
        "as blades."
    ),
    "bulldozing": "The wheel pushes a heap of soil ahead of itself, which takes drawbar pull.",
    "multipass": "Soil that was driven over before is denser and carries and shears otherwise.",
    "penetration_rate": "Soil that is loaded faster carries more (or less) before it gives way.",
    "shear_rate": "Soil that is sheared faster is stronger (or weaker).",
    "shear_softening": (
        "The strength of the soil rises to a peak and falls to a residual as it is sheared further."
    ),
    "grade": "On a slope a part of the weight acts along the ground, and the ground carries less.",
    "drivetrain_friction": (
        "Bearings, gears and seals take torque between the sensor and the wheel."
    ),
    "slip_bias": (
        "The recorded slip is off, by its zero or by the rolling radius that it was computed with."
    ),
    "sinkage_offset": "The zero of the sinkage sensor is off.",
    "tilt": "The rig is not level, so that a part of the load is read as pull.",
    "force_offset": "The zero of the load cell that measures the pull is off.",
    "force_gain": "The load cell reads the pull too large or too small by a constant factor.",
    "torque_offset": "The zero of the torque sensor is off.",
    "torque_gain": "The torque sensor reads too much or too little by a constant factor.",
    "wheel_radius": (
        "The wheel has another radius than the setup says, and the slip was computed with that."
    ),
    "force_crosstalk": "The load cell reads a part of the torque as pull.",
    "torque_crosstalk": "The torque sensor reads a part of the pull as torque.",
    "arm_load": (
        "The wheel hangs on an arm that its torque presses down or lifts, so that the load "
        "changes with it."
    ),
    "spring_load": "A spring or the weight of an arm changes the load as the wheel sinks.",
}


def missed(report: Report) -> bool:
    """True if the base model leaves a stated error in a channel."""
    return any(gap.over_noise[0] > LEFT for gap in report.gap.values())


def conclusion(report: Report) -> str:
    """The result in one sentence without a number."""
    finding = report.finding
    rivals = [(finding.share(n), title(n)) for n in finding.candidates]
    rivals += [(finding.unlisted, "something that is in no catalogue"), (finding.none, "nothing")]
    return filled(
        "conclusion.txt",
        report,
        effects=[title(e.name) for e in report.effects],
        near=[title(n) for n in finding.candidates[:3]],
        beside=[title(n) for n in finding.candidates if finding.share(*finding.names, n) >= LIKELY],
        rivals=[name for p, name in sorted(rivals, reverse=True) if p >= LIKELY],
        missed=missed(report),
    )


def next_step(report: Report) -> str:
    """Return the next step, in words."""
    named = {e.name for e in report.effects}
    possible = {n for n in report.finding.candidates if report.finding.share(n) >= LIKELY}
    suspected = named | possible
    found = {c.name: sum(map(report.finding.share, c.decides)) for c in report.next_checks}
    setup = report.problem.data.setup
    checks = [
        c
        for c in open_checks(exact(setup))
        if found.get(c.name, 0.0) >= LIKELY or suspected & {*INSTRUMENT} & {*c.decides}
    ]
    before = setup.checked
    done = list(dict.fromkeys((*before, *(n for c in checks for n in c.decides))))
    of_sensor = report.finding.hypotheses[0].law in OF_SENSORS and report.verdict == "unlisted"
    return filled(
        "next_step.txt",
        report,
        checks=checks,
        done=", ".join(done),
        load_sensors=of_sensor and not {"force_gain", "torque_gain"} <= {*done},
        runs=report.surer_runs or (runs_help(report) and report.verdict != "none"),
        of_rig=named & {*INSTRUMENT},
        missed=missed(report),
    )
