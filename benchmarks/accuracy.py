"""How accurate the time step and the quadrature over the contact arc are.

    python -m benchmarks.accuracy

prints three Markdown tables. Time step: 10 s of 48 courses of `mixed` (seeds 0 ... 47) without halts, from 4 m after
their start on, by the default step, against steps 32 times as short under the same commands: error of the distance x
(root mean square over time, over the largest distance from where the wheel began; median and 90 % of the courses),
motor work over that of the short steps, and the share of it that the integrator takes (medians). Halving: the same
error of x, sinkage and speed over 30 s of the smooth torque, of the default step against half of it, and on how many
courses one of the three is over 1 %. Quadrature: the 8 nodes a zone against Simpson's rule with 8000 subintervals a
zone, for 1000 random arcs a row: error of drawbar pull and of torque over radius, whichever is larger, over the load.
"""

from __future__ import annotations

import numpy as np

from soil_env._io.commands import command_line, command_parser, leave
from soil_env.simulation.world.terrain import cell_at
from soil_env.slip import travel_speeds
from soil_env.terramechanics.arc_integrals import arc_integrals, simpson_integrals
from soil_env.terramechanics.contact import forces
from soil_env.vector_env import SoilWheelVectorEnv

WHEELS, PERIODS, FINER, START, ARCS = 48, 100, 32, 4.0, 1000
SMOOTH = "smooth torque"
TAN_PHI, RADIUS, WIDTH = 0.6, 0.15, 0.15


def commands(name: str, wheels: int, periods: int = PERIODS) -> np.ndarray:
    """Commands [periods, wheels]: "smooth", "policy", or the number of periods between full reversals."""
    rng, k = np.random.default_rng(1), np.arange(periods)[:, None]
    size = rng.uniform(0.2, 1.0, (periods, wheels))
    if name == "smooth":
        return np.broadcast_to(0.22 + 0.06 * np.sin(0.1 * k), (periods, wheels))
    if name == "policy":
        return np.clip(0.4 + 0.2 * rng.standard_normal((periods, wheels)), -1.0, 1.0)
    every = int(name)
    return np.where(k // every % 2, -1.0, 1.0) * size[k[:, 0] // every * every]


def drive(
    given: np.ndarray, finer: int, action: str = "torque", start: float = START
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """(x, sinkage and speed [periods, 3, wheels], motor work, work of the integrator [wheels]) from `start` on.

    The steps are `finer` times as short as by default. The motor work is NaN where the episode ended.
    """
    wheels = given.shape[1]
    far = {"no_progress_time": 1000.0, "bogged_sinkage": 1.4}
    env = SoilWheelVectorEnv(
        wheels,
        "mixed",
        observation="blind",
        action=action,
        course={"halt_time": 0.0},
        limits=far,
        control={"substep": 0.1 / finer},
    )
    env.reset(seed=0)
    if start > 0.0:
        for k in range(wheels):
            env.simulation.complete(k)
            env.simulation.worlds.counts.cell[k] = cell_at(env.simulation.worlds.courses, start)
        for name in ("x", "best_x", "lowest_x", "mark_x", "cell_x"):
            env.simulation.worlds.state[name] = start
    state, rows, work, taken = env.simulation.worlds.state, [], np.zeros(wheels), np.zeros(wheels)
    over = np.zeros(wheels, dtype=bool)
    for row in given:
        _, _, terminated, truncated, _ = env.step(row[:, None])
        over |= terminated | truncated
        rows.append(np.array((state.x - start, state.sinkage, state.speed)))
        work, taken = work + state.motor_work, taken + state.numerical_work
    env.close()
    work[over] = np.nan
    return np.array(rows), work, taken


def apart(moved: np.ndarray, exact: np.ndarray) -> np.ndarray:
    """Root mean square of the difference over time, over the peak: of x, sinkage and speed [3, wheels]."""
    return np.sqrt(np.mean((moved - exact) ** 2, axis=0)) / np.abs(exact).max(axis=0)


def time_step(wheels: int) -> None:
    """Print the table of the time step."""
    print("| commands | x, median | x, 90 % | motor work | taken by the integrator |\n|---|---|---|---|---|")
    rows = [(SMOOTH, "smooth", "torque"), ("torque 0.4 +- 0.2 at random, every 0.1 s", "policy", "torque")]
    for action, text in (("torque", "full reversals"), ("wheel_speed", "`wheel_speed` reversed")):
        rows += [(f"{text} every {0.1 * k:.1f} s", str(k), action) for k in (1, 2, 5)]
    for text, name, action in rows:
        (moved, work, taken), (exact, exact_work, _) = (
            drive(commands(name, wheels), finer, action) for finer in (1, FINER)
        )
        stayed = np.isfinite(work + exact_work)
        off, share = apart(moved, exact)[0, stayed], np.abs(taken / work)[stayed]
        cells = [f"{100 * np.median(off):.2f} %", f"{100 * np.quantile(off, 0.9):.1f} %"]
        cells += [f"{np.median((work / exact_work)[stayed]):.3f}", f"{100 * np.median(share):.1f} %"]
        print(f"| {text}, {stayed.sum()} courses | " + " | ".join(cells) + " |")


def halving(wheels: int, periods: int) -> None:
    """Print the table of the halved step: median and largest change of x, sinkage and speed."""
    print(f"\n| the step halved, {0.1 * periods:g} s of {SMOOTH} | x | sinkage | speed | one of them over 1 % |")
    print("|---|---|---|---|---|")
    for start, text in ((0.0, "from the start"), (START, f"from {START:g} m on")):
        (moved, work, _), (half, half_work, _) = (
            drive(commands("smooth", wheels, periods), finer, start=start) for finer in (1, 2)
        )
        off = 100.0 * apart(moved, half)[:, np.isfinite(work + half_work)]
        cells = [f"{np.median(values):.2f} %, at most {values.max():.1f} %" for values in off]
        over = (off > 1.0).any(axis=0)
        print(f"| {text} | " + " | ".join(cells) + f" | {over.sum()} of {over.size} courses |")


def quadrature(slips: tuple[float, float], ratios: tuple[float, float], rng, arcs: int = ARCS) -> np.ndarray:
    """Error of the forces over the load [arcs], for slips and for K/r drawn from these ranges."""
    out = []
    for _ in range(arcs):
        entry, slip, n = rng.uniform(0.2, 1.3), rng.uniform(*slips), rng.uniform(0.3, 1.5)
        rim, travel = 1.0, float(travel_speeds(1.0, slip))
        K, at = RADIUS * np.exp(rng.uniform(*np.log(ratios))), (entry, 0.0, 0.5 * entry)
        f, exact = (
            forces(q, 1.0, TAN_PHI, 0.0, RADIUS, WIDTH, 1.0)
            for q in (
                arc_integrals(*at, rim, travel, K, n, RADIUS)[0],
                simpson_integrals(*at, rim, travel, K, n, RADIUS, 4000)[0],
            )
        )  # fmt: skip
        off = max(abs(f.drawbar_pull - exact.drawbar_pull), abs(f.torque - exact.torque) / RADIUS)
        out.append(off / abs(exact.load))
    return np.array(out)


@command_line("benchmarks.accuracy")
def main(arguments: list[str] | None = None) -> int:
    """Print the tables; returns the exit status."""
    p = command_parser("python -m benchmarks.accuracy", __doc__)
    p.add_argument("--smoke", action="store_true", help="every part in seconds, numbers without meaning")
    smoke = p.parse_args(arguments).smoke
    wheels, periods, arcs = (4, 20, 5) if smoke else (WHEELS, 300, ARCS)
    time_step(wheels)
    halving(wheels, periods)
    print("\n| slip | K/r | median | 90 % | largest |\n|---|---|---|---|---|")
    for slips in ((0.02, 0.95), (-0.95, -0.02)):
        for ratios in ((0.02, 0.05), (0.05, 0.1), (0.1, 0.3)):
            off = quadrature(slips, ratios, np.random.default_rng(0), arcs)
            cells = [f"{value:.1e}" for value in (np.median(off), np.quantile(off, 0.9), off.max())]
            print(f"| {slips[0]:g} to {slips[1]:g} | {ratios[0]:g} to {ratios[1]:g} | " + " | ".join(cells) + " |")
    return 0


if __name__ == "__main__":
    leave(main())
