"""Train the probability of immobilisation that is shipped in soil_env/identification/online/immobilisation.json.

Drives of several families of drivers over the scenarios are recorded, and a network learns two hazards from them: to be
immobilised within 3 s, and within 5 s if not before (discrete hazards, Gensheimer & Narasimhan 2019, PeerJ 7:e6257).
The threshold of the alarm is set on other courses, so that it is false for 5 % of the driving time on finished ones.
docs/results/warning.json has what it is worth: area under the ROC curve 0.92, a logistic of the same inputs 0.82.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import click
import numpy as np

import soil_env
from soil_env._io.files import check_outputs, write_json
from soil_env.cli.running import PATH, leave, run
from soil_env.env import IMMOBILISED
from soil_env.identification.online.immobilisation import (
    HORIZONS,
    INPUTS,
    LARGEST,
    SCALES,
    ImmobilisationWarning,
    Network,
    score_inputs,
)  # fmt: skip
from soil_env.parameters import Scenario, load_scenario
from soil_env.simulation.task import Cause

from .cli import needing_training
from .controllers import CONTROLLERS, Controller
from .evaluate.driving import drive
from .evaluate.warning import Alarm
from .progress import show

#: Course sets, disjoint from each other and from those of `agents.evaluate`.
TRAINING_SET, TUNING_SET, TEST_SET = 5_000_011, 6_000_011, 7_000_003
SCENARIOS = ("two_lines", "mixed", "sticky", "loose_slopes", "field_vehicle")
BLOCK = 300  # courses driven side by side
FALSE = 0.05  # share of the driving time on finished courses under alarm
UNKNOWN = 5.0  # [s] before the last progress of a course cut by the time limit, from which on its outcome is not known
HIDDEN, RATE, DECAY, BATCH = (64, 32), 1e-2, 1e-3, 4096
_STUCK = [cause.value for cause in IMMOBILISED]

# --- drivers ----------------------------------------------------------------------------------------------------------

FAMILIES = ("constant_speed", "soft_start", "slip", "random_speed", "random_throttle", "full_throttle", "best_slip")
#: Families that somebody might drive with. The random ones bring the wheel into states that good drivers avoid.
DRIVERS = tuple(name for name in FAMILIES if not name.startswith("random"))
_AT_ONCE = 100.0  # [m/s2]: no ramp


class Random(Controller):
    """Rim speeds drawn anew every 0.3 to 5 s on average, one in ten backwards; with `throttle` torques."""

    def __init__(self, scenario: Scenario, rng: np.random.Generator, count: int, throttle: bool):
        super().__init__(scenario)
        self.rng, self.throttle, self.level = rng, throttle, rng.uniform(0.0, 1.0, count)
        self.mean = np.exp(rng.uniform(np.log(0.3), np.log(5.0), count))  # [s]

    def beside(self, batch):
        """Either line with equal chance."""
        return self.rng.random(len(batch)) < 0.5

    def rim_speed(self, observation, state):
        """The level of this control period, of the top rim speed."""
        backwards, new, change = self.rng.random((3, len(self.level)))
        drawn = np.where(backwards < 0.1, -0.4, new)
        self.level = np.where(change < self.period / self.mean, drawn, self.level)
        return self.level * self.top_speed

    def command(self, batch, rim_speed, state):
        """Actions that follow the rim speed, or the level itself."""
        if self.throttle:
            return (rim_speed / self.top_speed).astype(np.float32)[:, None]
        return super().command(batch, rim_speed, state)


def make_driver(family: str, scenario: Scenario, seed: Sequence[int], count: int) -> Controller:
    """A driver of a family, each of `count` courses with settings of its own that `seed` draws."""
    rng, top = np.random.default_rng([*seed, FAMILIES.index(family)]), Controller(scenario).top_speed

    def share(low: float, high: float) -> np.ndarray:
        return rng.uniform(low, high, count) * top

    start = share(0.05, 0.4)
    match family:
        case "constant_speed":
            settings = {"speed": share(0.05, 0.9)}
        case "soft_start":
            rate = np.exp(rng.uniform(np.log(0.04), np.log(0.7), count)) * top
            settings = {"acceleration": rate, "speed": share(0.2, 0.95)}
        case "slip":
            family, cap = "slip_limiter", np.maximum(share(0.3, 0.95), start)
            slip = rng.uniform(0.05, 0.7, count)
            settings = {"slip": slip, "start": start, "acceleration": _AT_ONCE, "speed": cap}
        case "best_slip":
            family = "best_slip_identified"
            settings = {"start": 0.1 * top, "acceleration": _AT_ONCE, "speed": 0.4 * top}
        case "full_throttle":
            settings = {}
        case _:
            return Random(scenario, rng, count, family == "random_throttle")
    return CONTROLLERS[family](scenario, **settings)


# --- drives -----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Drives:
    """Courses driven side by side; arrays [periods, courses] unless stated otherwise."""

    period: float  # [s]
    inputs: np.ndarray  # [periods, courses, inputs] float32
    alive: np.ndarray  # bool
    driving: np.ndarray  # bool: alive, and not at a halt
    best: np.ndarray  # [m] furthest point
    cause: np.ndarray  # [courses] `task.Cause`
    least: float  # [m] of progress in a control period at the least mean speed that the task asks for
    stretch: float  # [m] that the wheel has to get further within the limit of no progress

    def since(self, period: np.ndarray) -> np.ndarray:
        """Time spent driving [s] from the control periods `period` [courses] to each period."""
        clock = np.cumsum(self.driving, axis=0) * self.period
        return clock - np.take_along_axis(clock, period[None], axis=0)

    @property
    def ahead(self) -> np.ndarray:
        """Seconds of driving until the wheel stops for good, not positive from there on, +inf where it never does."""
        mobile = self.driving & (np.diff(self.best, axis=0, prepend=0.0) >= self.least)
        last = np.where(mobile.any(axis=0), len(mobile) - 1 - np.argmax(mobile[::-1], axis=0), 0)
        return np.where(np.isin(self.cause, _STUCK), -self.since(last), np.inf)

    @property
    def known(self) -> np.ndarray:
        """Periods whose outcome is known: all but the last of a course that was cut by the time limit."""
        near = np.argmax(self.driving & (self.best >= self.best[-1] - self.stretch), axis=0)
        return self.alive & ~((self.cause == Cause.TIME_LIMIT.value) & (self.since(near) > -UNKNOWN))

    def false(self, probability: np.ndarray, threshold: float) -> tuple[float, float]:
        """(time under alarm [s], time driven [s]) on finished courses, at a threshold of the probability."""
        passed = self.cause == Cause.FINISHED.value
        alarm, under = Alarm(len(passed), self.period, threshold), 0
        for p, driving in zip(probability, self.driving, strict=True):
            alarm.step(p, driving)
            under += int((alarm.on & driving & passed).sum())
        return under * self.period, float(self.driving[:, passed].sum()) * self.period


def drives(scenario: str, family: str, seed: int, first: int, count: int) -> Drives:
    """Drive courses `first` ... `first + count - 1` of set `seed` by torque."""
    task = load_scenario(scenario, {"control": {"action": "torque"}})
    warning, rows, kept = ImmobilisationWarning(task), np.arange(count), []
    driver = make_driver(family, task, [seed, first], count)
    for sim, alive in drive(driver, task, seed, first, count, threads=1, warnings=True):
        worlds = sim.worlds
        inputs = warning.inputs(rows, worlds.recent, worlds.ids.estimate, worlds.ids.sd).astype(np.float32)
        driving = alive & (worlds.state["halt_left"] == 0.0)
        kept.append((inputs, alive.copy(), driving, worlds.state["best_x"].copy()))
    limits, period = task.limits, task.control.period
    least = limits.no_progress_distance / limits.no_progress_time * period
    arrays = (np.array(column) for column in zip(*kept, strict=True))
    return Drives(period, *arrays, worlds.cause.copy(), least, limits.no_progress_distance)


# --- the network ------------------------------------------------------------------------------------------------------


def fit(inputs: np.ndarray, ahead: np.ndarray, epochs: int, seed: int = 0) -> Network:
    """Weights of highest likelihood, with weight decay; each output is the log-odds of one hazard.

    `inputs` [n, inputs] and seconds `ahead` [n]. The first hazard is learnt from all rows, the second from those that
    are not immobilised within the first horizon.
    """
    import torch

    torch.manual_seed(seed)
    mean, scale = inputs.mean(axis=0), 1.0 / (inputs.std(axis=0) + 1e-6)
    x = torch.from_numpy(np.clip((inputs - mean) * scale, -LARGEST, LARGEST).astype(np.float32))
    early, late = (torch.from_numpy((ahead <= h).astype(np.float32)) for h in HORIZONS)
    sizes = (x.shape[1], *HIDDEN, len(HORIZONS))
    layers = [torch.nn.Linear(a, b) for a, b in zip(sizes[:-1], sizes[1:], strict=True)]
    model = torch.nn.Sequential(layers[0], torch.nn.Tanh(), layers[1], torch.nn.Tanh(), layers[2])
    optimizer = torch.optim.AdamW(model.parameters(), lr=RATE, weight_decay=DECAY)
    steps = epochs * -(-len(x) // BATCH)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimizer, RATE, total_steps=steps + 1)
    loss_of = torch.nn.functional.binary_cross_entropy_with_logits
    for _ in range(epochs):
        for batch in torch.randperm(len(x)).split(BATCH):
            out, y = model(x[batch]), early[batch]
            later = loss_of(out[:, 1], late[batch], reduction="none") * (1.0 - y)
            loss = (loss_of(out[:, 0], y, reduction="none") + later).mean()
            optimizer.zero_grad()
            loss.backward()
            optimizer.step()
            schedule.step()
    arrays = [a for layer in layers for a in (layer.weight.detach().numpy().T, layer.bias.detach().numpy())]
    return Network(*(np.ascontiguousarray(a, dtype=np.float64) for a in (mean, scale, *arrays)))


def probabilities(network: Network, found: Drives) -> np.ndarray:
    """Probability within the longer horizon [periods, courses]; 0 where a course has ended."""
    out = np.zeros(found.alive.shape)
    out[found.alive] = score_inputs(found.inputs[found.alive], network)[:, -1]
    return out


def threshold(scores: Sequence[np.ndarray], found: Sequence[Drives]) -> float:
    """The lowest threshold, to a thousandth, at which the alarm is false for at most `FALSE` of the driving time."""
    low, high = 0.0, 1.0
    for _ in range(10):
        middle = 0.5 * (low + high)
        under, driven = np.sum([d.false(s, middle) for s, d in zip(scores, found, strict=True)], axis=0)
        low, high = (middle, high) if under > FALSE * driven else (low, middle)
    return high


def train(courses: int, tuning: int, share: float, epochs: int) -> dict:
    """The content of immobilisation.json: drive `courses` of each scenario and family (a third of the random ones),
    learn a `share` of their control periods, and set the threshold on `tuning` courses of each."""
    rng, inputs, ahead = np.random.default_rng(TRAINING_SET), [], []
    for scenario in SCENARIOS:
        for family in FAMILIES:
            show(f"{scenario}, {family}")
            count = courses if family in DRIVERS else max(1, courses // 3)
            for first in range(0, count, BLOCK):
                found = drives(scenario, family, TRAINING_SET, first, min(BLOCK, count - first))
                chosen = found.known & (rng.random(found.known.shape) < share)
                inputs.append(found.inputs[chosen])
                ahead.append(found.ahead[chosen].astype(np.float32))
    rows, seconds = np.concatenate(inputs), np.concatenate(ahead)
    order = rng.permutation(len(seconds))
    show(f"fit of {len(seconds):,} rows")
    network = fit(rows[order], seconds[order], epochs)
    tests = [drives(scenario, family, TUNING_SET, 0, tuning) for scenario in SCENARIOS for family in DRIVERS]
    alarm = round(threshold([probabilities(network, found) for found in tests], tests), 4)
    card = {
        "what": f"Probability that the wheel stops for good within {HORIZONS[0]:g} and {HORIZONS[1]:g} s of driving",
        "command": "python -m agents.warning --out soil_env/identification/online/immobilisation.json",
        "scales": list(SCALES),
        "version": soil_env.__version__,
        "scenarios": list(SCENARIOS),
        "families": list(FAMILIES),
        "sets": {"training": TRAINING_SET, "tuning": TUNING_SET, "test": TEST_SET},
        "sizes": {"training": courses, "tuning": tuning, "share": share, "epochs": epochs},
        "rows_of_training": len(seconds),
        "alarm": "probability within 5 s at which the alarm is false for 5 % of the driving time on finished courses",
    }
    arrays = {name: np.vectorize(lambda x: float(f"{x:.7g}"))(array) for name, array in network._asdict().items()}
    return {"card": card, "alarm": alarm, "inputs": list(INPUTS), **arrays}


@click.command("warning")
@click.option("--out", type=PATH, metavar="FILE", required=True, help="File of the weights.")
@click.option("--smoke", is_flag=True, help="Run every part in a minute; the weights mean nothing.")
def command(out: Path, smoke: bool) -> None:
    """Train the probability of immobilisation that the package ships."""
    check_outputs(out.parent, (out.name,))
    with needing_training():
        import torch
    torch.set_num_threads(1)
    sizes = {"courses": 12, "tuning": 12, "share": 0.5, "epochs": 2} if smoke else {
        "courses": 2400, "tuning": 300, "share": 0.06, "epochs": 10}  # fmt: skip
    write_json(out, train(**sizes), indent=None)
    show(f"Written: {out}")


if __name__ == "__main__":
    leave(run(command, None, "agents.warning"))
