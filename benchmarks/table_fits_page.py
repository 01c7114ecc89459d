"""docs/table_fits.md and its plot from the result of benchmarks/table_fits.py; the text is its template."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt

from soil_env._io.document import Table, render, wrapped
from soil_env._io.files import replace_file, save_figure

_NAMES = ("phi", "K", "S")
_UNKNOWNS = ("phi_deg", "ln_K", "ln_S")


def write(result: dict, folder: Path) -> None:
    """Write table_fits.md and its plot into `folder`."""
    plots = folder / "table_fits"
    plots.mkdir(exist_ok=True)
    efficiency_figure(result["efficiency"], plots / "efficiency.png")
    replace_file(folder / "table_fits.md", markdown(result))


def markdown(result: dict) -> str:
    """The page."""
    runs = result["convergence"].values()
    text = render(
        "benchmarks:table_fits.md",
        made=_made(result["made"]),
        solved=min(t["recovered"] / t["identifiable"] for t in runs),
        wrong=sum(t["silently_wrong"] for t in runs),
        convergence=_convergence(result["convergence"]),
        efficiency=_efficiency(result["efficiency"]),
        identifiability=_identifiability(result["identifiability"]),
        coverage=_coverage(result["coverage"]),
        draws=result["coverage"]["draws"],
    )
    return wrapped(text)


def _made(made: dict) -> list[str]:
    """Lines that say which parts come from which command."""
    by_command: dict = {}
    for part, how in made.items():
        by_command.setdefault((how["command"], how["seed"], how["machine"]), []).append(part)
    return [f"{', '.join(parts)}: `{c}`, seed {seed} ({on})" for (c, seed, on), parts in by_command.items()]


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


def _coverage(result: dict) -> Table:
    """Shares of intervals that hold the truth."""
    rows = [
        (*row["case"], *(f"{v:.0%}".replace("%", " %") for v in (*row["shares"].values(), row["unsettled"])))
        for row in result["rows"]
    ]
    header = ("slips", "loads", "measured", "noise", "$\\varphi$", "$K$", "$S$", "not settled")
    return Table(header, rows)


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
