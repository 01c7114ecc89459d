"""Train an agent and compare it with slip controllers: `python train.py --help`, the same as
`soil-env train`.
"""

from collections.abc import Sequence


def _command():
    """The click command."""
    from soil_env_agents.train import command

    return command


def main(arguments: Sequence[str] | None = None) -> int:
    """Run with these arguments, by default those of the process; return the exit status."""
    from soil_env.cli.running import run

    return run(_command, arguments, "train.py")


if __name__ == "__main__":
    status = main()
    from soil_env.cli.running import leave

    leave(status)
