"""Drive a rover with all wheels at one speed, as most rovers do, and save a picture or a video of it.

Examples:
    python examples/drive_rover.py                                     prints how the course went, axle by axle
    python examples/drive_rover.py --rover mars_rover --frame 300 --out rover.png    one frame as a picture
    python examples/drive_rover.py --speed 0.8 --out rover.mp4         the whole course (needs moviepy)
"""

import argparse
import sys
from pathlib import Path

import gymnasium
import matplotlib.image
import numpy as np

from soil_env import ParameterError
from soil_env.vehicle import DEFAULT_ROVER, rover_names


def main() -> None:
    """Drive, print, save."""
    p = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    p.add_argument("--rover", default=DEFAULT_ROVER, help=f"{', '.join(rover_names())}, or the path of a YAML file")
    p.add_argument("--speed", type=float, default=0.7, help="of the wheels, as a share of their no-load speed")
    p.add_argument("--seed", type=int, default=0, help="seed of the course")
    p.add_argument("--frame", type=int, help="control period of which to save a picture; the last one if left out")
    p.add_argument("--out", type=Path, help=".png for a picture, .mp4 for a video")
    options = p.parse_args()
    if options.out is not None and options.out.suffix not in (".png", ".mp4"):
        p.error(f"--out {options.out}: expected a .png or an .mp4 file")
    if not -1.0 <= options.speed <= 1.0:
        p.error(f"--speed {options.speed}: expected a share of the no-load speed in [-1, 1]")
    if options.frame is not None and options.frame < 1:
        p.error(f"--frame {options.frame}: expected a control period, from 1 on")
    video = options.out is not None and options.out.suffix == ".mp4"
    env = gymnasium.make(
        "soil_env:SoilRover-v0",
        rover=options.rover,
        observation="blind",
        info="full",  # with what is identified
        action="wheel_speed",
        render_mode="rgb_array" if options.out else None,
    )
    if video:
        folder = str(options.out.resolve().parent)
        env = gymnasium.wrappers.RecordVideo(env, folder, lambda _: True, name_prefix=options.out.stem)
    env.reset(seed=options.seed)
    action = np.full(env.action_space.shape, options.speed, dtype=np.float32)  # a number for each axle
    over, steps = False, 0
    while not over and (video or options.frame is None or steps < options.frame):
        _, _, terminated, truncated, info = env.step(action)
        over, steps = terminated or truncated, steps + 1
    if options.frame is not None and steps < options.frame:
        print(f"--frame {options.frame}: the course ended before, after {steps} periods; the picture is of its end")
    if options.out is not None and not video:
        matplotlib.image.imsave(options.out, env.render())
    env.close()
    print(f"{options.rover}: {info['cause']} at {info['state']['x']:.2f} m after {steps} periods")
    identified = env.unwrapped.scenario.belief.method != "none"
    for axle in ("front", "middle", "rear"):
        if axle in info:
            state, soil = info[axle]["state"], info[axle]["estimate"]
            angle = f"{soil['friction_angle_deg']:.1f} +- {soil['friction_angle_sd_deg']:.1f} deg, {soil['status']}"
            print(
                f"  {axle}: slip {state['slip']:.2f}, sinkage {1e3 * state['sinkage']:.1f} mm, "
                f"load {state['load']:.1f} N; friction angle {angle if identified else 'not identified'}"
            )


if __name__ == "__main__":
    try:
        main()
    except (ParameterError, ValueError, OSError, gymnasium.error.Error) as error:
        print(f"drive_rover.py: error: {error}", file=sys.stderr)
        raise SystemExit(2) from None
