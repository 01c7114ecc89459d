"""Wall time of the parts of a run, kept in its folder as time.json."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from stable_baselines3.common.callbacks import BaseCallback

from soil_env._io.files import replace_file

FILE = "time.json"
#: Part -> what it is, in the order they come. "policy" is all of a rollout but the environment.
PARTS = {
    "env": "environment",
    "policy": "policy, normalisation and bookkeeping",
    "update": "updates",
    "tuning": "tuning the classical controllers",
    "comparison": "comparison on held-out courses",
    "figures": "figures",
}
TRAINING = ("env", "policy", "update")


class Times:
    """Wall time of the parts of a run [s]; goes on from the time.json that an interrupted run has left."""

    def __init__(self, folder: Path):
        self.path = Path(folder) / FILE
        try:
            kept = json.loads(self.path.read_text(encoding="utf-8"))["seconds"]
            self.seconds = {part: float(kept.get(part, 0.0)) for part in PARTS}
        except (OSError, ValueError, KeyError, TypeError, AttributeError):
            self.seconds = dict.fromkeys(PARTS, 0.0)

    @contextmanager
    def part(self, name: str) -> Iterator[None]:
        """The time in this block is that of `name`, in place of an earlier measurement."""
        start = time.perf_counter()
        yield
        self.seconds[name] = time.perf_counter() - start

    def save(self) -> None:
        """Write time.json."""
        content = {"seconds": {part: round(value, 3) for part, value in self.seconds.items()}}
        replace_file(self.path, json.dumps(content, indent=1) + "\n")

    def __str__(self) -> str:
        """One line a part that took time, training first."""
        total, training = sum(self.seconds.values()), sum(self.seconds[part] for part in TRAINING)
        lines = [f"Wall time {_clock(total)}:"]
        if training > 0.0:
            lines.append(f"  {_clock(training):>12s}  training, of which")
            lines += [f"{'':16s}{self.seconds[p] / training:4.0%}  {PARTS[p]}" for p in TRAINING]
        lines += [f"  {_clock(self.seconds[p]):>12s}  {PARTS[p]}" for p in PARTS if p not in TRAINING]
        return "\n".join(lines)


def _clock(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:2d} s" if minutes else f"{seconds:.1f} s"


class Timing(BaseCallback):
    """Adds the time that `learn` takes to `seconds`: {"env", "policy", "update"}."""

    def __init__(self, seconds: dict[str, float]):
        super().__init__()
        self.seconds = seconds
        self._since, self._env = 0.0, 0.0

    def _lap(self) -> float:
        now = time.perf_counter()
        lap, self._since = now - self._since, now
        return lap

    def _on_training_start(self) -> None:
        self._since = time.perf_counter()

    def _on_rollout_start(self) -> None:
        self.seconds["update"] += self._lap()
        self._env = self.training_env.unwrapped.seconds

    def _on_step(self) -> bool:
        return True

    def _on_rollout_end(self) -> None:
        env = self.training_env.unwrapped.seconds - self._env
        self.seconds["env"] += env
        self.seconds["policy"] += self._lap() - env

    def _on_training_end(self) -> None:
        self.seconds["update"] += self._lap()
