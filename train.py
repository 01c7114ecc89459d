"""Train a PPO agent and compare it with slip controllers: `python train.py --help`.

The command is that of agents/train.py; `python train.py --config configs/smoke.yaml` does everything in seconds.
"""


def main(arguments: list[str] | None = None) -> int:
    """Run with the given command line, sys.argv's by default; returns the exit status."""
    from agents.train import main as run

    return run(arguments)


if __name__ == "__main__":
    status = main()
    from soil_env._io.commands import leave

    leave(status)
