"""docs/identification.md and its plots from the result of benchmarks/identification.py; the text is its template."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from benchmarks import identification_bound, identification_drives, identification_one_soil, identification_online
from soil_env._io.document import Table, render, wrapped
from soil_env._io.files import replace_file, save_figure

_NAMES = ("phi", "K", "S")
_UNKNOWNS = ("phi_deg", "ln_K", "ln_S")
_CONTENDERS = {
    "ours": "ours (filter bank)",
    "library": "ours, told the library of soils",
    "ekf_joint": "extended Kalman filter of the five unknowns of the window",
    "window": "the moving window",
    "newton_raphson": "three-point Newton-Raphson (the paper)",
    "linear": "linear least squares, c and phi (Iagnemma & Dubowsky 2004)",
    "ukf": "unscented Kalman filter of phi, K, S",
    "ukf_joint": "unscented Kalman filter of the five unknowns of the window",
    "batch": "scipy least_squares for phi, K, S on the window",
    "batch_joint": "scipy least_squares for all five unknowns of the window",
}


def write(result: dict, folder: Path) -> None:
    """Write identification.md and its plots into `folder`."""
    plots = folder / "identification"
    plots.mkdir(exist_ok=True)
    efficiency_figure(result["efficiency"], plots / "efficiency.png")
    identification_online.figure(result["online"], plots / "online.png")
    replace_file(folder / "identification.md", markdown(result))


def markdown(result: dict) -> str:
    """The page."""
    online, runs, speed = result["online"], result["convergence"].values(), result["speed"]
    ours, prior, ratios = online["contenders"]["ours"], online["prior_rms"], online["time"]["ratio_per_reading"]
    rivals = [name for name in online["contenders"] if name not in ("ours", "library")]
    quickest = min((name for name in rivals if name != "window"), key=lambda name: ratios[name])
    bound = result["bound"]
    text = render(
        "benchmarks:identification.md",
        r=result,
        made=_made(result["made"]),
        online=online,
        solved=min(t["recovered"] / t["identifiable"] for t in runs),
        wrong=sum(t["silently_wrong"] for t in runs),
        ours=ours["rms"],
        prior="{phi_deg:.2f} deg, {ln_K:.2f} and {ln_S:.2f}".format(**prior),
        rivals={key: _best(online, rivals, key) for key in _UNKNOWNS},
        valid=ours["valid_share"]["value"],
        quickest=_CONTENDERS[quickest],
        quickest_ratio=ratios[quickest],
        settling=_settling(ours["settling"]),
        published=", ".join(f"{v} s ({k})" for k, v in speed["published_s"].items()),
        convergence=_convergence(result["convergence"]),
        efficiency=_efficiency(result["efficiency"]),
        identifiability=_identifiability(result["identifiability"]),
        contenders=_contenders(online),
        bound=identification_bound.table(bound),
        loss=identification_bound.loss_table(bound),
        manoeuvre=identification_drives.manoeuvre_table(result["manoeuvre"]),
        other=_other(result["other_seed"]),
        one_soil=identification_one_soil.table(result["one_soil"]),
        one_soil_over={row: _intervals(ratio) for row, ratio in result["one_soil"]["ratio"].items()},
        library=identification_drives.library_table(result["other_seed"]["library"]),
        over_bound=_intervals(bound["ratio"]["filter bank"]),
        window_over_bound=_intervals(bound["ratio"]["moving window"]),
        near=_triple([sum(row[5][j] for row in bound["loss"] if row[1] <= 1.0) for j in range(3)], "{:.0%}"),
        near_steps=sum(row[2] for row in bound["loss"] if row[1] <= 1.0),
        speed=_speed(speed),
    )
    return wrapped(text)


def _other(found: dict) -> dict[str, str]:
    """What the page says of the other courses: errors, ratios and intervals in words."""
    ours, exact, rms = "filter bank", found["exact_slip"], found["rms"]
    errors = lambda values: "{:.2f} deg, {:.3f} and {:.3f}".format(*values)  # noqa: E731
    ratios = lambda of: _intervals(of["ratio"][ours])  # noqa: E731
    best, stressed = rms["bound, all sensors"]["all"], rms["bound, all sensors and the stress on the rim"]["all"]
    above = [[v[j] ** 2 - best[j] ** 2 for j in range(3)] for v in (rms[ours]["all"], exact["rms"][ours]["all"])]
    gone = [1.0 - after / before for before, after in zip(*above, strict=True)]
    return {
        "seed": found["seed"], "courses": found["courses"], "bound": errors(best), "stress": errors(stressed),
        "ours": errors(rms[ours]["all"]), "ratios": ratios(found), "window": errors(rms["moving window"]["all"]),
        "library": errors(rms["filter bank, told the library"]["all"]),
        "inside": "{:.0f}, {:.0f} and {:.0f} %".format(*(100.0 * v for v in found["inside_68"][ours])),
        "library_inside": "{:.0f}, {:.0f} and {:.0f} %".format(
            *(100.0 * v for v in found["inside_68"]["filter bank, told the library"])
        ),
        "exact": errors(exact["rms"][ours]["all"]), "exact_ratios": ratios(exact),
        "gone": "{:.0%} in the friction angle, {:.0%} in ln K and {:.0%} in ln S".format(*gone),
    }  # fmt: skip


def _best(online: dict, rivals: list[str], key: str) -> str:
    """Error and name of the best rival."""
    found = {name: online["contenders"][name]["rms"].get(key) for name in rivals}
    name = min((n for n, error in found.items() if error), key=lambda n: found[n]["value"])
    return f"{found[name]['value']:.2f} ({_CONTENDERS[name]})"


def _made(made: dict) -> list[str]:
    """Lines that say which parts come from which command."""
    by_command: dict = {}
    for part, how in made.items():
        by_command.setdefault((how["command"], how["seed"], how["machine"]), []).append(part)
    return [f"{', '.join(parts)}: `{c}`, seed {seed} ({on})" for (c, seed, on), parts in by_command.items()]


def _intervals(ratio: dict) -> str:
    """Three ratios with their 95 % intervals."""
    rows = zip(ratio["value"], ratio["low"], ratio["high"], strict=True)
    return ", ".join(f"{value:.2f} [{low:.2f}, {high:.2f}]" for value, low, high in rows)


def _settling(settling: dict) -> str:
    words = []
    for key, label in zip(_UNKNOWNS, _NAMES, strict=True):
        if t := settling.get(key):
            share = f"{t['share_of_patches']:.0%} of patches"
            words.append(f"{label} {t['distance_m']:.2f} m or {t['time_s']:.1f} s ({share})")
    return ", ".join(words)


def _convergence(result: dict) -> Table:
    header = ("data", "drawn", "badly conditioned, set aside", "two exact soils, said so", "identifiable", "recovered",
              "reported by status", "silently wrong")  # fmt: skip
    rows = [
        (name, t["drawn"], t["drawn"] - t["ambiguous"] - t["identifiable"], t["ambiguous"], t["identifiable"],
         f"{t['recovered']} ({t['recovered'] / t['identifiable']:.2%})", t["flagged"], t["silently_wrong"])
        for name, t in result.items()
    ]  # fmt: skip
    return Table(header, rows)


def _triple(values, form: str) -> str:
    return " / ".join(form.format(v) for v in values)


def _efficiency(results: list[dict]) -> Table:
    header = ("noise in slip and sinkage", "points", "method", "RMS error / bound", "bias / bound",
              "coverage of 95 % [%]")  # fmt: skip
    rows = [
        ("yes" if r["noise_in_slip_and_sinkage"] else "no", r["points"], r["method"],
         _triple(r["rmse_over_bound"], "{:.2f}"), _triple(r["bias_over_bound"], "{:+.2f}"),
         _triple([100.0 * v for v in r["coverage_95"]], "{:.1f}"))
        for r in results
    ]  # fmt: skip
    return Table(header, rows)


def _identifiability(results: list[dict]) -> Table:
    header = ("soil", "channels", "unknowns", "condition", "phi [deg]", "ln K", "ln S", "n", "c [kPa]", "identifiable")
    rows = []
    for r in results:
        bound = r["bound"]
        cells = [f"{bound[k]:.2g}" if k in bound else "" for k in (*_UNKNOWNS, "n", "c_kPa")]
        told = "yes" if r["identifiable"] else "no"
        rows.append((r["soil"], r["data"], r["unknowns"], f"{r['condition']:.0f}", *cells, told))
    return Table(header, rows)


def _contenders(online: dict) -> Table:
    def error(record: dict | None) -> str:
        if record is None or record["value"] is None:
            return ""
        return f"{record['value']:.2f} [{record['low']:.2f}, {record['high']:.2f}]"

    rows, times, ratios = [], online["time"]["us_per_reading"], online["time"]["ratio_per_reading"]
    for name, e in online["contenders"].items():
        shares = [e["coverage"]["95"].get(k) for k in _UNKNOWNS]
        covered = " / ".join("-" if c is None or c["value"] is None else f"{100 * c['value']:.0f}" for c in shares)
        valid = e["valid_share"]["value"]
        rows.append((
            _CONTENDERS.get(name, name), *(error(e["rms"].get(k)) for k in _UNKNOWNS),
            "" if valid is None else f"{valid:.2f}", covered,
            f"{times[name]:.1f} (x{ratios[name]:.1f})" if name in times else "",
        ))  # fmt: skip
    header = ("identifier", "phi [deg]", "ln K", "ln S", "valid share", "95 % coverage phi / K / S [%]", "us a reading")
    return Table(header, rows)


def _speed(s: dict) -> Table:
    def times(value: dict, scale: float = 1.0, unit: str = "") -> str:
        median, low, high = (f"{scale * value[key]:.0f}" for key in ("median", "low", "high"))
        return f"{median}{unit} ({low}-{high})"

    rows = [
        (what, times(s[seconds], 1e6, " us"), times(s[ratio]) if ratio else "1")
        for what, seconds, ratio in (
            ("`solve`, called from Python", "compiled_solve_s", "ratio_compiled"),
            ("the same, and the search for a second soil", "checked_solve_s", "ratio_checked"),
            ("`newton_raphson` from Python, checks included", "newton_raphson_s", "ratio"),
            ("scipy", "scipy_s", ""),
        )
    ]
    return Table(("solve", "time", "times faster than scipy"), rows)


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
