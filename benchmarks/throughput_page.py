"""The tables of docs/performance.md from the figures of `throughput.run`."""

from __future__ import annotations

from benchmarks.common import machine_text, range_text
from soil_env._io.document import Table
from soil_env.parameters import DEFAULT_SCENARIO


def machine(result: dict) -> str:
    """The machine line."""
    text = machine_text(result["machine"], "numpy", "numba", "llvmlite")
    return f"{text}. Medians of rounds, with the lowest and the highest."


def targets(result: dict) -> str:
    """The two targets and their references."""
    t, rows = result["targets"], []
    names = {
        "vector": (
            f"`SoilWheelVectorEnv`, {t['wheels']} wheels, {t['threads']} threads",
            "EnvPool CartPole-v1, so too",
        ),
        "vector_none": ("the same with `belief.method` none, `blind`", ""),
        "vector_default": (f"the same on `{DEFAULT_SCENARIO}`", ""),
        "single": ("`SoilWheelEnv`", "Gymnasium HalfCheetah-v5"),
    }
    for key, (ours, reference) in names.items():
        c = t[key]
        theirs, ratio = "not measured" if reference else "", ""
        if "reference" in c:
            theirs, ratio = range_text(c["reference"], 0, 1e-3), range_text(c["ratio"])
        rows.append([ours, range_text(c["ours"], 0, 1e-3), reference, theirs, ratio])
    text = Table(["env", "1000 steps/s", "reference", "1000 steps/s", "ratio"], rows).markdown()
    return "\n\n".join([text, *result["notes"]])


def scaling(result: dict) -> str:
    """Steps/s over N and threads."""
    rows = [[str(r["wheels"]), range_text(r["1"], 0, 1e-3), range_text(r["2"], 0, 1e-3)] for r in result["scaling"]]
    return Table(["wheels", "1 thread, 1000 steps/s", "2 threads, 1000 steps/s"], rows).markdown()


def parts(result: dict) -> str:
    """Cost of each part beside its limit."""
    p, possible = result["parts"], result["limit"]["us"]
    total = sum(v["median"] for v in p["us"].values())
    rows = []
    for name, value in p["us"].items():
        share = f"{100 * possible[name] / value['median']:.0f} %" if name in possible else ""
        least = f"{possible[name]:.3f}" if name in possible else ""
        rows.append([name, range_text(value, 3), f"{100 * value['median'] / total:.0f} %", least, share])
    least = sum(possible.values())
    rows.append(["all", f"{total:.3f}", "100 %", f"{least:.3f}", f"{100 * least / total:.0f} %"])
    text = Table(["part", "us a wheel and step, one core", "share", "limit, us", "limit / achieved"], rows).markdown()
    often = (
        f"A step completes {p['solves_a_step']:.2f} points of the estimator, draws {p['patches_a_step']:.4f} patches "
        f"and resets {p['resets_a_step']:.4f} wheels on average."
    )
    return text + "\n\n" + often


def rates(result: dict) -> str:
    """Throughput of the machine for single operations."""
    names = {"exp": "exp", "log": "log", "sin_cos": "sin and cos", "fma": "multiply and add", "scalar": "exp of libm"}
    rows = [[names[k], "1" if k == "scalar" else "8", range_text(v)] for k, v in result["limit"]["ns"].items()]
    b = result["limit"]["bytes"]
    return (
        Table(["operation", "numbers", "ns"], rows).markdown()
        + f"\n\nA wheel takes {b['wheel']:,} bytes; a step reads or writes about {b['step']:,} of them, and "
        f"up to {b['solve']:,} more where it completes a point of the estimator."
    )


def independence(result: dict) -> str:
    """Ratios over course length and age."""
    i = result["independence"]
    return Table(
        ["cost of a step over", "ratio"],
        [
            ["a course of 100 m / one of 10 m", range_text(i["length"])],
            ["wheels late / early in their episode", range_text(i["age"])],
            ["a course of 100 m / one of 10 m, resets included", range_text(i["length_with_resets"])],
        ],
    ).markdown()


def accuracy(result: dict) -> str:
    """Errors of the contact rule."""
    rows = [[k, f"{v['median']:.1e}", f"{v['high']:.1e}"] for k, v in result["accuracy"].items()]
    return Table(["", "median", "largest"], rows).markdown()


def startup(result: dict) -> str:
    """Seconds to import, to the first `reset` and to the first `step`."""
    s = result["startup"]
    if not s:
        return "Not measured."
    return Table(
        ["", "s"],
        [
            ["`import soil_env` beyond numpy and gymnasium", range_text(s["import"])],
            ["first env and `reset`, nothing cached", f"{s['first_reset']:.1f}"],
            ["the first env, `reset` and `step` after that, in the same process", f"{s['first_step_after']:.1f}"],
            ["env and `reset`, cached", range_text(s["cached_reset"])],
            ["env, `reset` and `step`, cached", range_text(s["cached_step"])],
        ],
    ).markdown()


SECTIONS = {
    "machine": machine, "targets": targets, "scaling": scaling, "parts": parts, "rates": rates,
    "independence": independence, "accuracy": accuracy, "startup": startup,
}  # fmt: skip


def sections(result: dict) -> dict[str, str]:
    """Text between the markers of docs/performance.md, by marker."""
    return {name: section(result) for name, section in SECTIONS.items()}


def summary(result: dict) -> str:
    """The targets and the parts, for the terminal."""
    return "\n\n".join([machine(result), targets(result), parts(result)])
