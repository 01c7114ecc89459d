"""`python -m benchmarks.blind.easy`."""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(_name, "1")  # before numpy is loaded: the cores are taken by the workers

from benchmarks.blind.easy.command import main
from soil_env._io.commands import leave

if __name__ == "__main__":
    leave(main())
