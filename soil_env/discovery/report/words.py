"""Result in a sentence, next step, and each effect in plain words: the head of the report."""

from soil_env.discovery.instrument import INSTRUMENT, ruled_out
from soil_env.discovery.next_tests import open_checks
from soil_env.discovery.result import LEFT, Report
from soil_env.discovery.search import NAMED
from soil_env.discovery.unnamed import OF_SENSORS

from .sentences import filled, runs_help, title

#: The page on which every effect has its equations and sources.
PAGE = "docs/physics/effects.md"
LIKELY = 0.1  # least probability of what is mentioned as possible, and of what a check would find


def base_misses(report: Report) -> bool:
    """True if the base model's held-out error is more than `LEFT` times the noise in any
    channel.
    """
    return any(gap.over_noise[0] > LEFT for gap in report.gap.values())


def conclusion(report: Report) -> str:
    """The result in one sentence without a number, by the verdict ("conclusion.txt"): named effects
    and what may be beside or instead of them.
    """
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
        base_misses=base_misses(report),
        # A name is withheld only since the laws may err.
        by_laws=max(map(finding.share, finding.tried), default=0.0) >= NAMED,
    )


def next_step(report: Report) -> str:
    """Return the next step, in words: checks of the instrument, then runs, or else to simulate.

    A check is asked for if it is among the next checks and would find something with `LIKELY`. It
    is also asked for if it decides an error of the rig that is named or has that probability.
    """
    finding = report.finding
    named = {e.name for e in report.effects}
    suspected = named | {n for n in finding.candidates if finding.share(n) >= LIKELY}
    found = {c.name: sum(map(finding.share, c.decides)) for c in report.next_checks}
    setup = report.problem.data.setup
    checks = [
        c
        for c in open_checks(ruled_out(setup))
        if found.get(c.name, 0.0) >= LIKELY or suspected & {*INSTRUMENT} & {*c.decides}
    ]
    done = dict.fromkeys((*setup.checked, *(n for c in checks for n in c.decides)))
    of_sensor = finding.hypotheses[0].law in OF_SENSORS and report.verdict == "unlisted"
    return filled(
        "next_step.txt",
        report,
        checks=checks,
        done=", ".join(done),
        load_sensors=of_sensor and not {"force_gain", "torque_gain"} <= {*done},
        runs=report.surer_runs or (runs_help(report) and report.verdict != "none"),
        of_rig=named & {*INSTRUMENT},
        base_misses=base_misses(report),
    )
