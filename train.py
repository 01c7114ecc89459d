"""Train a PPO agent on randomised soil and compare it with slip controllers at avoiding immobilisation.

The run trains the agent, tunes the classical controllers on courses of their own, drives all of them over the same
held-out courses, prints the comparison, and says where the wall time went. On two cores the defaults take a few
minutes. Everything is kept in one run folder.

Examples:
    python train.py                                      the default: observation "identified", scenario "mixed"
    python train.py --config configs/smoke.yaml          a run of seconds, to see that everything works
    python train.py --observation blind --timesteps 5e6  any key of the config; nested ones as --ppo.gamma 0.995
    python train.py --changes.course.length 20           any key of the scenario
    python train.py --resume runs/NAME                   go on with a run that was interrupted or killed
"""


def main(arguments: list[str] | None = None) -> int:
    """Run with the given command line, sys.argv's by default; returns the exit status."""
    from agents.cli import main as run

    return run(arguments, description=__doc__)


if __name__ == "__main__":
    status = main()
    from soil_env._io.commands import leave

    leave(status)
