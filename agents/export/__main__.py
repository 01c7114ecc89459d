"""Export a trained agent as one ONNX file that needs neither torch nor Stable-Baselines3 nor soil_env.

RUN is a run folder of train.py, or a .zip of Stable-Baselines3 (PPO, A2C, TRPO, RecurrentPPO, SAC, TQC, TD3), with its
vecnormalize.pkl beside it where there is one. A zip that train.py did not write is unpickled in part: name only what
you trust.

The file takes raw observations and gives actions: normalisation, clipping, squashing and the history are inside, and
hidden states are inputs and outputs with names. It is compared with the agent over the steps of held-out courses
before anything is written; where an action differs by more than 1e-5 nothing is.

Examples:
  python -m agents.export runs/NAME --out policy
  python policy/run_policy.py
  python -m agents.evaluate --controllers soft_start,mine=policy --out evaluation
"""

from __future__ import annotations

import argparse
import importlib.resources
import json
import tempfile
from pathlib import Path

import yaml

from soil_env._io.commands import command, command_line, folder, leave, whole_number
from soil_env._io.files import check_outputs, plain, replace_files, write_json
from soil_env._io.loading import ParameterError, load
from soil_env.parameters import DEFAULT_SCENARIO, Scenario, load_scenario
from soil_env.terramechanics.model import WheelSoilModel

from ..cli import manual_parser
from ..exported import POLICY, ExportedAgent
from ..extras import needing
from ..progress import show
from . import CARD, COURSE, DESCRIPTION, RUNNER, zip_name

_NAME = __package__
_FILES = """
OUT holds
  policy.onnx     the agent; its description is inside, too
  policy.yaml     names, units, bounds and order of the inputs, meaning and scale of the output, rate, versions,
                  scenario, comparison, difference from the agent, latency
  run_policy.py   runs it: numpy and onnxruntime only
  course.npz      the steps that both were compared on
  NAME.zip        the agent of Stable-Baselines3, as huggingface_sb3 names it; config.json, results.json
  README.md       model card for the Hugging Face Hub (python -m agents.publish)
"""


def parser() -> argparse.ArgumentParser:
    """Options of the command."""
    p = manual_parser(command(_NAME), __doc__, _FILES)
    p.add_argument("run", metavar="RUN", type=Path, help="run folder, or a .zip of Stable-Baselines3")
    p.add_argument("--out", metavar="OUT", type=folder, required=True, help="folder of the export")
    p.add_argument(
        "--scenario", metavar="NAME", help=f"of a zip that does not say: scenario or YAML file ({DEFAULT_SCENARIO})"
    )
    p.add_argument("--steps", metavar="N", type=whole_number(1), default=1000, help="compared (default: 1000)")
    p.add_argument(
        "--courses", metavar="N", type=whole_number(2), default=100,
        help="held-out courses for the mean return of the model card (default: 100)",
    )  # fmt: skip
    return p


def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit status: 0 done, 2 bad input, 130 interrupted."""
    options = parser().parse_args(arguments)
    with needing("train", _NAME):
        import torch  # noqa: F401
    return _run(options)


@command_line(_NAME)
def _run(options: argparse.Namespace) -> int:
    try:
        import onnx  # noqa: F401
        import onnxruntime  # noqa: F401
    except ImportError as error:
        raise ParameterError(f"needs {error.name}: pip install 'soil_env[export]'") from None
    from . import card, policy

    path, scenario, world = _asked(options)
    check_outputs(options.out, (POLICY, DESCRIPTION, COURSE, RUNNER, CARD))
    agent = _agent(path, scenario)
    name = path.resolve().parent.name if path.stem == "model" else path.stem
    description = policy.describe(agent, name, scenario, world)
    course = policy.recorded(agent, scenario, options.steps, world)
    content, proof = _compared(policy, agent, description, course)
    if proof["largest_difference"] > policy.TOLERANCE:
        raise ParameterError(
            f"{path}: the exported action differs by {proof['largest_difference']:.1e} from the agent's: expected at "
            f"most {policy.TOLERANCE:.0e}; nothing is written"
        )
    result = card.results(agent, scenario, options.courses, world)
    description |= {"proof": proof, "comparison": _comparison(path.parent, agent)}
    _write(options.out, path, content, plain(description), plain(result), policy.write_course, course)
    latency = proof["latency_us"]
    show(
        f"Written to {options.out}: policy.onnx ({len(content) / 1024:.0f} KiB). {proof['steps']} steps: largest "
        f"difference {proof['largest_difference']:.1e}, {latency['median']:.0f} us a step, 99 % within "
        f"{latency['p99']:.0f} us."
    )
    return 0


def _asked(options) -> tuple[Path, Scenario, WheelSoilModel | None]:
    """(the zip, its scenario, the model of its world)."""
    from .. import ppo, zips

    path = options.run / "model.zip" if options.run.is_dir() else options.run
    if not path.is_file():
        wrong = f"{options.run}: no model.zip in this folder" if options.run.is_dir() else f"{path}: is not there"
        raise ParameterError(f"{wrong}: expected a run folder of train.py, or a .zip of Stable-Baselines3")
    if zips.read_bytes(path, ppo.META) is None:
        return path, load_scenario(options.scenario or DEFAULT_SCENARIO), None
    if options.scenario is not None:
        raise ParameterError(f"--scenario {options.scenario}: {path} has its own")
    meta = ppo.read_meta(path)
    if "vehicle" in meta["scenario"]:
        raise ParameterError(f"{path}: an agent of a rover; expected one of a wheel, others are not exported")
    world = WheelSoilModel.from_content(meta["model"], str(path)) if "model" in meta else None
    return path, load(Scenario, meta["scenario"], f"{path}: scenario"), world


def _agent(path: Path, scenario: Scenario):
    """The agent; what is wrong with it in one line."""
    from ..evaluate.models import load_model

    try:
        return load_model(path, scenario)
    except ParameterError as error:
        raise ParameterError(str(error).removeprefix("controllers: ")) from None


def _compared(policy, agent, description: dict, course) -> tuple[bytes, dict]:
    """(the ONNX file, how it compares with the agent)."""
    import onnx

    model = policy.onnx_model(agent, description)
    onnx.checker.check_model(model, full_check=True)
    content = model.SerializeToString()
    with tempfile.TemporaryDirectory() as there:
        file = Path(there) / POLICY
        file.write_bytes(content)
        return content, policy.compared(ExportedAgent(file), course)


_KEPT = ("immobilised", "time_limit", "finished", "time", "energy_per_metre", "slip", "return")


def _comparison(run: Path, agent) -> dict | None:
    """The metrics of comparison.json of the run folder, of every controller."""
    file = run / "comparison.json"
    if not file.is_file():
        return None
    found = json.loads(file.read_text(encoding="utf-8"))
    rows = {name: {key: row[key] for key in _KEPT if key in row} for name, row in found["controllers"].items()}
    return {"courses": found["courses"], "agent": getattr(agent, "name", None), "controllers": rows}


def _write(out: Path, path: Path, content: bytes, description: dict, result: dict, write_course, course) -> None:
    """All files of the export."""
    from .. import zips
    from . import card

    runner = importlib.resources.files(_NAME).joinpath(RUNNER).read_text(encoding="utf-8")
    name = zip_name(description)
    replace_files(out, {
        POLICY: content,
        DESCRIPTION: yaml.safe_dump(description, sort_keys=False, width=120),
        RUNNER: runner,
        CARD: card.card(description, result),
        name: path.read_bytes(),
    })  # fmt: skip
    write_course(course, out / COURSE)
    write_json(out / "results.json", result)
    write_json(out / "config.json", zips.read_member(path, "data"))


if __name__ == "__main__":
    leave(main())
