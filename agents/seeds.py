"""Train the same agent with several seeds, here or on a Ray cluster, and evaluate them as one algorithm.

Examples:
  python -m agents.seeds --seeds 5 --out runs/identified
  python -m agents.seeds --seeds 5 --out runs/blind --observation blind --timesteps 5e6 --workers 2
  python -m agents.seeds --seeds 20 --first 5 --out runs/identified --engine ray --address 10.0.0.1:6379
  python -m agents.evaluate --controllers 'fixed_slip,ppo=runs/identified/seed_*' --out evaluation

Any key of train.py's config but seed, name and runs, on the command line or in --config. OUT/seed_N is a run folder as
train.py makes them (python train.py --resume OUT/seed_N compares that agent with the classical controllers). It appears
in one piece when seed N is trained; the same command again trains the seeds that are not there yet. A training whose
worker is killed starts again from its seed, so that every engine gives the same agents, bit for bit.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import shutil
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console

import agents
import soil_env
from agents import engines
from agents.cli import check_folder, config_file, overrides
from agents.config import TrainConfig
from agents.extras import needing_train
from agents.progress import Bar
from soil_env._io.commands import leave
from soil_env._io.loading import ParameterError, merge, read_yaml
from soil_env._io.signals import terminable
from soil_env.parameters import Scenario, load_scenario

NAME = "agents.seeds"
with needing_train(NAME):
    from agents import ppo, training

_SET_HERE = ("seed", "name", "runs")


def code_version() -> str:
    """Version of soil_env, with a hash of the code that an agent follows from."""
    here, there = (Path(package.__file__).parent for package in (soil_env, agents))
    return engines.fingerprint([*sorted(here.rglob("*.py")), *sorted(there.glob("*.py"))])


def folder_of(out: Path, seed: int) -> Path:
    """The run folder of a seed."""
    return Path(out) / f"seed_{seed}"


@dataclass(frozen=True)
class Training:
    """Trains an agent from a seed; can be sent to other processes and machines."""

    config: TrainConfig
    scenario: Scenario
    version: str

    def __call__(self, seed: int) -> dict[str, bytes]:
        """{path in the run folder: content} of the model and the TensorBoard log."""
        if self.version != code_version():
            raise ParameterError(f"a worker has soil_env {code_version()}, this machine {self.version}")
        quiet, training.console.quiet = training.console.quiet, True
        try:
            with tempfile.TemporaryDirectory() as folder:
                training.train(Path(folder), dataclasses.replace(self.config, seed=seed), self.scenario)
                files = [f for f in sorted(Path(folder).rglob("*")) if f.is_file()]
                return {f.relative_to(folder).as_posix(): f.read_bytes() for f in files}
        finally:
            training.console.quiet = quiet


def keep(out: Path, config: TrainConfig, scenario: Scenario, seed: int, files: dict[str, bytes]) -> None:
    """Write the run folder of a seed, in one piece."""
    folder = folder_of(out, seed)
    config = dataclasses.replace(config, seed=seed, name=folder.name, runs=str(out))
    partial = folder.with_name(f".{folder.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    for name, content in files.items():
        (partial / name).parent.mkdir(parents=True, exist_ok=True)
        (partial / name).write_bytes(content)
    training.write_task(partial, config, scenario)
    os.replace(partial, folder)


def missing(out: Path, config: TrainConfig, scenario: Scenario, seeds: range) -> list[int]:
    """Seeds that are not trained in `out` yet; ParameterError if one was trained with another config."""
    left = []
    for seed in seeds:
        folder = folder_of(out, seed)
        if not folder.exists():
            left.append(seed)
            continue
        theirs, on = training.open_run(folder)
        same = {"seed": seed, "name": folder.name, "runs": theirs.runs}
        if on != scenario or theirs != dataclasses.replace(config, **same):
            raise ParameterError(f"{folder}: was trained with another config; expected another --out")
    return left


def train(out: Path, config: TrainConfig, scenario: Scenario, seeds: range, engine: engines.Engine, console) -> None:
    """Train the seeds that `out` does not have yet."""
    left = missing(out, config, scenario, seeds)
    out.mkdir(parents=True, exist_ok=True)
    work = Training(config, scenario, code_version())
    with Bar("Training", len(seeds), "seeds", len(seeds) - len(left), console) as bar:
        for seed, files in engine(work, left):
            keep(out, config, scenario, seed, files)
            bar.update(advance=1, note=f"{folder_of(out, seed)}")


def parser() -> argparse.ArgumentParser:
    """Options of the command."""
    p = argparse.ArgumentParser(
        f"python -m {NAME}",
        description=__doc__,
        formatter_class=argparse.RawDescriptionHelpFormatter,
        allow_abbrev=False,
        epilog="python train.py --help lists the config keys.\nExit status: 0 done, 2 bad input, 130 interrupted.",
    )
    p.add_argument("--seeds", metavar="N", type=int, default=5, help="how many (default: 5)")
    p.add_argument("--first", metavar="SEED", type=int, default=0, help="the first of them (default: 0)")
    p.add_argument("--out", metavar="OUT", type=Path, required=True, help="folder of the run folders")
    p.add_argument("--config", metavar="YAML", help="file of config keys; the command line goes over it")
    engines.add_options(p, "one training after the other in this one")
    return p


@terminable
def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit status."""
    options, rest = parser().parse_known_args(arguments)
    console = Console()
    try:
        if options.seeds < 1 or options.first < 0:
            raise ParameterError("--seeds, --first: expected at least one seed, and none below 0")
        check_folder(options.out)
        engine = engines.choose(options.engine, options.workers, options.address)
        changes = overrides(rest)
        given = [key for key in _SET_HERE if key in changes]
        if given:
            raise ParameterError(f"--{given[0]}: is set for every seed; expected --seeds, --first and --out")
        mapping = {} if options.config is None else read_yaml(config_file(options.config))
        config = ppo.load_config(merge(mapping, changes), options.config or "command line")
        scenario = load_scenario(config.scenario, config.changes)
        training.check(config, scenario)
        train(options.out, config, scenario, range(options.first, options.first + options.seeds), engine, console)
    except ParameterError as error:
        return _refuse(str(error))
    except OSError as error:
        return _refuse(f"{error.filename or options.out}: {error.strerror or error}")
    except KeyboardInterrupt:
        print(f"\n{NAME}: interrupted; the same command goes on with the seeds that are left", file=sys.stderr)
        return 130
    trained = f"{ppo.NAMES[config.observation]}={options.out}/seed_*"
    command = f"python -m agents.evaluate --controllers 'fixed_slip,{trained}' --out {options.out}/evaluation"
    console.print(f"Compare them: {command}", soft_wrap=True, highlight=False, markup=False)
    return 0


def _refuse(message: str) -> int:
    print(f"{NAME}: {' '.join(message.split())}", file=sys.stderr)
    return 2


if __name__ == "__main__":
    leave(main())
