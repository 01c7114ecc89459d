"""Drive one course with a classical controller and save a picture or a video of it.

Examples:
    python examples/drive.py                                         prints how the course went
    python examples/drive.py --frame 150 --out wheel.png             one frame as a picture
    python examples/drive.py --controller full_throttle --out a.mp4  the whole course as a-episode-0.mp4 (needs moviepy)
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import gymnasium
import numpy as np

from soil_env import ParameterError
from soil_env.parameters import DEFAULT_SCENARIO
from soil_env_agents.controllers import CONTROLLERS, make_controller


def main() -> None:
    """Parse the command line, drive, save."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--controller", choices=sorted(CONTROLLERS), default="best_slip_identified")
    p.add_argument("--scenario", default=DEFAULT_SCENARIO, help="name of a scenario or path of a YAML file")
    p.add_argument("--seed", type=int, default=0, help="seed of the course")
    p.add_argument("--frame", type=int, help="control period of which to save a picture; the last one if left out")
    p.add_argument("--out", type=Path, help=".png for a picture, .mp4 for a video")
    options = p.parse_args()
    if options.out is not None and options.out.suffix not in (".png", ".mp4"):
        p.error(f"--out {options.out}: expected a .png or an .mp4 file")
    if options.frame is not None and options.frame < 1:
        p.error(f"--frame {options.frame}: expected a control period, from 1 on")
    drive(options)


def drive(options) -> None:
    """Drive one course as the options say."""
    video = options.out is not None and options.out.suffix == ".mp4"
    variant = CONTROLLERS[options.controller].variant
    mode = "rgb_array" if options.out else None
    env = gymnasium.make(  # repeat=1: a frame every control period; controllers read physical values
        "soil_env:SoilWheel-v0",
        scenario=options.scenario,
        observation=variant,
        render_mode=mode,
        repeat=1,
        scaled=False,
    )
    if video:
        folder = str(options.out.resolve().parent)
        env = gymnasium.wrappers.RecordVideo(env, folder, lambda _: True, name_prefix=options.out.stem)
    controller = make_controller(options.controller, env.unwrapped.scenario)
    observation, info = env.reset(seed=options.seed)
    memory, start, over, total, steps = None, np.array([True]), False, 0.0, 0
    while not over and (video or options.frame is None or steps < options.frame):
        action, memory = controller.predict(observation[None], memory, start)
        start = np.array([False])
        observation, reward, terminated, truncated, info = env.step(action[0])
        over, total, steps = terminated or truncated, total + reward, steps + 1
    if options.frame is not None and steps < options.frame:
        print(f"--frame {options.frame}: the course ended before, after {steps} periods; the picture is of its end")
    if options.out is not None and not video:
        import matplotlib.image

        options.out.parent.mkdir(parents=True, exist_ok=True)
        matplotlib.image.imsave(options.out, env.render())
    env.close()
    state = info["state"]
    print(f"{options.controller}: {info['cause']} at {state['x']:.2f} m after {steps} periods, return {total:.2f}")


if __name__ == "__main__":
    try:
        main()
    except (ParameterError, ValueError, OSError, gymnasium.error.Error) as error:
        print(f"drive.py: error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
