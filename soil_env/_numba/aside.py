"""Compile one root in a process of its own, while another process compiles another root: see `compiling.compile_aside`.

The function and its signature come pickled on stdin; the code goes to the cache on the disk.
"""

from __future__ import annotations

import importlib
import pickle
import sys


def main() -> None:
    """Compile what stdin asks for."""
    module, name = pickle.load(sys.stdin.buffer)
    function = getattr(importlib.import_module(module), name)
    function.compile(pickle.load(sys.stdin.buffer))


if __name__ == "__main__":
    main()
