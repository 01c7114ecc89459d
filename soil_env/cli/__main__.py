"""`python -m soil_env.cli`: the command `soil-env` where its script is not on the path."""

from . import entry

if __name__ == "__main__":
    entry()
