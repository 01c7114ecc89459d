"""`soil-env warmup`."""

from __future__ import annotations

import time

import click

from soil_env._numba.cache import place
from soil_env.warmup import warm_up


@click.command("warmup")
def command() -> None:
    """Compile the kernels of environments, identifier and commands once."""
    start = time.perf_counter()
    warm_up()
    print(f"ready after {time.perf_counter() - start:.0f} s; {place()}")
