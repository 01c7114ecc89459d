"""Compile one root in a process of its own, while another process compiles another root: see `compiling.compile_aside`.

The function and its signature come pickled on stdin; the code goes to the cache on the disk.
"""

import gc
import importlib
import pickle
import sys


def main() -> None:
    """Compile the function that the parent process asks for."""
    gc.disable()  # the process ends before it would pay
    module, name, signature = pickle.load(sys.stdin.buffer)  # from `compile_aside`
    getattr(importlib.import_module(module), name).compile(signature)


if __name__ == "__main__":
    main()
