"""Train the same agent with several seeds, here or on a Ray cluster, and evaluate them as one algorithm.

Examples:
  python -m agents.seeds --seeds 5 --out runs/identified
  python -m agents.seeds --seeds 5 --out runs/blind --observation blind --timesteps 5e6 --workers 2
  python -m agents.seeds --seeds 20 --first 5 --out runs/identified --engine ray --address 10.0.0.1:6379
  python -m agents.evaluate --controllers 'soft_start,ppo=runs/identified/seed_*' --out evaluation

Any key of train.py's config but seed, name and runs, on the command line or in --config. OUT/seed_N is a run folder as
train.py makes them (python train.py --resume OUT/seed_N compares that agent with the classical controllers). It appears
when seed N is trained; the same command again trains the seeds that are not there yet. A training whose
worker is killed starts again from its seed, so that every engine gives the same agents, bit for bit.
"""

from __future__ import annotations

import argparse
import dataclasses
import os
import shutil
import tempfile
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

import soil_env
from soil_env._io.commands import command_line, file_path, folder, leave, whole_number
from soil_env._io.files import make_folder
from soil_env._io.loading import ParameterError, merge
from soil_env.parameters import Scenario

from . import studies
from .cli import config_mapping, manual_parser, overrides
from .config import NAMES, TrainConfig, load_config
from .extras import needing
from .progress import Bar, console, show

NAME = f"{__package__}.seeds"
_SET_HERE = ("seed", "name", "runs")


def code_version() -> str:
    """Version of soil_env, with a hash of the code that an agent follows from."""
    here, there = Path(soil_env.__file__).parent, Path(__file__).parent
    return studies.fingerprint([*sorted(here.rglob("*.py")), *sorted(there.glob("*.py"))])


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
        from . import training  # needs the extra `train`, which --help does not

        quiet, console.quiet = console.quiet, True
        try:
            with tempfile.TemporaryDirectory() as folder:
                training.train(Path(folder), dataclasses.replace(self.config, seed=seed), self.scenario)
                files = [f for f in sorted(Path(folder).rglob("*")) if f.is_file()]
                return {f.relative_to(folder).as_posix(): f.read_bytes() for f in files}
        finally:
            console.quiet = quiet


def keep(out: Path, config: TrainConfig, scenario: Scenario, seed: int, files: dict[str, bytes]) -> None:
    """Write the run folder of a seed; it appears only when it is complete."""
    from . import training

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
    from . import training

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


def train(out: Path, config: TrainConfig, scenario: Scenario, seeds: range, engine: studies.Engine) -> None:
    """Train the seeds that `out` does not have yet."""
    left = missing(out, config, scenario, seeds)
    make_folder(out)
    work = Training(config, scenario, code_version())
    with Bar("Training", len(seeds), "seeds", len(seeds) - len(left)) as bar, closing(engine(work, left)) as trained:
        for seed, files in trained:
            keep(out, config, scenario, seed, files)
            bar.update(advance=1, note=f"{folder_of(out, seed)}")


def parser() -> argparse.ArgumentParser:
    """Options of the command."""
    p = manual_parser(f"python -m {NAME}", __doc__, "python train.py --help lists the config keys.")
    p.add_argument("--seeds", metavar="N", type=whole_number(), default=5, help="how many (default: 5)")
    p.add_argument("--first", metavar="SEED", type=whole_number(), default=0, help="the first of them (default: 0)")
    p.add_argument("--out", metavar="OUT", type=folder, required=True, help="folder of the run folders")
    p.add_argument(
        "--config", metavar="YAML", type=file_path, help="file of config keys; the command line goes over it"
    )
    studies.add_options(p, "one training after the other in this one")
    return p


@command_line(
    NAME,
    interrupted="the same command goes on with the seeds that are left",
    memory="smaller ppo.num_envs or ppo.n_steps",
)
def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit status: 0 done, 2 bad input, 130 interrupted."""
    options, rest = parser().parse_known_args(arguments)
    with needing("train", NAME):
        from . import training
    if options.seeds < 1 or options.first < 0:
        raise ParameterError("--seeds, --first: expected at least one seed, and none below 0")
    engine = studies.choose(options.engine, options.workers, options.address)
    changes = overrides(rest, "--config")
    given = [key for key in _SET_HERE if key in changes]
    if given:
        raise ParameterError(f"--{given[0]}: is set for every seed; expected --seeds, --first and --out")
    mapping = {} if options.config is None else config_mapping(options.config)
    config = load_config(merge(mapping, changes), str(options.config or "command line"))
    scenario = training.scenario_of(config)
    training.check(config)
    train(options.out, config, scenario, range(options.first, options.first + options.seeds), engine)
    trained = f"{NAMES[config.observation]}={options.out}/seed_*"
    compare = f"{__package__}.evaluate --controllers 'soft_start,{trained}' --out {options.out}/evaluation"
    if config.rover:  # agents.evaluate drives wheels
        compare = f"{__package__}.train --resume {folder_of(options.out, options.first)}"
    show(f"Compare {'one' if config.rover else 'them'}: python -m {compare}")
    return 0


if __name__ == "__main__":
    leave(main())
