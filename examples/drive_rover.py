"""Drive a rover with all wheels at one speed, as most rovers do, and save a picture or a video of it.

\b
Examples:
    python examples/drive_rover.py                                     prints how the course went, axle by axle
    python examples/drive_rover.py --rover mars_rover --frame 300 --out rover.png    one frame as a picture
    python examples/drive_rover.py --speed 0.8 --out rover.mp4         the whole course (needs moviepy)
"""

from pathlib import Path

import click
import gymnasium
import matplotlib.image
import numpy as np

from soil_env import ParameterError
from soil_env.cli.running import leave, run
from soil_env.vehicle import DEFAULT_ROVER, rover_names


@click.command(help=__doc__)
@click.option("--rover", default=DEFAULT_ROVER, help=f"{', '.join(rover_names())}, or the path of a YAML file")
@click.option("--speed", type=click.FloatRange(-1.0, 1.0), default=0.7, help="share of the no-load speed of the wheels")
@click.option("--seed", default=0, help="seed of the course")
@click.option("--frame", type=click.IntRange(1), help="control period of which to save a picture (default: the last)")
@click.option("--out", type=Path, help=".png for a picture, .mp4 for a video")
def main(rover: str, speed: float, seed: int, frame: int | None, out: Path | None) -> None:
    """Drive, print, save."""
    if out is not None and out.suffix not in (".png", ".mp4"):
        raise ParameterError(f"--out {out}: expected a .png or an .mp4 file")
    video = out is not None and out.suffix == ".mp4"
    env = gymnasium.make(
        "soil_env:SoilRover-v0", rover=rover, observation="blind", info="full", action="wheel_speed",
        render_mode="rgb_array" if out else None,
    )  # fmt: skip
    if video:
        env = gymnasium.wrappers.RecordVideo(env, str(out.resolve().parent), lambda _: True, name_prefix=out.stem)
    env.reset(seed=seed)
    action = np.full(env.action_space.shape, speed, dtype=np.float32)  # a number for each axle
    over, steps = False, 0
    while not over and (video or frame is None or steps < frame):
        _, _, terminated, truncated, info = env.step(action)
        over, steps = terminated or truncated, steps + 1
    if out is not None and not video:
        matplotlib.image.imsave(out, env.render())
    env.close()
    print(f"{rover}: {info['cause']} at {info['state']['x']:.2f} m after {steps} periods")
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
    leave(run(main, None, "drive_rover.py"))
