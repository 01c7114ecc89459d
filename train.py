"""Train a PPO agent on randomised soil and compare it with slip controllers at avoiding immobilisation.

Examples:
    python train.py                                      the default: observation "identified", scenario "mixed"
    python train.py --config configs/smoke.yaml          a run of seconds, to see that everything works
    python train.py --observation blind --timesteps 5e6  any key of the config; nested ones as --ppo.gamma 0.995
    python train.py --changes.course.length 20           any key of the scenario
    python train.py --resume runs/NAME                   go on with a run that was interrupted or killed
"""

import sys

from agents.cli import main

if __name__ == "__main__":
    sys.exit(main(description=__doc__))
