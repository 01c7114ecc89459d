"""`soil-env drive`: one course under a controller or an agent, as numbers, a picture or a video."""

import errno
import importlib.util
import io
import tempfile
from functools import partial
from pathlib import Path
from typing import Any

import click
import gymnasium
import numpy as np
from click.core import ParameterSource

from soil_env._io.files import check_own, write_own
from soil_env._io.loading import ParameterError
from soil_env.cli.running import PATH, WholeNumber, seed_option
from soil_env.parameters import load_rover, load_scenario
from soil_env.rendering.side_view import SCENE

from .cli import controllers_as, scenario_option
from .controllers.rover import controllers_of
from .evaluate.contestants import parse
from .evaluate.loading import load
from .evaluate.own import as_driven

_TITLE = 36  # [pixels] above each of several drives
_SUFFIXES = (".png", ".gif", ".mp4")


@click.command("drive")
@click.option(
    "--controller", metavar="NAME", help="Or a policy; or several (default best_slip_identified)."
)
@click.option(
    "--policy", metavar="NAME", help="default, a run folder, .npz, .onnx or m:Class; or several."
)
@scenario_option
@click.option("--rover", metavar="NAME", help="A rover or its YAML, in place of a scenario.")
@seed_option("the course")
@click.option(
    "--frame",
    type=WholeNumber(1),
    metavar="N",
    help="Control period of a picture (default: the last).",
)
@click.option(
    "--every",
    type=WholeNumber(1),
    default=5,
    metavar="N",
    help="Control periods a video frame (default 5).",
)
@click.option(
    "--out",
    type=PATH,
    metavar="FILE",
    help="Picture (.png) or video (.gif; .mp4 needs imageio-ffmpeg).",
)
def command(
    controller: str | None,
    policy: str | None,
    scenario: str,
    rover: str | None,
    seed: int,
    frame: int | None,
    every: int,
    out: Path | None,
) -> None:
    """Drive one course and save a picture or a video.

    \b
    soil-env drive --seed 3
    soil-env drive --seed 3 --frame 200 --out wheel.png
    soil-env drive --policy default --scenario sticky --out drive.gif
    soil-env drive --controller rule=best_slip_identified,agent=default --out both.gif
    soil-env drive --rover mars_rover --controller velocity_sync --out rover.gif
    """
    suffix = "" if out is None else out.suffix
    if frame is not None and suffix != ".png":
        raise ParameterError(f"--frame {frame}: expected --out with a .png, the picture of it")
    given = click.get_current_context().get_parameter_source
    if given("every") != ParameterSource.DEFAULT and suffix in ("", ".png"):
        raise ParameterError(f"--every {every}: expected --out with a .gif or .mp4, a video")
    if out is not None:
        if suffix not in _SUFFIXES:
            raise ParameterError(f"--out {out}: expected a file {', '.join(_SUFFIXES)}")
        if suffix == ".mp4" and importlib.util.find_spec("imageio_ffmpeg") is None:
            raise ParameterError(
                f'--out {out}: needs imageio-ffmpeg, pip install "soil_env[video]"; or a .gif'
            )
        check_own(out.parent, [out.name])
    if rover is not None and given("scenario") != ParameterSource.DEFAULT:
        raise ParameterError(
            f"--scenario {scenario}: expected none beside --rover, whose file has its own"
        )
    if rover is None:
        task = load_scenario(scenario)
        make = partial(gymnasium.make, "soil_env:SoilWheel-v0", scenario=task)
    else:
        task = load_rover(rover)
        make = partial(gymnasium.make, "soil_env:SoilRover-v0", rover=task, info="full")
    if policy is not None and controller is not None:
        raise ParameterError(
            f"--policy {policy}: expected none beside --controller {controller}; several are one "
            "list"
        )
    option = "--controller" if policy is None else "--policy"
    with controllers_as(option):
        named = next((n for n in (controller, policy) if n is not None), "best_slip_identified")
        asked = list(parse(named, known=controllers_of(task)[0]).values())
        drivers = {c.name: load(c, task) for c in asked}
        if len(drivers) < len(asked):
            raise ParameterError(f"controllers: {named!r}: expected one of each name")
        for name, driver in drivers.items():
            if hasattr(driver, "attach"):
                raise ParameterError(
                    f"controllers: {name}: plans in the simulation that it is attached to: "
                    "expected one that drives by its observations; soil-env evaluate drives it"
                )
    film_every = every if suffix in (".gif", ".mp4") else 0
    films = {}
    for name, driver in drivers.items():
        with controllers_as(option):
            control = as_driven(driver, task, name).control
        env = make(
            observation=driver.variant,
            render_mode="rgb_array" if out else None,
            scaled=False,
            action=control.action,
            repeat=1,
        )
        # The environment is stepped one control period at a time, so `_drive` holds the actions.
        held = control.action_periods
        with controllers_as(option):
            frames, info, steps = _drive(env, name, driver, held, seed, frame, film_every)
        films[name] = frames or ([env.render()] if out else [])
        env.close()
        early = f", before --frame {frame}" if frame is not None and steps < frame else ""
        print(
            f"{name}: {info['cause']} at {info['state']['x']:.2f} m after {steps} control "
            f"periods{early}"
        )
    if out is not None:
        frames = next(iter(films.values())) if len(films) == 1 else _side_by_side(films)
        content = _video(frames) if suffix == ".mp4" else _picture(frames, suffix)
        write_own(out.parent, {out.name: content})
        print(f"written: {out}")


def _side_by_side(films: dict[str, list[np.ndarray]]) -> list[np.ndarray]:
    """Frames with the side views of several drives next to each other, without charts, the name of
    each above it.

    The last frame of a drive stays until all have ended.
    """
    from PIL import Image, ImageDraw

    together = []
    for i in range(max(map(len, films.values()))):
        parts = []
        for name, frames in films.items():
            # Up to the right edge of the side view, and 2 px beyond.
            view = frames[min(i, len(frames) - 1)][:, : SCENE[0] + SCENE[2] + 2]
            part = Image.new("RGB", (view.shape[1], view.shape[0] + _TITLE), "white")
            part.paste(Image.fromarray(view), (0, _TITLE))
            ImageDraw.Draw(part).text((SCENE[0], 4), name, "black", font_size=24)
            # 0.7 of the size, in even numbers, as the codec of .mp4 wants them.
            parts.append(
                np.asarray(part.resize((part.width * 7 // 20 * 2, part.height * 7 // 20 * 2)))
            )
        together.append(np.concatenate(parts, axis=1))
    return together


def _drive(
    env: gymnasium.Env, name: str, driver: Any, held: int, seed: int, last: int | None, every: int
) -> tuple[list, dict, int]:
    """(frames, last info, number of control periods driven) of a drive on the course of `seed`.

    A frame is taken every `every` periods and at the end; none if 0. `last`: most periods, None: to
    the end of the course. `held`: periods for which an action of the driver is held, as in the
    scenario. `name` is that of the driver, for messages. ParameterError for an action that is not
    finite.
    """
    observation, info = env.reset(seed=seed)
    frames = []
    memory = None
    steps = 0
    over = False
    while not over and (last is None or steps < last):
        if steps % held == 0:
            start = np.array([steps == 0])
            action, memory = driver.predict(
                observation[None], state=memory, episode_start=start, deterministic=True
            )
            if not np.isfinite(action).all():
                given = f"{action[0].tolist()} in control period {steps}"
                raise ParameterError(f"{name}: predict gave {given}: expected finite numbers")
        observation, _, terminated, truncated, info = env.step(action[0])
        over = terminated or truncated
        steps += 1
        if every and (steps % every == 0 or over):
            frames.append(env.render())
    return frames, info, steps


def _video(frames: list[np.ndarray]) -> bytes:
    """Frames as the bytes of an MP4, ten a second, which ffmpeg writes into a temporary folder.

    OSError where the video has fewer frames than were given.
    """
    from imageio_ffmpeg import count_frames_and_secs, write_frames

    with tempfile.TemporaryDirectory() as there:
        file = Path(there) / "drive.mp4"
        size = frames[0].shape[1::-1]
        film = write_frames(file, size, fps=10, macro_block_size=2, ffmpeg_log_level="error")
        film.send(None)
        for frame in frames:
            film.send(np.ascontiguousarray(frame))
        film.close()
        if count_frames_and_secs(file)[0] < len(frames):  # as where that disk is full
            raise OSError(errno.EIO, "the video is not whole: is the disk full?", there)
        return file.read_bytes()


def _picture(frames: list[np.ndarray], suffix: str) -> bytes:
    """Bytes of a picture: the frames as GIF, 0.1 s each, repeated without end, or the first one as
    PNG.

    `suffix`: .gif or .png.
    """
    from PIL import Image

    images = [Image.fromarray(frame) for frame in frames]
    if len(images) > 1:
        # 64 colours for each frame, chosen by an octree: it keeps the colours of small areas.
        images = [image.quantize(64, Image.Quantize.FASTOCTREE) for image in images]
    more = {"save_all": True, "append_images": images[1:], "duration": 100, "loop": 0}
    stream = io.BytesIO()
    images[0].save(stream, suffix[1:].upper(), **(more if suffix == ".gif" else {}))
    return stream.getvalue()
