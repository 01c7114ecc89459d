"""Smoke runs of soil_env in the code of others: each client in an environment of its own, with pinned versions.

    python -m benchmarks.clients                        all clients; gigabytes and minutes; writes docs/clients.md
    python -m benchmarks.clients zoo minari             only these; the others keep what docs/clients.json has of them
    python -m benchmarks.clients --envs DIR             where the environments are (default: .venv-clients)
    python -m benchmarks.clients --page                 docs/clients.md from docs/clients.json

An environment is made once and used again as long as its requirements stay the same. Exit status: 0 if every command
of every client did, 1 if one did not, 2 for bad input.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import re
import shlex
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from soil_env._io.commands import leave
from soil_env._io.files import make_folder, replace_file
from soil_env._io.loading import ParameterError, unknown_key
from soil_env._io.signals import terminable

NAME = "benchmarks.clients"
ROOT = Path(__file__).resolve().parent.parent
SHOWN = ("gymnasium", "numpy", "torch")  # versions in the page, besides those pinned for the client
LIMIT = 3600  # [s] for one command


@dataclass(frozen=True)
class Client:
    """Somebody else's code, and what is run of it. In commands {out} is a fresh folder."""

    words: str
    extras: str  # of soil_env
    pins: tuple[str, ...]
    commands: tuple[str, ...]
    torch: bool = True
    notes: str = ""


_TASK = "--algo ppo --env SoilWheel-v0 --gym-packages soil_env"
_TRAIN = f"python -m rl_zoo3.train {_TASK}"
_FILE = "-conf configs/rl_zoo3/ppo.yml --num-threads 1 -f {out}"
_STUDY = "--storage sqlite:///{out}/study.db --study-name soil_wheel"
_SEARCH = (
    f"{_TRAIN} agents.zoo_space {_FILE} -n 300000 -optimize --n-startup-trials 3 --n-evaluations 1 "
    f"--eval-episodes 40 --n-eval-envs 40 --no-optim-plots {_STUDY}"
)
CLIENTS = {
    "zoo": Client(
        "rl-baselines3-zoo: training, evaluation, hyperparameter search with Optuna",
        "zoo",
        (
            "rl_zoo3==2.9.2",
            "sb3_contrib==2.9.2",
            "stable-baselines3==2.9.2",
            "gymnasium==1.4.0",
            "optuna==5.0.0",
            "pandas==2.3.3",
            "pytest==9.2.0",
        ),
        (
            f"{_TRAIN} {_FILE} -n 2000000 --eval-freq 500000 --eval-episodes 100 --n-eval-envs 20 --seed 1",
            f"python -m rl_zoo3.enjoy {_TASK} --no-render -n 20000 -f {{out}}",
            f"{_SEARCH} --n-trials 4 --seed 1",
            f"{_SEARCH} --n-trials 2 --seed 2",
            f"{_TRAIN} agents.zoo_space {_FILE}/trial -n 500000 --eval-freq 250000 --eval-episodes 100 "
            f"--n-eval-envs 20 --seed 1 {_STUDY} --trial-id 1",
            "python -m pytest -q tests/agents/test_zoo.py",
        ),
        notes="""
The hyperparameters are those of `train.py`, and so are the 20 million steps without `-n`. The study of the search is
kept in the SQLite file: the same command goes on with it (with another `--seed`; with the same one the first trials are
drawn once more), several processes can share it, and `--trial-id` trains with what a trial had. Trials are drawn from
the space of `agents/zoo_space.py`; rl_zoo3's own does not fit this many wheels. Six trials are a search in form only;
in earnest it is the same command with, say, `-n 5000000 --n-trials 100 --n-evaluations 5`.
""",
    ),
    "rllib": Client(
        "Ray RLlib on the vector entry point; the CleanRL-style file with the gymnasium that RLlib pins",
        "rllib",
        ("ray[rllib]==2.60.0", "gymnasium==1.2.2"),
        (
            "python examples/rllib_ppo.py",
            "python examples/cleanrl_ppo.py --out {out}/curve.png",
        ),
    ),
    "minari": Client(
        "Minari: a data set recorded and replayed",
        "minari",
        ("minari[create,hdf5]==0.5.4", "gymnasium==1.4.0"),
        ("python examples/minari_dataset.py --episodes 3",),
        torch=False,
    ),
    "ray": Client(
        "Ray Core: evaluation, blind cases and training seeds on a cluster of two nodes, a worker killed in each",
        "ray,train,test",
        ("ray==2.60.0", "stable-baselines3==2.9.2", "gymnasium==1.4.0"),
        tuple(
            f"python -m pytest -q tests/test_{name}.py -k 'ray or node'"
            for name in ("engines", "seeds", "benchmark_blind")
        ),
    ),
}


def torch_pin() -> str:
    """The torch of constraints.txt."""
    return re.search(r"^torch==\S+", (ROOT / "constraints.txt").read_text(encoding="utf-8"), re.M).group()


def environment(name: str, client: Client, envs: Path) -> Path:
    """The interpreter of a client's environment, made where it does not exist yet."""
    folder = envs / name
    python, mark = folder / "bin" / "python", folder / ".installed"
    wanted = [f"-e{ROOT}[{client.extras}]", *client.pins]
    if mark.exists() and mark.read_text(encoding="utf-8") == json.dumps(wanted):
        return python
    print(f"{name}: installing into {folder}", flush=True)
    subprocess.run([sys.executable, "-m", "venv", str(folder)], check=True)
    pip = [str(python), "-m", "pip", "--disable-pip-version-check", "install", "-q"]
    if client.torch:  # first and alone, pinned: a range would take PyPI's newest, with gigabytes of CUDA
        subprocess.run([*pip, torch_pin()], check=True)
    subprocess.run([*pip, *wanted], check=True)
    mark.write_text(json.dumps(wanted), encoding="utf-8")
    return python


def versions(python: Path, client: Client) -> dict[str, str]:
    """{package: version} of what counts in an environment."""
    packages = [re.split(r"[\[=]", pin)[0] for pin in client.pins]
    code = (
        "import json, sys; from importlib import metadata as m\n"
        "have = {d.metadata['Name'].lower().replace('_', '-'): d.version for d in m.distributions()}\n"
        "names = [n.lower().replace('_', '-') for n in sys.argv[1:]]\n"
        "print(json.dumps({n: have[n] for n in dict.fromkeys(names) if n in have}))"
    )
    done = subprocess.run([str(python), "-c", code, *packages, *SHOWN], capture_output=True, text=True, check=True)
    return {"python": platform.python_version()} | json.loads(done.stdout)


def smoke(name: str, client: Client, python: Path) -> list[dict]:
    """Run the commands of a client from the root of the clone; what each ended with. The first failure ends it."""
    runs = []
    with tempfile.TemporaryDirectory() as out:
        given = {"SDL_VIDEODRIVER": "dummy", "MPLBACKEND": "Agg", "MINARI_DATASETS_PATH": out, "PYTHONPATH": str(ROOT)}
        for command in client.commands:
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
    r"^(Mean reward: |Eval num_timesteps|replayed: |return |\d+ courses,|\s*\d+: [\d,]+ steps|\d+ passed)|, \d+ passed"
)
STUDY = re.compile(
    r"^Number of finished trials: +(\d+)\nBest trial:\nValue: +(\S+)\nParams: *\n((?: +\w+: .*\n)+)", re.M
)


def told(text: str) -> str:
    """The first and the last telling line of what a command printed, or the best trial of a study."""
    if study := STUDY.search(text):
        trials, value, params = study.groups()
        best = ", ".join(_rounded(line.strip().replace(":", "")) for line in params.splitlines())
        return f"{trials} trials; best return {_rounded(value)} with {best}"
    lines = [" ".join(line.split()) for line in text.splitlines() if TELLING.search(line)]
    lines = lines or [" ".join(line.split()) for line in text.splitlines() if line.strip()][-1:]
    lines = [lines[0], "...", lines[-1]] if len(lines) > 2 else lines
    return re.sub(r" in [\d.]+s( \(.*\))?", "", "; ".join(lines)).strip("= ")


def _rounded(text: str) -> str:
    """Decimal numbers in a text to three significant digits."""
    return re.sub(r"-?\d+\.\d+(e-?\d+)?", lambda found: f"{float(found.group()):.3g}", text)


# --- the page ---------------------------------------------------------------------------------------------------------


def page(result: dict) -> str:
    """docs/clients.md."""
    lines = [
        "# soil_env in the code of others",
        "",
        f"Smoke runs with the real clients: `python -m {NAME}` makes an environment for each and runs the commands",
        "below from the root of the repository. They are short: they show that the pieces fit and that agents",
        "learn, not how much can be learnt. Figures are in [clients.json](clients.json).",
    ]
    for name, client in CLIENTS.items():
        found = result.get(name)
        lines += ["", f"## {name}", "", f'{client.words}. `pip install "soil_env[{client.extras}]"`.', ""]
        lines += [client.notes.strip(), ""] if client.notes else []
        if found is None:
            lines += ["Not run yet."]
            continue
        lines += ["Versions: " + ", ".join(f"{k} {v}" for k, v in found["versions"].items()) + ".", ""]
        lines += ["| command | seen |", "|---|---|"]
        for run in found["runs"]:
            seen = ("" if run["ok"] else "**failed**: ") + run["seen"].replace("|", "/")
            lines += [f"| `{run['command']}` | {seen} |"]
    return "\n".join(lines) + "\n"


@terminable
def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    p = argparse.ArgumentParser(
        f"python -m {NAME}", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    p.add_argument("clients", nargs="*", metavar="CLIENT", help=f"of {', '.join(CLIENTS)} (default: all)")
    p.add_argument("--envs", type=Path, default=ROOT / ".venv-clients", help="folder of the environments")
    p.add_argument("--out", type=Path, default=ROOT / "docs", help="folder of clients.json and clients.md")
    p.add_argument("--page", action="store_true", help="no runs: the page from clients.json in --out")
    options = p.parse_args(arguments)
    file = options.out / "clients.json"
    try:
        for name in options.clients:
            if name not in CLIENTS:
                raise unknown_key(name, CLIENTS, "CLIENT")
        make_folder(options.out)
        result = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
        for name in [] if options.page else options.clients or CLIENTS:
            python = environment(name, CLIENTS[name], options.envs.resolve())
            found = versions(python, CLIENTS[name])
            result[name] = {"versions": found, "runs": smoke(name, CLIENTS[name], python)}
            replace_file(file, json.dumps(result, indent=1) + "\n")
            replace_file(options.out / "clients.md", page(result))
        if options.page:
            replace_file(options.out / "clients.md", page(result))
    except ParameterError as error:
        print(f"{NAME}: {error}", file=sys.stderr)
        return 2
    except OSError as error:
        print(f"{NAME}: {error.filename or options.out}: {error.strerror}", file=sys.stderr)
        return 2
    except subprocess.CalledProcessError as error:
        print(f"{NAME}: {error.cmd[0]} ended with {error.returncode}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"\n{NAME}: interrupted", file=sys.stderr)
        return 130
    asked = options.clients or CLIENTS
    return 0 if options.page or all(run["ok"] for name in asked for run in result[name]["runs"]) else 1


if __name__ == "__main__":
    leave(main())
