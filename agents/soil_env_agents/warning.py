"""Train the probability of immobilisation that ships with the identifier.

    python -m soil_env_agents.warning --out soil_env/identification/online/immobilisation.json

Drives of several families of drivers over the scenarios are recorded. A network learns two hazards
from them: to be immobilised within 3 s, and within 5 s if not before. These are discrete hazards
(Gensheimer & Narasimhan 2019, PeerJ 7:e6257). The threshold of the alarm is set on other courses,
so that it is false for 5 % of the driving time on finished ones.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import click
import numpy as np
import torch

import soil_env
from soil_env._io.files import check_outputs, make_folder, write_json
from soil_env._io.loading import ParameterError
from soil_env.cli.running import PATH, run
from soil_env.envs.wheel_env import IMMOBILISED
from soil_env.identification.online.immobilisation import (
    INPUTS,
    LARGEST,
    SCALES,
    ImmobilisationWarning,
    Network,
)
from soil_env.identification.published import HORIZONS
from soil_env.parameters import Scenario, load_scenario
from soil_env.simulation.task import Cause

from .controllers import CONTROLLERS, Controller
from .evaluate.driving import drive
from .evaluate.warning import Alarms, least_progress
from .progress import Bar, show

#: Course sets, disjoint from each other and from those of `evaluate`.
SETS = {"training": 5_000_011, "tuning": 6_000_011, "test": 7_000_003}
SCENARIOS = ("two_lines", "mixed", "sticky", "loose_slopes", "field_vehicle")
FAMILIES = (
    "constant_speed",
    "soft_start",
    "slip",
    "full_throttle",
    "best_slip",
    "random_speed",
    "random_throttle",
)
#: Families that somebody might drive with. The random ones bring the wheel into states that good
#: drivers avoid; they drive a third of the courses.
DRIVERS = FAMILIES[:5]
BLOCK = 300  # courses driven side by side
FALSE = 0.05  # share of the driving time on finished courses under alarm
# [s] of driving before a course that the time limit cut makes no more progress; from there its
# outcome is not known. The longest of `HORIZONS`.
UNKNOWN = 5.0
# Of the network and its training; chosen.
HIDDEN = (64, 32)  # units
RATE = 1e-2  # largest learning rate of AdamW
DECAY = 1e-3  # of the weights
BATCH = 4096  # rows of an update
AT_ONCE = 100.0  # [m/s2]: no ramp
BACKWARDS = 0.1  # share of the speeds drawn at random
BACK = -0.4  # [of the top rim speed, or of the stall torque] backwards
_STUCK = [cause.value for cause in IMMOBILISED]


@dataclass(frozen=True)
class Sizes:
    """How much is driven and learnt."""

    training: int = 900  # courses of each scenario and family
    tuning: int = 150
    share: float = 0.15  # of the control periods that are learnt
    epochs: int = 10


class Random(Controller):
    """A driver whose rim speed, or with `throttle` torque, is drawn anew at random times.

    `count`: courses driven side by side. Each course has its own mean time between two draws, 0.3
    to 5 s.
    """

    def __init__(self, scenario: Scenario, rng: np.random.Generator, count: int, throttle: bool):
        super().__init__(scenario)
        self.rng = rng
        self.throttle = throttle
        self.level = rng.uniform(0.0, 1.0, count)  # of the top rim speed, or of the stall torque
        self.mean = np.exp(rng.uniform(np.log(0.3), np.log(5.0), count))  # [s]

    def prefers_other_route(self, batch):
        """Either route with equal chance."""
        return self.rng.random(len(batch)) < 0.5

    def rim_speed(self, observation, state):
        """Rim speed of this control period [m/s], [n]: the level, which is drawn anew by chance."""
        backwards, new, change = self.rng.random((3, len(self.level)))
        drawn = np.where(backwards < BACKWARDS, BACK, new)
        self.level = np.where(change < self.period / self.mean, drawn, self.level)
        return self.level * self.top_speed

    def command(self, batch, rim_speed, state):
        """Actions [n, 1] float32 that follow the rim speed.

        With `throttle` the action is `level` itself, as a share of the stall torque.
        """
        if self.throttle:
            return (rim_speed / self.top_speed).astype(np.float32)[:, None]
        return super().command(batch, rim_speed, state)


def make_driver(family: str, scenario: Scenario, seed: Sequence[int], count: int) -> Controller:
    """A driver of a family (`FAMILIES`) on `count` courses side by side.

    Its settings are arrays [count] in m/s and m/s2, drawn for each course by `seed`. "best_slip"
    has the same settings on all courses, "full_throttle" has none.
    """
    rng = np.random.default_rng([*seed, FAMILIES.index(family)])
    top = Controller(scenario).top_speed
    start = rng.uniform(0.05, 0.4, count) * top  # rim speed up to which slip does not limit it
    names = {"slip": "slip_limiter", "best_slip": "best_slip_identified"}
    settings: dict[str, Any] = {}
    if family == "constant_speed":
        settings = {"speed": rng.uniform(0.05, 0.9, count) * top}
    elif family == "soft_start":
        rate = np.exp(rng.uniform(np.log(0.04), np.log(0.7), count)) * top
        settings = {"acceleration": rate, "speed": rng.uniform(0.2, 0.95, count) * top}
    elif family == "slip":
        settings = {
            "slip": rng.uniform(0.05, 0.7, count),
            "start": start,
            "acceleration": AT_ONCE,
            "speed": np.maximum(rng.uniform(0.3, 0.95, count) * top, start),
        }
    elif family == "best_slip":
        settings = {"start": 0.1 * top, "acceleration": AT_ONCE, "speed": 0.4 * top}
    elif family != "full_throttle":
        return Random(scenario, rng, count, family == "random_throttle")
    driver: Controller = CONTROLLERS[names.get(family, family)](scenario, **settings)
    return driver


@dataclass(frozen=True)
class Drives:
    """Courses driven side by side; arrays [periods, courses] unless stated otherwise."""

    period: float  # [s]
    inputs: np.ndarray  # [periods, courses, inputs] float32
    alive: np.ndarray  # bool
    driving: np.ndarray  # bool: alive, and not at a halt
    best: np.ndarray  # [m] furthest point
    cause: np.ndarray  # [courses] `Cause`
    least: float  # [m] of progress in a period at the least mean speed that the task asks for
    least_progress: float  # [m] that the wheel has to get further within the limit of no progress

    def since(self, start: np.ndarray) -> np.ndarray:
        """Time spent driving [s] from the end of the period with the index `start` [courses] to the
        end of every period, [periods, courses]; negative before.
        """
        clock = np.cumsum(self.driving, axis=0) * self.period
        return clock - np.take_along_axis(clock, start[None], axis=0)

    @property
    def ahead(self) -> np.ndarray:
        """Seconds of driving until the last period in which the furthest point advanced by `least`
        [periods, courses], negative after that; +inf on courses that do not end immobilised.
        """
        # Periods in which the wheel makes progress, and the last of each course.
        mobile = self.driving & (np.diff(self.best, axis=0, prepend=0.0) >= self.least)
        last = np.where(mobile.any(axis=0), len(mobile) - 1 - np.argmax(mobile[::-1], axis=0), 0)
        return np.where(np.isin(self.cause, _STUCK), -self.since(last), np.inf)

    @property
    def known(self) -> np.ndarray:
        """Mask [periods, courses] of the periods under way whose outcome is known.

        Of a course that the time limit cut it is not known from `UNKNOWN` s before its last
        progress on: the wheel may have been about to stop for good.
        """
        # First period within `least_progress` of the furthest point: no more progress that counts.
        near = np.argmax(self.driving & (self.best >= self.best[-1] - self.least_progress), axis=0)
        cut = self.cause == Cause.TIME_LIMIT.value
        return self.alive & ~(cut & (self.since(near) > -UNKNOWN))

    def false(self, probability: np.ndarray, threshold: float) -> tuple[float, float]:
        """(time under alarm, time driven) [s] on finished courses, on which every alarm is false.

        `probability` [periods, courses]: within the longer horizon; `threshold` of the alarm.
        """
        passed = self.cause == Cause.FINISHED.value
        alarms = Alarms(len(passed), self.period, threshold)
        under = 0
        for p, driving in zip(probability, self.driving, strict=True):
            alarms.step(p, driving)
            under += int((alarms.on & driving & passed).sum())
        return under * self.period, float(self.driving[:, passed].sum()) * self.period


def drives(scenario: str, family: str, seed: int, first: int, count: int) -> Drives:
    """Drive courses `first` ... `first + count - 1` of set `seed` by torque, with a driver of the
    family (`make_driver`); `inputs` are those of the network that warns.
    """
    task = load_scenario(scenario, {"control": {"action": "torque"}})
    warning = ImmobilisationWarning(task)
    rows = np.arange(count)
    kept = []
    driver = make_driver(family, task, [seed, first], count)
    courses = range(first, first + count)
    for sim, alive in drive(driver, task, seed, courses, threads=1, warnings=True):
        worlds = sim.worlds
        read = warning.assess(rows, worlds.recent, worlds.ids.estimate, worlds.ids.sd).inputs
        drives_on = alive & (worlds.state["halt_left"] == 0.0)
        furthest = worlds.state["best_x"].copy()
        kept.append((read.astype(np.float32), alive.copy(), drives_on, furthest))
        cause = worlds.cause.copy()
    inputs, alive, driving, best = (np.array(column) for column in zip(*kept, strict=True))
    return Drives(
        period=task.control.period,
        inputs=inputs,
        alive=alive,
        driving=driving,
        best=best,
        cause=cause,
        least=least_progress(task),
        least_progress=task.limits.no_progress_distance,
    )


def fit(inputs: np.ndarray, ahead: np.ndarray, epochs: int, seed: int = 0) -> Network:
    """Weights of highest likelihood, with weight decay; each output is the log-odds of one hazard.

    `inputs` [n, inputs] are those of the network, `ahead` [n] the seconds until the wheel stops for
    good (`Drives.ahead`). The first hazard is learnt from all rows, the second from those that are
    not immobilised within the first horizon.
    """
    torch.manual_seed(seed)
    mean = inputs.mean(axis=0)
    scale = 1.0 / (inputs.std(axis=0) + 1e-6)
    x = torch.from_numpy(np.clip((inputs - mean) * scale, -LARGEST, LARGEST).astype(np.float32))
    # 1 where the wheel is immobilised within the first horizon, and within the second.
    early, late = (torch.from_numpy((ahead <= h).astype(np.float32)) for h in HORIZONS)
    sizes = (x.shape[1], *HIDDEN, len(HORIZONS))
    layers = [torch.nn.Linear(a, b) for a, b in zip(sizes[:-1], sizes[1:], strict=True)]
    model = torch.nn.Sequential(layers[0], torch.nn.Tanh(), layers[1], torch.nn.Tanh(), layers[2])
    optimizer = torch.optim.AdamW(model.parameters(), lr=RATE, weight_decay=DECAY)
    steps = epochs * -(-len(x) // BATCH)
    # One more than there are updates: the schedule steps after each update, and counts the rate
    # before the first one too.
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, total_steps=steps + 1)
    loss_of = torch.nn.functional.binary_cross_entropy_with_logits
    for _ in range(epochs):
        for batch in torch.randperm(len(x)).split(BATCH):
            out = model(x[batch])
            y = early[batch]
            later = loss_of(out[:, 1], late[batch], reduction="none") * (1.0 - y)
            loss = (loss_of(out[:, 0], y, reduction="none") + later).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    arrays = [
        a
        for layer in layers
        for a in (layer.weight.detach().numpy().T, layer.bias.detach().numpy())
    ]
    return Network(*(np.ascontiguousarray(a, dtype=np.float64) for a in (mean, scale, *arrays)))


def probabilities(network: Network, found: Drives) -> np.ndarray:
    """Probability of immobilisation within the longer horizon [periods, courses], by the `network`
    for the `found` drives; 0 where a course has ended.
    """
    x = found.inputs[found.alive].astype(np.float64)
    x = np.clip((x - network.mean) * network.scale, -LARGEST, LARGEST)
    x = np.tanh(x @ network.first + network.first_bias)
    x = np.tanh(x @ network.second + network.second_bias)
    # hazards: of the first horizon, and of the rest where the first has passed
    early, late = (1.0 / (1.0 + np.exp(-(x @ network.last + network.last_bias)))).T
    out = np.zeros(found.alive.shape)
    out[found.alive] = early + (1.0 - early) * late
    return out


def threshold(scores: Sequence[np.ndarray], found: Sequence[Drives]) -> float:
    """The lowest threshold, to a thousandth, of an alarm that is false for at most `FALSE`.

    `scores`: `probabilities` of each of the `found` drives. ParameterError where none finished.
    """
    low = 0.0
    high = 1.0
    for _ in range(10):  # halves the bracket to a thousandth
        middle = 0.5 * (low + high)
        times = [d.false(s, middle) for s, d in zip(scores, found, strict=True)]
        under, driven = np.sum(times, axis=0)
        if driven == 0:
            raise ParameterError(
                "no course was finished to set the alarm on: expected more courses"
            )
        low, high = (middle, high) if under > FALSE * driven else (low, middle)
    return high


def train(sizes: Sizes) -> dict[str, Any]:
    """Content of immobilisation.json: weights by name, alarm, and how weights and alarm were made
    (`card`).

    All `FAMILIES` drive `SCENARIOS`, the random ones on a third of the courses. The network is fit
    to a share of the periods whose outcome is known. The alarm is the `threshold` for the
    `DRIVERS` on the tuning courses.
    """
    rng = np.random.default_rng(SETS["training"])
    inputs = []
    ahead = []
    jobs = [(s, f) for s in SCENARIOS for f in FAMILIES]
    with Bar("Drives", len(jobs), "of a scenario and a family") as bar:
        for done, (scenario, family) in enumerate(jobs):
            count = sizes.training if family in DRIVERS else max(1, sizes.training // 3)
            for first in range(0, count, BLOCK):
                found = drives(scenario, family, SETS["training"], first, min(BLOCK, count - first))
                chosen = found.known & (rng.random(found.known.shape) < sizes.share)
                inputs.append(found.inputs[chosen])
                ahead.append(found.ahead[chosen].astype(np.float32))
            bar.update(done + 1)
    rows = np.concatenate(inputs)
    seconds = np.concatenate(ahead)
    order = rng.permutation(len(seconds))
    show(f"fit of {len(seconds):,} rows")
    network = fit(rows[order], seconds[order], sizes.epochs)
    tests = [drives(s, f, SETS["tuning"], 0, sizes.tuning) for s in SCENARIOS for f in DRIVERS]
    alarm = round(threshold([probabilities(network, found) for found in tests], tests), 4)
    card = {
        "what": f"Probability that the wheel stops for good within {HORIZONS[0]:g} and "
        f"{HORIZONS[1]:g} s of driving",
        "command": "python -m soil_env_agents.warning --out FILE",
        "scales": list(SCALES),
        "version": soil_env.__version__,
        "scenarios": list(SCENARIOS),
        "families": list(FAMILIES),
        "sets": SETS,
        "sizes": vars(sizes),
        "rows_of_training": len(seconds),
        "alarm": "probability within 5 s at which the alarm is false for 5 % of the driving time "
        "on finished courses",
    }
    # Seven digits, about as many as the float32 of torch has.
    rounded = np.vectorize(lambda x: float(f"{x:.7g}"))
    arrays = {name: rounded(array) for name, array in network._asdict().items()}
    return {"card": card, "alarm": alarm, "inputs": list(INPUTS), **arrays}


@click.command()
@click.option("--out", type=PATH, required=True, metavar="FILE", help="The weights, .json.")
@click.option(
    "--courses", type=click.IntRange(4), help="Of each scenario and family (default 900)."
)
def command(out: Path, courses: int | None) -> None:
    """Train the probability of immobilisation."""
    if out.suffix != ".json":
        raise ParameterError(f"--out {out}: expected a file NAME.json")
    make_folder(out.parent)
    check_outputs(out.parent, (out.name,))
    # Few courses, for a trial: learn from more of their periods, in fewer passes.
    sizes = Sizes() if courses is None else Sizes(courses, courses, 0.5, 2)
    write_json(out, train(sizes), indent=None)
    show(f"Written: {out}")


if __name__ == "__main__":
    raise SystemExit(run(command, None, "warning"))
