"""Python in a process of its own."""

import subprocess
import sys

from tests.conftest import ROOT


def python(*arguments, **options):
    """Run Python with these arguments in the clone's folder; AssertionError with its stderr unless
    it ends with status 0.
    """
    options = {"cwd": ROOT} | options
    done = subprocess.run([sys.executable, *arguments], capture_output=True, text=True, **options)
    assert done.returncode == 0, done.stderr[-2000:]
    return done
