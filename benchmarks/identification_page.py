"""docs/identification.md and its plots from the result of benchmarks/identification.py."""

from __future__ import annotations

import textwrap
from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt  # noqa: E402

from benchmarks import identification_online  # noqa: E402
from soil_env._io.files import replace_file, save_figure

_NAMES = ("phi", "K", "S")


def _wrap(text: str) -> list[str]:
    return textwrap.wrap(" ".join(text.split()), 118, break_long_words=False, break_on_hyphens=False)


def _row(*cells) -> str:
    return "| " + " | ".join(str(c) for c in cells) + " |"


def _head(*cells) -> list[str]:
    return [_row(*cells), "|" + "---|" * len(cells)]


def _short(result) -> list[str]:
    """What is claimed, in a few sentences."""
    runs, o = result["convergence"].values(), result["online"]
    solved, wrong = min(t["recovered"] / t["identifiable"] for t in runs), sum(t["silently_wrong"] for t in runs)
    ours, prior = o["contenders"]["ours"], o["prior_rms"]
    rivals = [n for n in o["contenders"] if n not in ("ours", "batch_joint")]

    def best(key):
        found = {n: o["contenders"][n]["rms"][key] for n in rivals if o["contenders"][n]["rms"].get(key)}
        name = min(found, key=lambda n: found[n]["value"])
        return f"{found[name]['value']:.2f} ({_CONTENDERS[name]})"

    ratios = o["time"]["ratio_per_reading"]
    slowest = min((n for n in rivals if n != "linear"), key=lambda n: ratios[n])
    values = {k: ours["rms"][k]["value"] for k in prior}
    return [
        *_wrap(
            f"""**In short.** From any guess in the paper's box the solver finds the soil of at least {solved:.2%} of
            the identifiable problems, {wrong} silently wrong. With noise its errors are those of the Cramer-Rao
            bound. While the wheel drives, the RMS error over all steps is {values["phi_deg"]:.2f} deg,
            {values["ln_K"]:.2f} in ln K and {values["ln_S"]:.2f} in ln S, against {prior["phi_deg"]:.2f} deg,
            {prior["ln_K"]:.2f} and {prior["ln_S"]:.2f} of the prior alone, and {best("phi_deg")}, {best("ln_K")}
            and {best("ln_S")} of the best rival in each; the estimate is current in
            {ours["valid_share"]["value"]:.0%} of the steps, held in the rest. It takes
            {o["time"]["us_per_reading"]["ours"]:.2f} us a reading; the quickest rival but the linear one,
            {_CONTENDERS[slowest]}, takes {ratios[slowest]:.0f} times as long. What stays weak is the friction
            angle, which cohesion hides: see the share of patches in which its error shrinks at all."""
        ),
        "",
    ]


def _convergence(result) -> list[str]:
    lines = [
        "## Convergence",
        "",
        *_wrap(
            """Noise-free points of random soils of the paper's wheel, initial guesses drawn from the whole box of the
            paper's Table 4 (phi 5-89 deg, K 0.015-0.089 m, S 7e4-3.1e12). A problem counts as identifiable if the
            condition number of its whitened Jacobian by (phi, ln K, ln S) is at most 100 and no second soil within the
            bounds of the solver gives the same values: three equations can have two exact roots, and the estimate
            then has the status AMBIGUOUS and both soils, here each checked to give the values to 1e-6. Problems are
            drawn until the stated number is identifiable; what is worse conditioned is set aside unsolved, among it
            the paper's own points (docs/paper.md). Recovered: status CONVERGED and all three unknowns right to
            1e-4."""
        ),
        "",
        *_head(
            "data",
            "drawn",
            "badly conditioned, set aside",
            "two exact soils, said so",
            "identifiable",
            "recovered",
            "reported by status",
            "silently wrong",
        ),  # fmt: skip
    ]
    for name, t in result.items():
        share = t["recovered"] / t["identifiable"]
        lines.append(
            _row(
                name,
                t["drawn"],
                t["drawn"] - t["ambiguous"] - t["identifiable"],
                t["ambiguous"],
                t["identifiable"],
                f"{t['recovered']} ({share:.2%})",
                t["flagged"],
                t["silently_wrong"],
            )
        )
    return lines


def _triple(values, form: str) -> str:
    return " / ".join(form.format(v) for v in values)


def _efficiency(rows) -> list[str]:
    lines = [
        "## Efficiency",
        "",
        *_wrap(
            """Lunar soil, rover wheel, sensor noise of the environment; drawbar pull, load and torque. Root-mean-square
            error over the Cramer-Rao bound of the same points and noise, and share of draws in which the reported 95
            % interval covers the truth, each as phi / K / S. With noise in slip and sinkage, the bound is that of
            the effective variance. Least squares that leaves that noise out is shown for comparison, with its bias
            over the bound."""
        ),
        "",
        *_head(
            "noise in slip and sinkage", "points", "method", "RMS error / bound", "bias / bound", "coverage of 95 % [%]"
        ),
    ]
    for r in rows:
        lines.append(
            _row(
                "yes" if r["noise_in_slip_and_sinkage"] else "no",
                r["points"],
                r["method"],
                _triple(r["rmse_over_bound"], "{:.2f}"),
                _triple(r["bias_over_bound"], "{:+.2f}"),
                _triple([100.0 * v for v in r["coverage_95"]], "{:.1f}"),
            )
        )
    return lines


def _identifiability(rows) -> list[str]:
    lines = [
        "## What the data can tell",
        "",
        *_wrap(
            """Cramer-Rao bounds (one standard deviation) for 24 points at three loads and slips from 0.03 to 0.7 under
            the rover wheel, by channels and set of unknowns; S at equal pressure at the mean sinkage, cohesion in
            kPa. `yes`: phi to 5 deg, K and S to 50 %, n to 0.2 and c to the larger of 0.5 kPa and 30 %. In heavy
            clay (68.95 kPa) the cohesion carries the wheel, friction hardly shows."""
        ),
        "",
        *_head(
            "soil", "channels", "unknowns", "condition", "phi [deg]", "ln K", "ln S", "n", "c [kPa]", "identifiable"
        ),
    ]
    for r in rows:
        b = r["bound"]
        cells = [f"{b[k]:.2g}" if k in b else "" for k in ("phi_deg", "ln_K", "ln_S", "n", "c_kPa")]
        told = "yes" if r["identifiable"] else "no"
        lines.append(_row(r["soil"], r["data"], r["unknowns"], f"{r['condition']:.0f}", *cells, told))
    return lines


def _online(o) -> list[str]:
    def cell(record, form="{:.2f}"):
        if record is None or record["value"] is None:
            return ""
        return f"{form.format(record['value'])} [{form.format(record['low'])}, {form.format(record['high'])}]"

    drive = o["drive"]
    lines = [
        "## Online on a course",
        "",
        *_wrap(
            f"""{o["courses"]} courses of scenario "{o["scenario"]}" with its sensor noise; {drive["readings"]} readings
            over {drive["distance_m"]:.0f} m. All contenders replay the same readings; those that use our compiled
            prediction of a point profit from its speed. Newton-Raphson has no prior but for its first guess, and least
            squares for c and phi none at all; a solution outside the bounds is not valid, and an estimate that is not
            valid is held. The Kalman filters have our prior and weights, and were tuned on other courses. RMS errors
            over all driven steps, held estimates counted, with 95 % intervals over courses; in brackets after the time,
            how many times that of ours; the prior alone has {o["prior_rms"]["phi_deg"]:.2f} deg,
            {o["prior_rms"]["ln_K"]:.2f}
            and {o["prior_rms"]["ln_S"]:.2f}."""
        ),
        "",
        *_head(
            "identifier", "phi [deg]", "ln K", "ln S", "valid share", "95 % coverage phi / K / S [%]", "us a reading"
        ),
    ]
    times = o["time"]["us_per_reading"]
    for name, e in o["contenders"].items():
        coverage = e["coverage"]["95"] if "95" in e["coverage"] else e["coverage"][max(e["coverage"], key=float)]
        shares = [coverage.get(k) for k in ("phi_deg", "ln_K", "ln_S")]
        covered = " / ".join("-" if c is None or c["value"] is None else f"{100 * c['value']:.0f}" for c in shares)
        valid = e["valid_share"]["value"]
        lines.append(
            _row(
                _CONTENDERS.get(name, name),
                *(cell(e["rms"].get(k)) for k in ("phi_deg", "ln_K", "ln_S")),
                "" if valid is None else f"{valid:.2f}",
                covered,
                f"{times[name]:.1f} (x{o['time']['ratio_per_reading'][name]:.1f})" if name in times else "",
            )
        )
    settling = o["contenders"]["ours"]["settling"]
    words = []
    for key, label in (("phi_deg", "phi"), ("ln_K", "K"), ("ln_S", "S")):
        if settling.get(key):
            t = settling[key]
            words.append(
                f"{label} {t['distance_m']:.2f} m or {t['time_s']:.1f} s ({t['share_of_patches']:.0%} of patches)"
            )
    return [
        *lines,
        "",
        *_wrap(
            f"""Median distance and time from a border to 90 % of the final accuracy, ours, over the patches where the
            error shrank at all: {", ".join(words)}."""
        ),
    ]


_CONTENDERS = {
    "ours": "ours",
    "newton_raphson": "three-point Newton-Raphson (the paper)",
    "linear": "linear least squares, c and phi (Iagnemma & Dubowsky 2004)",
    "ukf": "unscented Kalman filter of phi, K, S",
    "ukf_joint": "unscented Kalman filter of what ours solves for",
    "batch": "scipy least_squares for phi, K, S on our window",
    "batch_joint": "scipy least_squares for what ours solves for, on our window",
}


def _speed(s) -> list[str]:
    us = lambda d: f"{1e6 * d['median']:.0f} us ({1e6 * d['low']:.0f}-{1e6 * d['high']:.0f})"  # noqa: E731
    times = lambda d: f"{d['median']:.0f} ({d['low']:.0f}-{d['high']:.0f})"  # noqa: E731
    published = ", ".join(f"{v} s ({k})" for k, v in s["published_s"].items())
    return [
        "## Speed",
        "",
        *_wrap(
            f"""One three-point solve on drawbar pull, median and 5-95 % range over the same problems in one run; the
            other side is scipy.optimize.root on scipy.integrate.quad integrals (converged in
            {s["scipy_converged"]:.0%} of them, largest difference between both solutions
            {s["largest_difference"]:.1e}). Published times of one identification: {published}."""
        ),
        "",
        *_head("solve", "time", "times faster than scipy"),
        _row("compiled `solve`", us(s["compiled_solve_s"]), times(s["ratio_compiled"])),
        _row("the same, and the search for a second soil", us(s["checked_solve_s"]), times(s["ratio_checked"])),
        _row("`newton_raphson` from Python, checks included", us(s["newton_raphson_s"]), times(s["ratio"])),
        _row("scipy", us(s["scipy_s"]), "1"),
    ]


def efficiency_figure(rows, path: Path) -> None:
    """RMS error over the bound against the number of points."""
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.6), sharey=True)
    for k, axis in enumerate(axes):
        for noisy, method, marker in (
            (False, "weighted", "o"),
            (True, "errors in variables", "s"),
            (True, "plain least squares", "^"),
        ):
            chosen = [r for r in rows if r["noise_in_slip_and_sinkage"] == noisy and r["method"] == method]
            label = f"{method}, noise in slip and sinkage" if noisy else "no noise in slip and sinkage"
            axis.plot(
                [r["points"] for r in chosen], [r["rmse_over_bound"][k] for r in chosen], marker=marker, label=label
            )
        axis.axhline(1.0, color="#888888", lw=1)
        axis.axhline(1.1, color="#888888", lw=1, ls=":")
        axis.set_title(_NAMES[k])
        axis.set_xlabel("points")
        axis.set_ylim(0.8, 3.0)
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("RMS error / Cramer-Rao bound")
    axes[2].legend(fontsize=8)
    figure.tight_layout()
    save_figure(figure, path, dpi=110)
    plt.close(figure)


def write(result: dict, folder: Path) -> None:
    """Write identification.md and its plots into `folder`."""
    plots = folder / "identification"
    plots.mkdir(exist_ok=True)
    efficiency_figure(result["efficiency"], plots / "efficiency.png")
    identification_online.figure(result["online"], plots / "online.png")
    lines = [
        "# Identification, measured",
        "",
        *_wrap(f"""Made by `{result["command"]}`, seed {result["seed"]} ({result["machine"]})."""),
        "",
        *(["**A smoke run: the numbers mean nothing.**", ""] if "--smoke" in result["command"] else []),
        *_short(result),
        *_convergence(result["convergence"]),
        "",
        *_efficiency(result["efficiency"]),
        "",
        "![RMS error over the Cramer-Rao bound](identification/efficiency.png)",
        "",
        *_identifiability(result["identifiability"]),
        "",
        *_online(result["online"]),
        "",
        "![Error against distance since the border, and calibration](identification/online.png)",
        "",
        *_speed(result["speed"]),
        "",
    ]
    replace_file(folder / "identification.md", "\n".join(lines))
