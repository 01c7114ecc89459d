"""Train a PPO agent on randomised soil and compare it with slip controllers at avoiding immobilisation.

This is train.py of the clone, for an installed package: the run trains the agent, tunes the classical controllers on
courses of their own, drives all of them over the same held-out courses, prints the comparison, and says where the wall
time went. Everything is kept in one run folder.

Examples:
    python -m agents.train                                      the default: observation "identified", scenario "mixed"
    python -m agents.train --observation blind --timesteps 5e6  any key of the config; nested ones as --ppo.gamma 0.995
    python -m agents.train --changes.course.length 20           any key of the scenario
    python -m agents.train --resume runs/NAME                   go on with a run that was interrupted or killed
"""

from __future__ import annotations

from soil_env._io.commands import leave


def main(arguments: list[str] | None = None) -> int:
    """Run with the given command line, sys.argv's by default; returns the exit status."""
    try:
        from agents.cli import main as run  # torch takes seconds to import: an interrupt then ends quietly too

        return run(arguments, description=__doc__)
    except KeyboardInterrupt:
        return 130


if __name__ == "__main__":
    leave(main())
