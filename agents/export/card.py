"""The model card of an export, in the format of the Hugging Face Hub and with the names of `huggingface_sb3`."""

from __future__ import annotations

from datetime import UTC, datetime

import yaml

from soil_env._io.document import Table, render
from soil_env.parameters import Scenario
from soil_env.terramechanics.model import WheelSoilModel

from ..evaluate.driving import HELD_OUT_SET, run_courses
from ..evaluate.tables import cell
from . import ENV, zip_name

_COLUMNS = (("immobilised", 100.0, 1), ("time_limit", 100.0, 1), ("finished", 100.0, 1), ("return", 1.0, 2))


def results(agent, scenario: Scenario, courses: int, world: WheelSoilModel | None) -> dict:
    """results.json as `huggingface_sb3.package_to_hub` writes it, of the first held-out courses, and two rates."""
    runs = run_courses(agent, scenario, HELD_OUT_SET, courses, model=world)
    return {
        "mean_reward": float(runs.returns.mean()),
        "std_reward": float(runs.returns.std()),
        "is_deterministic": True,
        "n_eval_episodes": courses,
        "eval_datetime": datetime.now(UTC).isoformat(timespec="seconds"),
        "finished": float(runs.metric("finished").mean()),
        "immobilised": float(runs.metric("immobilised").mean()),
    }


def card(description: dict, result: dict) -> str:
    """README.md: the header that the Hub reads, and the page."""
    return render(
        f"{__package__}:card.md",
        header=yaml.safe_dump(_header(description, result), sort_keys=False),
        d=description,
        r=result,
        zip=zip_name(description),
        table=_table(description["comparison"]),
    )


def _header(description: dict, result: dict) -> dict:
    """What `huggingface_sb3` puts at the head of a card."""
    value = f"{result['mean_reward']:.2f} +/- {result['std_reward']:.2f}"
    return {
        "library_name": "stable-baselines3",
        "license": "mit",
        "tags": [ENV, "deep-reinforcement-learning", "reinforcement-learning", "stable-baselines3", "onnx"],
        "model-index": [{
            "name": description["algorithm"],
            "results": [{
                "task": {"type": "reinforcement-learning", "name": "reinforcement-learning"},
                "dataset": {"name": ENV, "type": ENV},
                "metrics": [{"type": "mean_reward", "value": value, "name": "mean_reward", "verified": False}],
            }],
        }],
    }  # fmt: skip


def _table(comparison: dict | None) -> str:
    if comparison is None:
        return ""
    heads = ["controller", "immobilised [%]", "out of time [%]", "finished [%]", "return"]
    rows = [
        [f"`{name}`", *(cell(row[key], factor, digits) for key, factor, digits in _COLUMNS)]
        for name, row in comparison["controllers"].items()
    ]
    return Table(heads, rows).markdown()
