"""`python -m soil_env.paper`."""

from soil_env._io.commands import leave
from soil_env.paper.recompute import main

if __name__ == "__main__":
    leave(main())
