"""What several benchmarks share: the machine, rounds of a measurement, pages with marked parts."""

from __future__ import annotations

import os
import platform
from collections.abc import Mapping
from importlib.metadata import version
from pathlib import Path

import numpy as np

from soil_env._io.document import renewed
from soil_env._io.files import make_folder, replace_file

ROOT = Path(__file__).resolve().parent.parent


def spread(values) -> dict[str, float]:
    """Median, lowest and highest of rounds."""
    return {"median": float(np.median(values)), "low": float(np.min(values)), "high": float(np.max(values))}


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


def check_page(page: Path, *names: str) -> None:
    """Before the work: ParameterError or OSError if these parts of a page could not be renewed."""
    make_folder(page.parent)
    renewed(page.read_text(encoding="utf-8"), dict.fromkeys(names, ""), page)


def renew_page(page: Path, parts: Mapping[str, str], out: Path | None = None) -> None:
    """Put text between the markers of a page; written to `out`, by default the page itself."""
    replace_file(out or page, renewed(page.read_text(encoding="utf-8"), parts, page))
