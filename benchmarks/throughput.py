"""Speed of the environments, alone or beside another checkout, in one run.

    python -m benchmarks.throughput                  minutes; writes docs/results/throughput.*
    python -m benchmarks.throughput --against DIR    the same in turns with the checkout DIR
    python -m benchmarks.throughput --smoke --out X  every part in seconds, numbers without meaning

Random commands are held for eight steps; resets are included. Each figure is a median over rounds
with the lowest and the highest; beside another checkout, of the ratios of the rounds. DIR needs a
virtual environment in DIR/.venv. Run it on an idle machine.

`first start` is the wall time of a process that imports, makes, resets and steps one environment,
with compiled code on the disk ("kept") or without.
"""

import json
import os
import subprocess
import sys
import tempfile
import time
from contextlib import suppress
from pathlib import Path
from typing import Any

import click

from benchmarks.common import machine, machine_text, ready, spread, study_options, write
from benchmarks.stepping import ENVIRONMENTS
from soil_env._io.document import Table
from soil_env._io.files import write_json
from soil_env._io.loading import ParameterError
from soil_env.cli.running import PATH, leave, run

NAME = "throughput"
ROOT = Path(__file__).resolve().parent.parent
WORKER = ROOT / "benchmarks" / "stepping.py"
#: Programs whose first start is measured.
FIRST = {
    "blind": 'import gymnasium; env = gymnasium.make("soil_env:SoilWheel-v0", observation="blind", '
    'belief={"method": "none"}); env.reset(seed=1); env.step([0.3])',
    "identified": 'import gymnasium; env = gymnasium.make("soil_env:SoilWheel-v0"); '
    "env.reset(seed=1); env.step([0.3])",
}


class Checkout:
    """Worker (`benchmarks.stepping` of this checkout) in the interpreter of the checkout `root`.

    Raises `ParameterError` where another checkout has no interpreter in its .venv.
    """

    def __init__(self, root: Path) -> None:
        own = root == ROOT
        python = Path(sys.executable) if own else root / ".venv" / "bin" / "python"
        if not python.exists():
            raise ParameterError(f"--against {root}: expected a checkout with {python}")
        self.python = str(python)
        # the package of `root`, whatever its interpreter has installed
        self.environment = os.environ | {"PYTHONPATH": str(root)}
        self.root = root

    def start(self, size: int, threads: int, seconds: float) -> None:
        """Start the worker and wait until all of it is compiled; ParameterError where it has ended
        before.

        `size`: environments in a vector environment; `seconds` of a measurement of each.
        """
        numbers = (str(size), str(threads), str(seconds))
        self.worker = subprocess.Popen(
            [self.python, str(WORKER), *numbers, *ENVIRONMENTS],
            cwd=self.root,
            env=self.environment,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
        )
        self._answer()

    def _answer(self) -> str:
        """The next line of the worker; ParameterError where it has ended."""
        assert self.worker.stdout is not None
        line = self.worker.stdout.readline().strip()
        if not line:
            raise ParameterError(f"the worker in {self.root} has ended: expected its rates")
        return line

    def rates(self) -> list[float]:
        """Measure once: steps a second of each of `ENVIRONMENTS`, in their order."""
        assert self.worker.stdin is not None
        with suppress(BrokenPipeError):  # it has ended, which `_answer` says
            self.worker.stdin.write("\n")
            self.worker.stdin.flush()
        found: list[float] = json.loads(self._answer())
        return found

    def first(self, program: str, cache: str) -> float:
        """Wall time [s] of a process that runs `program`, Python source, with compiled code in the
        folder `cache`; CalledProcessError where it fails.
        """
        start = time.perf_counter()
        environment = self.environment | {"NUMBA_CACHE_DIR": cache}
        command = [self.python, "-c", program]
        subprocess.run(
            command, cwd=self.root, env=environment, check=True, stderr=subprocess.DEVNULL
        )
        return time.perf_counter() - start

    def firsts(self) -> dict[str, float]:
        """Wall times [s] of the programs `FIRST` by name, from an empty folder of compiled code,
        and again with what the first start has kept there, "NAME, kept".
        """
        found = {}
        for name, program in FIRST.items():
            with tempfile.TemporaryDirectory() as cache:
                found[name] = self.first(program, cache)
                found[f"{name}, kept"] = self.first(program, cache)
        return found


def compared(rounds: list[dict[str, list[float]]]) -> dict[str, Any]:
    """{environment: {checkout: spread of its steps a second}}, with the "ratio" of the first to the
    second if two were measured.

    `rounds`: {checkout: rates of `ENVIRONMENTS`} of each round.
    """
    sides = list(rounds[0])
    out: dict[str, Any] = {}
    for i, name in enumerate(ENVIRONMENTS):
        out[name] = {side: spread([r[side][i] for r in rounds]) for side in sides}
        if len(sides) == 2:
            out[name]["ratio"] = spread([r[sides[0]][i] / r[sides[1]][i] for r in rounds])
    return out


@click.command(NAME)
@click.option("--against", type=PATH, metavar="DIR", help="Other checkout, measured in turns.")
@study_options(NAME)
def command(smoke: bool, out: Path, against: Path | None) -> None:
    """Measure steps per second in one run."""
    file = ready(out, NAME)
    about = machine()
    # Seconds of a measurement, rounds that count, size of the vector environments.
    seconds, rounds, size = (0.02, 2, 32) if smoke else (1.0, 9, 1024)
    sides = {"here": Checkout(ROOT)}
    if against is not None:
        sides["against"] = Checkout(against.resolve())
    firsts = {} if smoke else {name: side.firsts() for name, side in sides.items()}
    for side in sides.values():
        side.start(size, min(2, about["cores"]), seconds)
    # The first round warms up and does not count.
    found = [{name: side.rates() for name, side in sides.items()} for _ in range(rounds + 1)][1:]
    results = compared(found)
    content = {"machine": about, "size": size, "rates": results, "first_starts": firsts}
    write_json(file, content)
    text = (
        f"{size} environments in a vector environment, by `python -m benchmarks.{NAME}` on "
        f"{machine_text(about)}."
    )
    tables = {"Speed": _speeds(results)}
    if firsts:
        heads = ("first start", *(f"{name} [s]" for name in sides))
        rows = [(name, *(f"{firsts[side][name]:.1f}" for side in sides)) for name in firsts["here"]]
        tables["First start"] = Table(heads, rows)
    write(out, NAME, "Speed", text, tables)


def _speeds(results: dict[str, Any]) -> Table:
    """Table of the page, of what `compared` gives."""
    two = "ratio" in next(iter(results.values()))
    heads = ("environment", "1000 steps/s", "lowest", "highest")
    heads += ("ratio to the other", "lowest ratio", "highest ratio") if two else ()
    rows = []
    for name, result in results.items():
        row = [name, *(f"{1e-3 * result['here'][k]:,.0f}" for k in ("median", "low", "high"))]
        if two:
            row += [f"{result['ratio'][k]:.2f}" for k in ("median", "low", "high")]
        rows.append(tuple(row))
    return Table(heads, rows)


if __name__ == "__main__":
    leave(run(command, None, f"benchmarks.{NAME}"))
