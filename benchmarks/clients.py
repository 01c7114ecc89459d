"""Smoke runs of soil_env with other packages: each client in an environment of its own, with pinned versions.

    python -m benchmarks.clients                        all clients; gigabytes and minutes; writes docs/clients.md
    python -m benchmarks.clients zoo minari             only these; the others keep what docs/clients.json has of them
    python -m benchmarks.clients sb3 --match PPO        of sb3 the commands with that in them
    python -m benchmarks.clients --envs DIR             where the environments are (default: .venv-clients)
    python -m benchmarks.clients --page                 docs/clients.md from docs/clients.json

An environment is made once and used again as long as its requirements stay the same. Exit status: 0 if every command
of every client did, 1 if one did not, 2 for bad input.
"""

from __future__ import annotations

import json
import os
import platform
import re
import shlex
import subprocess
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from benchmarks.common import ROOT
from soil_env._io.commands import command_line, command_parser, folder, leave
from soil_env._io.document import Table, render
from soil_env._io.files import make_folder, replace_file, write_json
from soil_env._io.loading import ParameterError, read_json, read_yaml, unknown_value
from soil_env.parameters import DEFAULT_SCENARIO

NAME = "benchmarks.clients"
SHOWN = ("gymnasium", "numpy", "torch")  # versions in the page, besides those pinned for the client
LIMIT = 3600  # [s] for one command


@dataclass(frozen=True)
class Client:
    """A package that uses the environment, and the commands that are run with it. In them {out} is a fresh folder."""

    words: str
    extras: str  # of soil_env
    pins: Sequence[str]
    commands: Sequence[str]
    torch: bool = True
    alone: Sequence[str] = ()  # pins installed without what they ask for, also of Python
    notes: str = ""


CLIENTS = {name: Client(**entry) for name, entry in read_yaml(ROOT / "benchmarks" / "clients.yaml").items()}


def torch_pin() -> str:
    """The torch of constraints.txt."""
    return re.search(r"^torch==\S+", (ROOT / "constraints.txt").read_text(encoding="utf-8"), re.M).group()


def environment(name: str, client: Client, envs: Path) -> Path:
    """The interpreter of a client's environment, made where it does not exist yet."""
    folder = envs / name
    python, mark = folder / "bin" / "python", folder / ".installed"
    wanted = [f"-e{ROOT}[{client.extras}]" if client.extras else f"-e{ROOT}", *client.pins, *client.alone]
    if mark.exists() and mark.read_text(encoding="utf-8") == json.dumps(wanted):
        return python
    print(f"{name}: installing into {folder}", flush=True)
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    pip = [str(python), "-m", "pip", "--disable-pip-version-check", "install", "-q"]
    if client.torch:  # first and alone, pinned: a range would take PyPI's newest, with gigabytes of CUDA
        subprocess.run([*pip, torch_pin()], check=True)
    subprocess.run([*pip, *wanted[: len(wanted) - len(client.alone)]], check=True)
    if client.alone:
        subprocess.run([*pip, "--no-deps", "--ignore-requires-python", *client.alone], check=True)
    mark.write_text(json.dumps(wanted), encoding="utf-8")
    return python


def versions(python: Path, client: Client) -> dict[str, str]:
    """{package: version} of the pinned packages and of `SHOWN` in an environment."""
    packages = [re.split(r"[\[=]", pin)[0] for pin in (*client.pins, *client.alone)]
    code = (
        "import json, sys; from importlib import metadata as m\n"
        "have = {d.metadata['Name'].lower().replace('_', '-'): d.version for d in m.distributions()}\n"
        "names = [n.lower().replace('_', '-') for n in sys.argv[1:]]\n"
        "print(json.dumps({n: have[n] for n in dict.fromkeys(names) if n in have}))"
    )
    done = subprocess.run([str(python), "-c", code, *packages, *SHOWN], capture_output=True, text=True, check=True)
    return {"python": platform.python_version()} | json.loads(done.stdout)


def smoke(name: str, client: Client, python: Path, match: str = "") -> list[dict]:
    """Run the commands of a client that have `match` in them, from the root of the clone, up to the first failure."""
    runs = []
    with tempfile.TemporaryDirectory() as out:
        given = {"SDL_VIDEODRIVER": "dummy", "MPLBACKEND": "Agg", "MINARI_DATASETS_PATH": out, "PYTHONPATH": str(ROOT)}
        for command in (c for c in client.commands if match in c):
            print(f"{name}: {command}", flush=True)
            words = shlex.split(command.replace("{out}", out))
            try:
                done = subprocess.run(
                    [str(python), *words[1:]], cwd=ROOT, env={**os.environ, **given}, timeout=LIMIT,
                    stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace",
                )  # fmt: skip
                ok, text = done.returncode == 0, done.stdout
            except subprocess.TimeoutExpired as error:
                ok, text = False, f"{error.stdout or ''}\nstopped after {LIMIT} s"
            runs.append({"command": command.replace("{out}", "OUT"), "ok": ok, "seen": told(text.replace(out, "OUT"))})
            print(f"{name}: {'ok' if ok else 'FAILED'}: {runs[-1]['seen']}", flush=True)
            if not ok:
                print(text[-3000:], file=sys.stderr)
                break
    return runs


TELLING = re.compile(
    r"^(Mean reward: |Eval num_timesteps|replayed: |return |\d+ courses,|\s*\d+: [\d,]+ steps|\w+\.\w+, [\d,]+ steps|"
    r"constant |\d+ passed)|, \d+ passed"
)
STUDY = re.compile(
    r"^Number of finished trials: +(\d+)\nBest trial:\nValue: +(\S+)\nParams: *\n((?: +\w+: .*\n)+)", re.M
)


def told(text: str) -> str:
    """The telling lines of what a command printed (if over four, the first and the last), or a study's best trial."""
    if study := STUDY.search(text):
        trials, value, params = study.groups()
        best = ", ".join(_rounded(line.strip().replace(":", "")) for line in params.splitlines())
        return f"{trials} trials; best return {_rounded(value)} with {best}"
    lines = [" ".join(line.split()) for line in text.splitlines() if TELLING.search(line)]
    lines = lines or [" ".join(line.split()) for line in text.splitlines() if line.strip()][-1:]
    lines = [lines[0], "...", lines[-1]] if len(lines) > 4 else lines
    return re.sub(r" in [\d.]+s( \(.*\))?", "", "; ".join(lines)).strip("= ")


def _rounded(text: str) -> str:
    """Decimal numbers in a text to three significant digits."""
    return re.sub(r"-?\d+\.\d+(e-?\d+)?", lambda found: f"{float(found.group()):.3g}", text)


def merged(client: Client, before: list[dict], now: list[dict]) -> list[dict]:
    """Outcomes in the order of the commands of a client: those of `now`, else those of `before`."""
    known = {run["command"]: run for run in (*before, *now)}
    return [known[command] for c in client.commands if (command := c.replace("{out}", "OUT")) in known]


# --- the command ------------------------------------------------------------------------------------------------------


def page(result: dict) -> str:
    """docs/clients.md; a command without an outcome has not been run since it was written."""
    tables = {}
    for name, found in result.items():
        runs = {run["command"]: run for run in found["runs"]}
        rows = []
        for command in (c.replace("{out}", "OUT") for c in CLIENTS[name].commands):
            run = runs.get(command, {"ok": True, "seen": "not run yet"})
            rows.append((f"`{command}`", ("" if run["ok"] else "**failed**: ") + run["seen"].replace("|", "/")))
        tables[name] = Table(("command", "seen"), rows).markdown()
    return render("benchmarks:clients.md", clients=CLIENTS, result=result, tables=tables, task=DEFAULT_SCENARIO)


@command_line(NAME)
def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    p = command_parser(f"python -m {NAME}", __doc__, status="")
    p.add_argument("clients", nargs="*", metavar="CLIENT", help=f"of {', '.join(CLIENTS)} (default: all)")
    p.add_argument("--envs", type=Path, default=ROOT / ".venv-clients", help="folder of the environments")
    p.add_argument("--match", default="", metavar="TEXT", help="only commands with TEXT in them")
    p.add_argument("--out", type=folder, default=ROOT / "docs", help="folder of clients.json and clients.md")
    p.add_argument("--page", action="store_true", help="no runs: the page from clients.json in --out")
    options = p.parse_args(arguments)
    for name in options.clients:
        if name not in CLIENTS:
            raise unknown_value(name, CLIENTS, "CLIENT")
    asked = [n for n in options.clients or CLIENTS if any(options.match in c for c in CLIENTS[n].commands)]
    if not asked:
        raise ParameterError(
            f"--match {options.match!r}: no command of {', '.join(options.clients or CLIENTS)} has that"
        )
    make_folder(options.out)
    file = options.out / "clients.json"
    result = read_json(file) if file.exists() else {}
    if options.page:
        replace_file(options.out / "clients.md", page(result))
        return 0
    for name in asked:
        try:
            python = environment(name, CLIENTS[name], options.envs.resolve())
            found = versions(python, CLIENTS[name])
        except subprocess.CalledProcessError as error:
            raise ParameterError(f"{error.cmd[0]} ended with {error.returncode}") from None
        before = result.get(name, {"runs": []})["runs"] if options.match else []
        runs = merged(CLIENTS[name], before, smoke(name, CLIENTS[name], python, options.match))
        result[name] = {"versions": found, "runs": runs, "task": DEFAULT_SCENARIO}
        write_json(file, result)
        replace_file(options.out / "clients.md", page(result))
    return 0 if all(run["ok"] for name in asked for run in result[name]["runs"]) else 1


if __name__ == "__main__":
    leave(main())
