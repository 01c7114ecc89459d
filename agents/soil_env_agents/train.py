"""`soil-env train`: train an agent and compare it with the classical controllers."""

import dataclasses
import textwrap
from pathlib import Path

import click

from soil_env._io.files import alone
from soil_env._io.loading import ParameterError, merge
from soil_env.cli.running import PATH

from .cli import (
    WITH_KEYS,
    again,
    begun_in,
    config_mapping,
    continued_by,
    keys_argument,
    needing_training,
    overrides,
)
from .config import PPOConfig, TrainConfig, load_config
from .progress import show


def _keys() -> str:
    """Text at the end of the help: keys of the config with defaults and meaning, those of PPO with
    their defaults.
    """
    lines = ["\b", "Keys of the config with their defaults, in the YAML file or as options:"]
    for f in dataclasses.fields(TrainConfig):
        if f.name not in ("ppo", "changes"):
            default = "" if f.default in ("", None, dataclasses.MISSING) else str(f.default)
            lines.append(f"  --{f.name:17s}{default:11s} {f.metadata.get('doc', '')}".rstrip())
    own = " ".join(f"{f.name}={f.default}" for f in dataclasses.fields(PPOConfig))
    lines += textwrap.wrap(
        f"--ppo.KEY          {own}", 100, initial_indent="  ", subsequent_indent=" " * 21
    )
    lines.append("  --changes.KEY      any key of the scenario, as --changes.course.length 20")
    return "\n".join(lines)


@click.command("train", context_settings=WITH_KEYS, epilog=_keys())
@click.option(
    "--config",
    type=PATH,
    metavar="YAML",
    help="Config keys, own or shipped file; options replace them.",
)
@click.option(
    "--resume", type=PATH, metavar="RUN", help="Run folder to continue; takes no other option."
)
@keys_argument
def command(config: Path | None, resume: Path | None, keys: tuple[str, ...]) -> None:
    """Train an agent and compare it with the classical controllers.

    \b
    soil-env train                                       # two_lines, observation "identified"
    soil-env train --config smoke.yaml                   # everything in seconds
    soil-env train --observation blind --timesteps 5e6
    soil-env train --resume runs/NAME                    # continue after an interrupt or a kill

    The run folder gets config.yaml, scenario.yaml, model.zip, tensorboard/ and comparison/;
    checkpoint.zip is there from the end of the student until the training is done.
    """
    with needing_training():
        from . import comparison, training

    changes = overrides(keys, "--config")
    if resume is not None:
        if config is not None or changes:
            raise ParameterError("--resume takes no other option: the run folder has its config")
        folder = resume
        settings, scenario = training.open_run(resume)
    else:
        mapping = {}
        where = "command line"
        if config is not None:
            mapping = config_mapping(config)
            where = f"{config}, command line"
            load_config(mapping, str(config))  # errors of the file alone name the file alone
        settings = load_config(merge(mapping, changes), where)
        try:
            scenario = training.scenario_of(settings)
        except ParameterError as error:
            raise ParameterError(f"{where}: {error}" if config else str(error)) from None
        folder = training.make_run_folder(settings, scenario)
    new = resume is None
    line = again("train", "--resume", folder)
    with begun_in(folder, new, made=new), alone(folder), continued_by(line, folder):
        show(f"Run folder: {folder}")
        if all((folder / name).is_file() for name in (training.MODEL, comparison.DONE)):
            show(
                f"Already finished: edits count no more. Delete its {training.MODEL} to train "
                f"again from step 0, its {comparison.DONE} to compare again."
            )
            return
        (folder / comparison.DONE).unlink(missing_ok=True)  # of a model that is trained again
        try:
            agent = training.train(folder, settings, scenario)
        except MemoryError as error:
            raise MemoryError(f"{error}; expected a smaller ppo.num_envs or ppo.n_steps") from None
        comparison.compare(folder, settings, scenario, agent)
