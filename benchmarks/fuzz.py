"""Random configurations, random and extreme commands: no NaN, no exception, and the invariants hold.

    python -m benchmarks.fuzz --steps 1e6 --seed 0                 a minute or two; prints what was covered
    python -m benchmarks.fuzz --steps 1e6 --page docs/reliability.md   and puts it into the page
    python -m benchmarks.fuzz --seed 0 --case 17                   one case alone, to look into what it broke

A case is a valid configuration (`fuzz_cases`): scenario, wheel, soils, course, noise, belief, limits, control, action
mode, observation, effects. Its wheels are driven side by side by commands of every kind; every eighth case a single
environment too. What must hold is in `fuzz_checks`. Commands that are no numbers must be refused with ValueError and
change nothing.
"""

from __future__ import annotations

import math
import time
import traceback
from collections import Counter
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from gymnasium.vector import AutoresetMode

from benchmarks.common import check_page, renew_page
from benchmarks.fuzz_cases import Case, Random, draw_case
from benchmarks.fuzz_checks import faults, ledger
from soil_env._io.commands import command_line, command_parser, leave, whole_number
from soil_env._io.document import Table
from soil_env._io.loading import ParameterError
from soil_env.env import SoilWheelEnv
from soil_env.simulation.task import Cause
from soil_env.vector_env import SoilWheelVectorEnv

WHEELS, STEPS = 64, 50  # of a case
SINGLE = 30  # steps of the single environment
REFUSED = (math.nan, math.inf, -math.inf)


@dataclass
class Tally:
    """Coverage and violations."""

    steps: int = 0
    cases: int = 0
    refused: Counter = field(default_factory=Counter)  # by reason
    kinds: Counter = field(default_factory=Counter)  # what the cases were like
    causes: Counter = field(default_factory=Counter)  # of episode ends
    broken: list = field(default_factory=list)  # (case, what)
    not_converged: int = 0  # control periods
    gaps: list = field(default_factory=list)  # shares of the turnover, of one case each: (median, largest)


# --- one case ---------------------------------------------------------------------------------------------------------


def commands(rng: np.random.Generator, wheels: int, step: int) -> np.ndarray:
    """Commands [wheels, 1] of every kind, the same kind for a wheel throughout."""
    a = rng.uniform(-1.3, 1.3, wheels)
    kind = np.arange(wheels) % 8
    a[kind == 1] = 1.0
    a[kind == 2] = -1.0
    a[kind == 3] = 0.4
    a[kind == 4] = 0.0
    a[kind == 5] = (-1.0) ** step * 1e300
    a[kind == 6] = math.sin(0.3 * step)
    return a[:, None]


def run_case(case: Case, rng: np.random.Generator, tally: Tally, wheels: int = WHEELS, steps: int = STEPS) -> list[str]:
    """Drive one case; its violations, in words. ParameterError where its courses cannot be passed."""
    modes = [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP]
    mode = modes[int(rng.integers(2))]
    env = SoilWheelVectorEnv(
        wheels, case.scenario, case.observation, model=case.model, threads=1, autoreset_mode=mode,
        max_episode_steps=int(rng.integers(5, 200)) if rng.random() < 0.3 else None,
    )  # fmt: skip
    broken: list[str] = []
    observation, _ = env.reset(seed=int(rng.integers(1 << 30)))
    if not all(env.single_observation_space.contains(row) for row in observation):
        broken.append("first observation in its bounds")
    broken += _refusals(env, wheels, rng)
    done, shares = np.zeros(wheels, dtype=bool), []
    for step in range(steps):
        actions, before = commands(rng, wheels, step), env.simulation.worlds.state.copy()
        out = env.step(actions)
        ended = out[2] | out[3]
        cause = out[4].get("final_info", out[4])["cause"]  # in SAME_STEP mode `info` is of after the reset
        tally.causes.update(Cause(c).name for c in cause[ended])
        tally.steps += wheels - int(done.sum())
        if mode == AutoresetMode.SAME_STEP:  # the state is that of the new course already
            stepped, done = ~ended, np.zeros(wheels, dtype=bool)
            before.data[:, :wheels][:, ended] = env.simulation.worlds.state.data[:, :wheels][:, ended]
        else:
            stepped, done = ~done, ended
        found = faults(env, actions, before, stepped, out)
        broken += [f"{name} (step {step}, wheel {which[0]})" for name, which in found.items()]
        if stepped.any():
            broken += _energy(env, before, stepped, case, tally, shares, step)
    tally.gaps.append((float(np.median(shares)), float(np.max(shares))) if shares else (0.0, 0.0))
    env.close()
    return broken


def _refusals(env, wheels: int, rng) -> list[str]:
    """Commands that are no numbers, or of another shape: ValueError, and nothing has changed."""
    broken, state = [], env.simulation.worlds.state.tobytes()
    bad: list = [np.zeros((wheels + 1, 1)), np.zeros(wheels), np.full((wheels, 1), None)]
    for value in REFUSED:
        one = np.zeros((wheels, 1))
        one[int(rng.integers(wheels))] = value
        bad.append(one)
    for actions in bad:
        try:
            env.step(actions)
            broken.append(f"command {actions.flat[0]!r} of shape {actions.shape} refused")
        except ValueError:
            pass
    if env.simulation.worlds.state.tobytes() != state:
        broken.append("a refused command changes nothing")
    return broken


def _energy(env, before, stepped, case: Case, tally: Tally, shares: list, step: int) -> list[str]:
    """The energy balance of the wheels that were driven."""
    worlds = env.simulation.worlds
    balance = ledger(before, worlds, case.scenario)
    sure = stepped & (worlds.counts["converged"] == 1)
    tally.not_converged += int(np.sum(stepped & ~sure))
    slack = balance.tolerance + 1e-9 * balance.turnover
    gap, turnover = balance.gap, balance.turnover + 1e-9
    shares.extend((np.abs(gap) / turnover)[sure & (turnover > 1e-6)].tolist())
    found = {
        "motor work = work against resistance, grade and inertia": sure & (np.abs(gap - balance.integrator) > slack)
    }
    # A residual law is no law of nature; the thrust of lugs acts beyond the rim by which their slip is counted.
    if case.model is None or not (case.model.residual or "blades" in case.model.effects.get("grousers", {})):
        found["soil and drivetrain take work, never give it"] = sure & (balance.soil < -slack - 1e-6 * turnover)
    return [f"{name} (step {step}, wheel {np.flatnonzero(which)[0]})" for name, which in found.items() if which.any()]


def run_single(case: Case, rng: np.random.Generator, steps: int = SINGLE) -> list[str]:
    """Drive the single environment; its violations."""
    env, broken = SoilWheelEnv(case.scenario, case.observation, model=case.model), []
    observation, info = env.reset(seed=int(rng.integers(1 << 30)))
    for step in range(steps):
        if not env.observation_space.contains(observation):
            broken.append(f"single: observation in its bounds (step {step})")
        numbers = [v for key in ("state", "traversability") for v in info[key].values()]
        if not all(math.isfinite(v) for v in numbers):
            broken.append(f"single: info finite (step {step})")
        action = commands(rng, 8, step)[step % 8]
        observation, reward, terminated, truncated, info = env.step(action)
        if not (math.isfinite(reward) and math.isclose(reward, sum(info["reward_terms"].values()), abs_tol=1e-12)):
            broken.append(f"single: reward is the sum of its terms (step {step})")
        if terminated or truncated:
            observation, info = env.reset()
    env.close()
    return broken


# --- many cases -------------------------------------------------------------------------------------------------------


def run(seed: int, steps: int, only: int | None = None, say=lambda text: None) -> Tally:
    """Cases until `steps` steps are driven; `only`: that case alone."""
    tally, number = Tally(), 0 if only is None else only
    told = time.perf_counter()
    while tally.steps < steps:
        rng = np.random.default_rng([seed, number])
        try:
            case = draw_case(Random(rng))
            broken = run_case(case, rng, tally)
            if number % 8 == 0:
                broken += run_single(case, rng)
            tally.cases += 1
            _note(case, tally)
        except ParameterError as error:
            broken = []
            tally.refused["no passable course" if "no passable course" in str(error) else "contradicting numbers"] += 1
        except Exception as error:  # this is what is looked for
            where = traceback.extract_tb(error.__traceback__)[-1]
            broken = [f"{type(error).__name__}: {error} ({Path(where.filename).name} line {where.lineno})"]
        tally.broken += [(number, what) for what in broken]
        for what in broken[:3]:
            say(f"case {number}: broken: {what}")
        if time.perf_counter() - told > 10.0:
            told = time.perf_counter()
            say(f"{tally.steps:,} of {steps:,} steps, {tally.cases} cases, {len(tally.broken)} broken")
        number += 1
        if only is not None:
            break
    return tally


def _note(case: Case, tally: Tally) -> None:
    s, m = case.scenario, case.model
    tally.kinds.update([f"action {s.control.action}", f"observation {case.observation}", f"scenario {s.name}"])
    tally.kinds.update(f"soil {name}" for name in s.soils)
    tally.kinds["noise none" if s.noise.slip == 0.0 else "noise"] += 1
    if m is not None:
        tally.kinds.update(["model", *(f"effect {name}" for name in m.effects)])
        tally.kinds["model with a residual law"] += bool(m.residual)
        tally.kinds["model with its own soil"] += m.soil is not None


def summary(tally: Tally, seed: int) -> str:
    """Coverage and violations, as Markdown."""
    k, share = tally.kinds, np.array(tally.gaps or [(0.0, 0.0)])

    def many(prefix: str) -> str:
        found = [(name.removeprefix(prefix), n) for name, n in sorted(k.items()) if name.startswith(prefix)]
        return ", ".join(f"{name} {n}" for name, n in found)

    soils_met = sum(name.startswith("soil ") for name in k)
    effects_met = sum(name.startswith("effect ") for name in k)
    ends = ", ".join(f"{name} {n:,}" for name, n in sorted(tally.causes.items()))
    refused = ", ".join(f"{n} for {name}" for name, n in sorted(tally.refused.items())) or "none"
    law, own = k["model with a residual law"], k["model with its own soil"]
    rows = [
        ("steps", f"{tally.steps:,}"),
        ("configurations", f"{tally.cases} driven; refused with one line: {refused}"),
        ("action, observation", f"{many('action ')}; {many('observation ')}"),
        ("scenario that was changed", many("scenario ")),
        ("soils", f"{soils_met} presets"),
        ("effects", f"in {k['model']} configurations, {effects_met} different ones; "
                    f"{law} with a residual law, {own} with a soil"),
        ("episode ends", ends or "none"),
        ("exceptions, NaN, broken invariants", f"{len(tally.broken)}"),
        ("control periods not converged", f"{tally.not_converged}"),
        ("energy that the integrator takes or gives, of the turnover",
         f"median of the configurations {np.median(share[:, 0]):.1e}, 90 % of them below "
         f"{np.quantile(share[:, 0], 0.9):.1e}"),
    ]  # fmt: skip
    return Table((f"`--seed {seed}`", ""), rows).markdown()


@command_line("benchmarks.fuzz")
def main(arguments: list[str] | None = None) -> int:
    """The command line; returns the exit status."""
    p = command_parser(
        "python -m benchmarks.fuzz", __doc__,
        status="exit status: 0 all held, 1 something was broken, 2 bad input, 130 interrupted.",
    )  # fmt: skip
    p.add_argument("--steps", type=whole_number(1), default=10**6, help="in all (default 1e6)")
    p.add_argument("--seed", type=whole_number(), default=0, help="of the cases (default 0)")
    p.add_argument("--case", type=whole_number(), metavar="N", help="this case alone")
    p.add_argument("--page", type=Path, metavar="MD", help="put the result between the markers of this page")
    options = p.parse_args(arguments)
    if options.page is not None:
        check_page(options.page, "fuzz")  # before the work
    tally = run(options.seed, options.steps, options.case, lambda text: print(text, flush=True))
    text = summary(tally, options.seed)
    if options.page is not None:
        renew_page(options.page, {"fuzz": text})
    print(text)
    return 1 if tally.broken else 0


if __name__ == "__main__":
    leave(main())
