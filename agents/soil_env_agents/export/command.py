"""`soil-env export`: a trained agent as one ONNX file that needs neither torch, Stable-Baselines3
nor soil_env.
"""

import io
import tempfile
from pathlib import Path
from typing import Any

import click
import numpy as np
import yaml

from soil_env._io.files import check_own, plain, replace_file, write_own
from soil_env._io.loading import ParameterError, nearest
from soil_env.cli.running import PATH, WholeNumber
from soil_env.parameters import DEFAULT_SCENARIO, RoverScenario, Scenario, load_scenario
from soil_env.terramechanics.model import WheelSoilModel

from ..cli import needing_training
from ..default_policy import WEIGHTS, DefaultPolicy
from ..evaluate.contestants import SHIPPED
from ..exported import POLICY
from ..progress import show

DESCRIPTION = "policy.yaml"
COURSE = "course.npz"
RUNNER = "run_policy.py"


@click.command("export")
@click.argument("run", type=PATH, metavar="RUN")
@click.option("--out", type=PATH, metavar="OUT", required=True, help="Folder of the export.")
@click.option(
    "--scenario",
    metavar="NAME",
    help=f"Or YAML, of default or a foreign zip (default {DEFAULT_SCENARIO}).",
)
@click.option(
    "--steps", type=WholeNumber(1), default=1000, metavar="N", help="Steps compared (default 1000)."
)
def command(run: Path, out: Path, scenario: str | None, steps: int) -> None:
    """Export a trained agent as one ONNX file.

    RUN is a run folder of train.py, "default" for the policy that comes with the package, or a .zip
    of Stable-Baselines3 (PPO, A2C, TRPO, SAC, TQC, TD3). A zip that train.py did not write is
    unpickled in part: name only what you trust.

    The file takes raw observations and gives actions; normalisation, clipping and history are
    inside. It is compared with the agent over steps of held-out courses, and written only if no
    action differs by more than 1e-5.

    \b
    soil-env export runs/NAME --out policy
    python policy/run_policy.py
    soil-env evaluate --controllers soft_start,mine=policy --out evaluation

    \b
    OUT/policy.onnx     the agent with its description
    OUT/policy.yaml     inputs, output, rate, versions, scenario, difference from the agent, latency
    OUT/run_policy.py   runs it with numpy and onnxruntime only
    OUT/course.npz      the steps of the comparison
    """
    if str(run) not in SHIPPED and run.exists():
        with needing_training():
            import torch  # noqa: F401
    try:
        import onnx
        import onnxruntime  # noqa: F401
    except ImportError as error:
        raise ParameterError(f"needs {error.name}: pip install 'soil_env[export]'") from None
    from ..evaluate.models import load_model
    from ..run_policy import Policy, compared
    from . import policy

    path, task, world = _asked(run, scenario)
    check_own(out, (POLICY, DESCRIPTION, COURSE, RUNNER), (path,))
    try:
        agent = DefaultPolicy(task) if str(run) in SHIPPED else load_model(path, task)
    except ParameterError as error:
        raise ParameterError(str(error).removeprefix("controllers: ")) from None
    name = path.resolve().parent.name if path.stem == "model" else path.stem
    description = policy.describe(agent, name, task, world)
    course: dict[str, Any] = policy.recorded(agent, task, steps, world)
    model = policy.onnx_model(agent, description)
    onnx.checker.check_model(model, full_check=True)
    content = model.SerializeToString()
    with tempfile.TemporaryDirectory() as there:
        replace_file(Path(there) / POLICY, content)
        worst, times = compared(Policy(Path(there) / POLICY), course)
    if worst > policy.TOLERANCE:
        raise ParameterError(
            f"{path}: the exported action differs by {worst:.1e} from the agent's: expected at "
            f"most {policy.TOLERANCE:.0e}; nothing is written"
        )
    median, p99 = np.percentile(times, [50, 99]).tolist()
    description["proof"] = {
        "steps": len(times),
        "largest_difference": worst,
        "tolerance": policy.TOLERANCE,
        "latency_us": {"median": median, "p99": p99},
    }
    stream = io.BytesIO()
    np.savez_compressed(stream, **course)
    write_own(
        out,
        {
            POLICY: content,
            DESCRIPTION: yaml.safe_dump(plain(description), sort_keys=False, width=120),
            RUNNER: Path(__file__).parent.with_name(RUNNER).read_text(encoding="utf-8"),
            COURSE: stream.getvalue(),
        },
    )
    show(
        f"Written to {out}: policy.onnx ({len(content) / 1024:.0f} KiB). {len(times)} steps: "
        f"largest difference {worst:.1e}, {median:.0f} us a step, 99 % within {p99:.0f} us."
    )


def _asked(run: Path, scenario: str | None) -> tuple[Path, Scenario, WheelSoilModel | None]:
    """(file of the agent RUN, its scenario, model of its world or None).

    `scenario`: that of --scenario, for an agent whose file has none of its own; None: the default.
    ParameterError for a scenario beside an agent with its own, where RUN is no agent, and for an
    agent of a rover.
    """
    if str(run) in SHIPPED:
        return WEIGHTS, load_scenario(scenario or DEFAULT_SCENARIO), None
    path = run / "model.zip" if run.is_dir() else run
    if not path.is_file():
        wrong = f"{run}: no model.zip in this folder" if run.is_dir() else f"{path}: is not there"
        expected = "expected a run folder of train.py, a .zip of Stable-Baselines3, or 'default'"
        raise ParameterError(f"{wrong}{nearest(run, SHIPPED)}: {expected}")
    from ..agent import INFO, read_info, read_member

    if read_member(path, INFO) is None:
        return path, load_scenario(scenario or DEFAULT_SCENARIO), None
    if scenario is not None:
        raise ParameterError(f"--scenario {scenario}: {path} has its own")
    info = read_info(path)
    if isinstance(info.task, RoverScenario):
        raise ParameterError(
            f"{path}: an agent of a rover; expected one of a wheel, others are not exported"
        )
    return (
        path,
        info.task,
        WheelSoilModel.from_content(info.model, str(path)) if info.model else None,
    )
