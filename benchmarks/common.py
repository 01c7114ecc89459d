"""What several benchmarks share: the machine, rounds of a measurement, intervals, options, pages with marked parts."""

from __future__ import annotations

import argparse
import os
import platform
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

import numpy as np

from soil_env._io.commands import command_parser, folder
from soil_env._io.document import renewed
from soil_env._io.files import make_folder, replace_file

ROOT = Path(__file__).resolve().parent.parent
#: Changes of a scenario for drives by torque, one action a control period.
TORQUE = {"control": {"action": "torque"}}


def spread(values) -> dict[str, float]:
    """Median, lowest and highest of rounds."""
    return {"median": float(np.median(values)), "low": float(np.min(values)), "high": float(np.max(values))}


def ratio_of_sums(top: np.ndarray, bottom: np.ndarray, picks: np.ndarray, root: bool = False) -> dict:
    """Value and 95 % bootstrap interval over courses of sum(top)/sum(bottom), per column of [courses, ...].

    Of its square root with `root`; `picks` [draws, courses] are the courses of each draw.
    """

    def value(t, b):
        with np.errstate(invalid="ignore", divide="ignore"):
            q = t / b
        return np.sqrt(q) if root else q

    counts = np.stack([np.bincount(p, minlength=len(top)) for p in picks]).astype(float)  # [draws, courses]
    drawn = value(np.tensordot(counts, top, 1), np.tensordot(counts, bottom, 1))
    low, high = np.percentile(drawn, [2.5, 97.5], axis=0)
    whole = value(top.sum(0), bottom.sum(0))
    return {"value": np.asarray(whole).tolist(), "low": np.asarray(low).tolist(), "high": np.asarray(high).tolist()}


def range_text(value: dict, digits: int = 2, scale: float = 1.0) -> str:
    """A `spread` as text: the median with the lowest and the highest round."""
    median, low, high = (f"{value[k] * scale:,.{digits}f}" for k in ("median", "low", "high"))
    return f"{median} ({low}-{high})"


def machine() -> dict:
    """What the figures were measured on."""
    name = platform.processor() or platform.machine()
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        name = next(line.split(":", 1)[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        pass
    return {
        "processor": name,
        "cores": len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "python": platform.python_version(),
    } | {name: version(name) for name in ("numpy", "numba", "llvmlite")}


def machine_text(machine: dict, *packages: str, also: str = "") -> str:
    """`machine` as text, with the versions of `packages`."""
    load = "" if machine["load"] is None else f", load average {machine['load']:.1f} at the start"
    versions = "".join(f", {name} {machine[name]}" for name in packages)
    return f"{machine['processor']}, {machine['cores']} cores{also}{load}; Python {machine['python']}{versions}"


def study_parser(name: str, description: str, files: str, out: Path | None = ROOT / "docs") -> argparse.ArgumentParser:
    """Parser with --smoke, and --out for the folder of `files`, which are not written where `out` is None and none is
    given."""
    p = command_parser(name, description)
    p.add_argument("--smoke", action="store_true", help="every part in seconds, numbers without meaning")
    p.add_argument(
        "--out", metavar="OUT", type=folder, default=out,
        help=f"folder of {files} (default: {out or 'none, only printed'})",
    )  # fmt: skip
    return p


def check_page(page: Path, *names: str) -> None:
    """Before the work: ParameterError or OSError if these parts of a page could not be renewed."""
    make_folder(page.parent)
    renewed(page.read_text(encoding="utf-8"), dict.fromkeys(names, ""), page)


def renew_page(page: Path, parts: Mapping[str, str], out: Path | None = None) -> None:
    """Put text between the markers of a page; written to `out`, by default the page itself."""
    replace_file(out or page, renewed(page.read_text(encoding="utf-8"), parts, page))
