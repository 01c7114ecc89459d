"""Result in a sentence, next step, and each effect in plain words: the head of the report."""

from soil_env.discrepancy.instrument import INSTRUMENT
from soil_env.discrepancy.next_tests import CHECKS
from soil_env.discrepancy.report.sentences import listed, runs_help, title
from soil_env.discrepancy.result import LEFT, Report
from soil_env.discrepancy.unnamed import OF_SENSORS

#: The page on which every effect has its equations and sources.
PAGE = "docs/physics/effects.md"
SURE = 0.9  # probability below which an effect explains something "probably"
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
    "multipass": "Soil that was driven over before is denser and bears and shears otherwise.",
    "penetration_rate": "Soil that is loaded faster bears more (or less) before it gives way.",
    "shear_rate": "Soil that is sheared faster is stronger (or weaker).",
    "shear_softening": (
        "The strength of the soil rises to a peak and falls to a residual as it is sheared further."
    ),
    "grade": "On a slope a part of the weight acts along the ground, and the ground bears less.",
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
    names = listed([title(e.name) for e in report.effects]) if report.effects else ""
    finding = report.finding
    near = [title(n) for n in finding.candidates[:3]]
    probably = "" if all(e.probability >= SURE for e in report.effects) else "probably "
    explains = (
        f"{names[:1].upper()}{names[1:]} "
        f"{probably}{'explain' if len(report.effects) > 1 else 'explains'}"
    )
    if report.verdict == "named":
        return f"{explains} what the simulation misses."
    if report.verdict == "partly":
        return f"{explains} a part of what the simulation misses, and a part is left."
    if report.verdict == "unlisted":
        near_by = f"; {listed(near, 'or')} comes closest, but in another form" if near else ""
        return (
            f"Something is missing from the simulation that is none of the listed effects{near_by}."
        )
    if report.verdict == "ambiguous":
        rivals = [(finding.share(n), title(n)) for n in finding.candidates]
        rivals += [
            (finding.unlisted, "something that is in no catalogue"),
            (finding.none, "nothing"),
        ]
        likely = [name for p, name in sorted(rivals, reverse=True) if p >= LIKELY]
        rest = (
            f": most probable {'are' if len(likely) > 1 else 'is'} {listed(likely, 'or')}"
            if likely
            else ""
        )
        return f"These runs do not decide what is missing, if anything{rest}."
    if report.verdict == "none":
        if missed(report):
            return (
                "The simulation misses these runs by what laws and sensors that err could do: no "
                "effect is named."
            )
        return "The simulation agrees with these runs as well as the laws of the soil allow."
    return "These runs are too few to decide if anything is missing."


def next_step(report: Report) -> str:
    """Return the next step, in words."""
    if report.doubts:
        return "Check the table as said above, and run this again."
    beside = [n for e in report.effects for n in (e.name, *e.alternatives)]
    asked = {
        *beside,
        *(n for n in report.finding.candidates if report.finding.share(n) >= LIKELY),
    } & {*INSTRUMENT}
    found = {c: sum(map(report.finding.share, c.decides)) for c in report.next_checks}
    checks = [c for c in CHECKS if found.get(c, 0.0) >= LIKELY or asked & {*c.decides}]
    before = report.problem.data.setup.checked
    done = ", ".join(dict.fromkeys((*before, *(n for c in checks for n in c.decides))))
    steps = [c.work for c in checks]
    of_sensor = report.finding.hypotheses[0].law in OF_SENSORS and report.verdict == "unlisted"
    if of_sensor and not {"force_gain", "torque_gain"} <= {*done.split(", ")}:
        steps.append(
            "load each sensor with several known weights, and correct the columns where it is not "
            "linear"
        )
    steps += [f"correct the columns, and write in the setup `checked: [{done}]`"] if checks else []
    runs = runs_help(report) and report.verdict != "none"
    steps += ["make the next tests below, the first one first, and add their rows"] if runs else []
    steps += ["run this again"] if steps else []
    said = " ".join(f"{step[:1].upper()}{step[1:]}." for step in steps)
    if steps and (
        report.verdict not in ("named", "none") or {e.name for e in report.effects} & {*INSTRUMENT}
    ):
        return said
    if report.verdict in ("ambiguous", "undetermined") or (
        report.verdict == "none" and missed(report)
    ):
        return (
            "Make more runs, at other slips, loads and speeds, add their rows and run this again."
        )
    return "Simulate with model.yaml." + (
        f" To be surer: {said[:1].lower()}{said[1:]}" if steps else ""
    )
