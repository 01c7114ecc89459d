"""Exported agents against the agents: difference of the action over 1000 steps, and the time of a step.

    python -m benchmarks.export                          prints the table, two minutes
    python -m benchmarks.export --page docs/export.md    and puts it into the page

One agent of every kind, trained for some seconds with seed 0: what they do is no good, but their normalisation is not
the identity, and their networks have the size of the default training.
"""

from __future__ import annotations

import contextlib
import io
import sys
import tempfile
from dataclasses import replace
from pathlib import Path

import yaml

from agents import ppo
from agents.config import PPOConfig
from agents.export.__main__ import main as export
from benchmarks.common import check_page, renew_page
from soil_env._io.commands import command_line, command_parser, leave
from soil_env._io.document import Table
from soil_env._io.loading import ParameterError
from soil_env.parameters import load_scenario

KINDS = (  # algorithm, observation, past steps in the history
    ("ppo", "blind", 0),
    ("ppo", "blind", 7),
    ("ppo", "identified", 0),
    ("ppo", "identified", 7),
    ("recurrent_ppo", "blind", 0),
    ("recurrent_ppo", "identified", 0),
)
LEARNT = 8192  # steps
CONFIG = PPOConfig(num_envs=64, n_steps=64, batch_size=1024, n_epochs=1)


def measured(algorithm: str, observation: str, history: int) -> dict:
    """policy.yaml of the export of one agent, with the size of its file."""
    scenario = load_scenario("mixed")
    model = ppo.build(scenario, observation, replace(CONFIG, history=history), 0, algorithm=algorithm)
    model.learn(LEARNT)
    with tempfile.TemporaryDirectory() as folder:
        ppo.save(model, Path(folder) / "model.zip")
        with contextlib.redirect_stdout(io.StringIO()):
            status = export([folder, f"--out={folder}/out", "--courses=10"])
        if status:
            raise ParameterError(f"{algorithm}, {observation}, history {history}: the export ended with {status}")
        content = yaml.safe_load((Path(folder) / "out" / "policy.yaml").read_text(encoding="utf-8"))
        return content | {"size": (Path(folder) / "out" / "policy.onnx").stat().st_size}


@command_line("benchmarks.export")
def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    p = command_parser("python -m benchmarks.export", __doc__)
    p.add_argument("--page", type=Path, metavar="MD", help="put the result between the markers of this page")
    options = p.parse_args(arguments)
    if options.page is not None:
        check_page(options.page, "export")
    rows = []
    for algorithm, observation, history in KINDS:
        found = measured(algorithm, observation, history)
        proof, latency = found["proof"], found["proof"]["latency_us"]
        rows.append((
            f"{algorithm}, `{observation}`", str(history), f"{found['size'] / 1024:.0f}",
            f"{proof['largest_difference']:.1e}", f"{latency['median']:.0f}", f"{latency['p99']:.0f}",
        ))  # fmt: skip
        print(rows[-1], file=sys.stderr)
    header = ("agent", "past steps", "KiB", "largest difference", "median step [us]", "99 % within [us]")
    text = Table(header, rows, "1000 steps on held-out courses of `mixed`, one wheel, one thread").markdown()
    if options.page is not None:
        renew_page(options.page, {"export": text})
    print(text)
    return 0


if __name__ == "__main__":
    leave(main())
