"""Export a trained agent as one ONNX file that needs neither torch nor Stable-Baselines3 nor soil_env.

RUN is a run folder of train.py, or a .zip of Stable-Baselines3 (PPO, A2C, TRPO, RecurrentPPO, SAC, TQC, TD3), with its
vecnormalize.pkl beside it where there is one. A zip that train.py did not write is unpickled in part: name only what
you trust.

The file takes raw observations and gives actions: normalisation, clipping, squashing and the history are inside, and
hidden states are inputs and outputs with names. It is compared with the agent over the steps of held-out courses
before anything is written; where an action differs by more than 1e-5 nothing is.

Examples:
  soil-env export runs/NAME --out policy
  python policy/run_policy.py
  soil-env evaluate --controllers soft_start,mine=policy --out evaluation
"""

from __future__ import annotations

import argparse
import io
import tempfile
from pathlib import Path

import numpy as np
import yaml

from soil_env._io.commands import command, command_line, command_parser, folder, leave, whole_number
from soil_env._io.files import check_outputs, plain, replace_files
from soil_env._io.loading import ParameterError
from soil_env.parameters import DEFAULT_SCENARIO, Scenario, load_scenario
from soil_env.terramechanics.model import WheelSoilModel
from soil_env.vehicle import RoverScenario

from ..exported import POLICY
from ..extras import needing
from ..progress import show

_NAME = __package__
DESCRIPTION, COURSE, RUNNER = "policy.yaml", "course.npz", "run_policy.py"
_FILES = """
OUT holds
  policy.onnx     the agent; its description is inside, too
  policy.yaml     names, units, bounds and order of the inputs, meaning and scale of the output, rate, versions,
                  scenario, difference from the agent, latency
  run_policy.py   runs it: numpy and onnxruntime only
  course.npz      the steps that both were compared on
"""


def parser() -> argparse.ArgumentParser:
    """Options of the command."""
    p = command_parser(command(_NAME), __doc__, _FILES, allow_abbrev=False)
    p.add_argument("run", metavar="RUN", type=Path, help="run folder, or a .zip of Stable-Baselines3")
    p.add_argument("--out", metavar="OUT", type=folder, required=True, help="folder of the export")
    p.add_argument(
        "--scenario", metavar="NAME", help=f"of a zip that does not say: scenario or YAML file ({DEFAULT_SCENARIO})"
    )
    p.add_argument("--steps", metavar="N", type=whole_number(1), default=1000, help="compared (default: 1000)")
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
        import onnx
        import onnxruntime  # noqa: F401
    except ImportError as error:
        raise ParameterError(f"needs {error.name}: pip install 'soil_env[export]'") from None
    from ..evaluate.models import load_model
    from ..run_policy import Policy, compared
    from . import policy

    path, scenario, world = _asked(options)
    check_outputs(options.out, (POLICY, DESCRIPTION, COURSE, RUNNER))
    try:
        agent = load_model(path, scenario)
    except ParameterError as error:
        raise ParameterError(str(error).removeprefix("controllers: ")) from None
    name = path.resolve().parent.name if path.stem == "model" else path.stem
    description = policy.describe(agent, name, scenario, world)
    course = policy.recorded(agent, scenario, options.steps, world)
    model = policy.onnx_model(agent, description)
    onnx.checker.check_model(model, full_check=True)
    content = model.SerializeToString()
    with tempfile.TemporaryDirectory() as there:
        (Path(there) / POLICY).write_bytes(content)
        worst, times = compared(Policy(Path(there) / POLICY), course)
    if worst > policy.TOLERANCE:
        raise ParameterError(
            f"{path}: the exported action differs by {worst:.1e} from the agent's: expected at most "
            f"{policy.TOLERANCE:.0e}; nothing is written"
        )
    median, p99 = np.percentile(times, [50, 99]).tolist()
    description["proof"] = {"steps": len(times), "largest_difference": worst, "tolerance": policy.TOLERANCE,
                            "latency_us": {"median": median, "p99": p99}}  # fmt: skip
    stream = io.BytesIO()
    np.savez_compressed(stream, **course)
    replace_files(options.out, {
        POLICY: content,
        DESCRIPTION: yaml.safe_dump(plain(description), sort_keys=False, width=120),
        RUNNER: Path(__file__).parent.with_name(RUNNER).read_text(encoding="utf-8"),
        COURSE: stream.getvalue(),
    })  # fmt: skip
    show(
        f"Written to {options.out}: policy.onnx ({len(content) / 1024:.0f} KiB). {len(times)} steps: largest "
        f"difference {worst:.1e}, {median:.0f} us a step, 99 % within {p99:.0f} us."
    )
    return 0


def _asked(options) -> tuple[Path, Scenario, WheelSoilModel | None]:
    """(the zip, its scenario, the model of its world)."""
    from ..agent import INFO, read_info, read_member

    path = options.run / "model.zip" if options.run.is_dir() else options.run
    if not path.is_file():
        wrong = f"{options.run}: no model.zip in this folder" if options.run.is_dir() else f"{path}: is not there"
        raise ParameterError(f"{wrong}: expected a run folder of train.py, or a .zip of Stable-Baselines3")
    if read_member(path, INFO) is None:
        return path, load_scenario(options.scenario or DEFAULT_SCENARIO), None
    if options.scenario is not None:
        raise ParameterError(f"--scenario {options.scenario}: {path} has its own")
    info = read_info(path)
    if isinstance(info.task, RoverScenario):
        raise ParameterError(f"{path}: an agent of a rover; expected one of a wheel, others are not exported")
    return path, info.task, WheelSoilModel.from_content(info.model, str(path)) if info.model else None


if __name__ == "__main__":
    leave(main())
