"""The limit of a task: a planner that knows the ground, beside the controllers, and which of their failures it avoids.

The oracle plans every half second on clones of the true world (agents/controllers/oracle.py). It drives the first N
courses of a set, the classical controllers the same; what it finishes is a lower bound of what can be finished, and a
failure that it avoids was avoidable for one who knows the ground. All options of agents.evaluate can be given, too.

Examples:
  python -m agents.oracle --courses 200 --out limit
  python -m agents.oracle --courses 200 --controllers 'soft_start,ppo=runs/NAME' --out limit
  python -m agents.oracle --resume limit

Interrupted or killed, it goes on where it was with --resume OUT or with the same command again. A course takes the
oracle about a second of a processor.
"""

from __future__ import annotations

import argparse

from soil_env._io.commands import command, command_line, leave, whole_number

from .cli import manual_parser
from .controllers import CONTROLLERS
from .evaluate.__main__ import MEMORY, compare

_NAME = f"{__package__}.oracle"


def parser() -> argparse.ArgumentParser:
    """Options of the command that differ from those of agents.evaluate."""
    p = manual_parser(command(_NAME), __doc__)
    p.add_argument("--controllers", metavar="CONTROLLERS", help="default: all classical ones")
    p.add_argument("--courses", metavar="N", type=whole_number(1), default=200, help="default: 200")
    p.add_argument("--tuning-courses", metavar="N", type=whole_number(0), default=200, help="default: 200")
    return p


@command_line(_NAME, memory=MEMORY)
def main(arguments: list[str] | None = None) -> int:
    """Run the command; returns its exit status: 0 done, 2 bad input, 130 interrupted."""
    options, rest = parser().parse_known_args(arguments)
    if any(r.partition("=")[0] == "--resume" for r in rest):
        return compare(rest, _NAME)
    given = {
        "controllers": options.controllers or ",".join(CONTROLLERS),
        "courses": options.courses,
        "oracle-courses": options.courses,
        "tuning-courses": options.tuning_courses,
    }
    return compare([*(f"--{key}={value}" for key, value in given.items()), *rest], _NAME)


if __name__ == "__main__":
    leave(main())
