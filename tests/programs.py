"""Python in a process of its own."""

import subprocess
import sys

from tests.conftest import ROOT


def python(*arguments, **options):
    """Process of Python with these arguments, in the clone's folder, that has ended with status
    0.
    """
    options = {"cwd": ROOT, "timeout": 600} | options
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, **options)
    assert done.returncode == 0, done.stderr[-2000:]
    return done
