"""Shared by the benchmarks: rounds of a measurement, the machine, options, results as JSON with a
page of tables.
"""

import json
import math
import os
import platform
from collections.abc import Callable, Iterable, Mapping
from contextlib import suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any

import click
import numpy as np
from scipy.stats import binomtest, t

from soil_env._io.document import Table
from soil_env._io.files import check_outputs, make_folder, plain, replace_files
from soil_env._io.loading import ParameterError, one_line
from soil_env.cli.running import PATH, WholeNumber
from soil_env.measurement.setup import Setup, read_setup
from soil_env.measurement.table import Table as MeasuredTable, read_table

RESULTS = Path(__file__).resolve().parent.parent / "docs" / "results"


def read_json(path: Path) -> dict:
    """The object in a JSON file; `ParameterError` if it cannot be read as one."""
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise ParameterError(f"{path}: cannot be read ({error.strerror})") from None
    except (ValueError, RecursionError) as error:  # no UTF-8 either
        raise ParameterError(f"{path}: not valid JSON ({one_line(error)})") from None
    if not isinstance(content, dict):
        raise ParameterError(f"{path}: expected an object at the top, got {type(content).__name__}")
    return content


def read_rig(folder: Path, name: str) -> tuple[MeasuredTable, Setup]:
    """The measurement table NAME.csv of a folder and its NAME.setup.yaml."""
    setup = read_setup(folder / f"{name}.setup.yaml")
    return read_table(folder / f"{name}.csv", setup.wheel), setup


def spread(values) -> dict[str, float]:
    """{median, low, high} of the values [n] of rounds; low and high are the least and largest."""
    return {
        "median": float(np.median(values)),
        "low": float(np.min(values)),
        "high": float(np.max(values)),
    }


def share(values: Iterable[bool]) -> dict | None:
    """{count, of, value, low, high}: how many of how many are true, the share of them, and its
    95 % interval of Wilson (1927); None without values.
    """
    values = [bool(v) for v in values]
    if not values:
        return None
    interval = binomtest(sum(values), len(values)).proportion_ci(method="wilson")
    value = sum(values) / len(values)
    return {
        "count": sum(values),
        "of": len(values),
        "value": value,
        "low": interval.low,
        "high": interval.high,
    }


def half_interval(values: np.ndarray) -> float:
    """Half of the 95 % interval of the mean of `values` [n], at least two, by Student's t."""
    return float(t.ppf(0.975, len(values) - 1) * values.std(ddof=1) / math.sqrt(len(values)))


def machine() -> dict[str, Any]:
    """What figures are measured with: {processor, cores, load, python, numpy, numba}.

    `cores` are those that this process may use, where the system tells. `load` is the average over
    the last minute, None where the system does not tell. The others are names and versions.
    """
    name = platform.processor() or platform.machine()
    with suppress(OSError, StopIteration):
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
        name = next(
            line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")
        )
    return {
        "processor": name,
        "cores": len(os.sched_getaffinity(0))
        if hasattr(os, "sched_getaffinity")
        else os.cpu_count(),
        "load": os.getloadavg()[0] if hasattr(os, "getloadavg") else None,
        "python": platform.python_version(),
    } | {name: version(name) for name in ("numpy", "numba")}


def machine_text(machine: dict[str, Any]) -> str:
    """One line of text on what `machine` returned."""
    load = "" if machine["load"] is None else f", load average {machine['load']:.1f} at the start"
    versions = f"Python {machine['python']}, numpy {machine['numpy']}, numba {machine['numba']}"
    return f"{machine['processor']}, {machine['cores']} cores{load}; {versions}"


def study_options(name: str) -> Callable[[Callable], Callable]:
    """Decorator that gives a command the options --smoke, a flag, and --out, a path, of the study
    of this name. With --smoke another folder than that of the results has to be given.
    """

    def elsewhere(context: click.Context, _: click.Parameter, out: Path) -> Path:
        """The folder; ParameterError for that of the results with --smoke."""
        if context.params["smoke"] and out.resolve() == RESULTS:
            raise ParameterError("--smoke: numbers mean nothing: expected --out, another folder")
        return out

    text = f"Folder of {name}.json and {name}.md (default docs/results)."
    out = click.option(
        "--out", type=PATH, metavar="OUT", default=RESULTS, callback=elsewhere, help=text
    )
    smoke = click.option(
        "--smoke",
        is_flag=True,
        is_eager=True,
        help="Run every part in seconds; numbers mean nothing.",
    )
    return lambda command: smoke(out(command))


workers_option = click.option(
    "--workers", type=WholeNumber(1), default=2, show_default=True, help="Processes."
)


def name_of(study: str, smoke: bool) -> str:
    """Name of the result files of a study that resumes from them: STUDY, with --smoke STUDY_smoke.

    So no real run goes on with numbers of --smoke, which mean nothing.
    """
    return f"{study}_smoke" if smoke else study


def ready(out: Path, name: str) -> Path:
    """Make the folder of the results and return the path of NAME.json in it, which is not written.

    Raises OSError, before the work, where the folder cannot be made or NAME.json and NAME.md could
    not be written into it.
    """
    check_outputs(out, (f"{name}.json", f"{name}.md"))
    make_folder(out)
    return out / f"{name}.json"


def write(out: Path, name: str, title: str, text: str, tables: Mapping[str, Table]) -> None:
    """Write NAME.md into the folder `out`: a title, the paragraph `text`, and the tables under
    their headings, which are the keys.

    Print the page, and the paths of NAME.md and NAME.json. The latter is written by the caller.
    """
    parts = [f"## {heading}\n\n{table.markdown()}" for heading, table in tables.items()]
    page = "\n\n".join([f"# {title}", text, *parts]) + "\n"
    replace_files(out, {f"{name}.md": page})
    print(f"{page}\nWritten: {out / name}.json and .md", flush=True)


def short(result: Any, digits: int = 5) -> Any:
    """A result as plain values (`plain`), each float rounded to so many significant `digits`."""
    result = plain(result)
    if isinstance(result, dict):
        return {key: short(value, digits) for key, value in result.items()}
    if isinstance(result, list):
        return [short(value, digits) for value in result]
    return float(f"{result:.{digits}g}") if isinstance(result, float) else result
