"""Record a data set of driven courses with Minari, and replay it.

    pip install "soil_env[minari]"                        brings jax, which Minari records with
    python examples/minari_dataset.py
    python examples/minari_dataset.py --controller full_throttle --episodes 20

This is `python -m soil_env_agents.dataset` for one classical controller; that command also takes agents, and several of
them. Data sets lie in ~/.minari/datasets, or where MINARI_DATASETS_PATH says.
"""

import argparse
import sys

import numpy as np

from soil_env_agents import dataset
from soil_env_agents.controllers import CONTROLLERS
from soil_env_agents.extras import needing

with needing("minari", "minari_dataset.py"):
    import minari


def main() -> int:
    """Record, replay, say what came back."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--controller", choices=sorted(CONTROLLERS), default="best_slip_identified")
    p.add_argument("--episodes", type=int, default=5)
    options = p.parse_args()
    status = dataset.main([f"--controllers={options.controller}", f"--episodes={options.episodes}"])
    if status:
        return status
    episodes = minari.load_dataset(f"soil/{options.controller}-v0")
    slip = np.concatenate([episode.observations[:, 0] for episode in episodes])
    print(f"{episodes.total_episodes} courses, {episodes.total_steps} steps, mean slip {slip.mean():.2f}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
