"""Short evaluations for the tests of `agents.evaluate`."""

import json

from agents import ppo
from soil_env.cli import main
from soil_env.parameters import load_scenario

CLASSES = "half=tests.agents.drivers:Half,tests.agents.drivers:Counting"
SHORT = (
    "--changes.control.time_limit=6 --changes.course.length=2 --courses=7 --block=3 --resamples=50 --seed=11 "
    "--tuning-courses=0"
).split()
FILES = ("evaluation.json", "evaluation.csv", "evaluation.md", "courses.csv", "metrics.png")
TINY = ppo.PPOConfig(num_envs=4, n_steps=8, batch_size=32, n_epochs=1, layer=4)


def make_models(folder):
    """Two training seeds of an agent in `folder`, as train.py leaves them, with hardly any training."""
    for seed in (0, 1):
        model = ppo.build(load_scenario(), "blind", TINY, seed)
        model.learn(64)
        (folder / f"seed_{seed}").mkdir()
        ppo.save(model, folder / f"seed_{seed}" / "model.zip")
    return folder


def evaluate(out, controllers, *more):
    """Status of a short evaluation; an option in `more` replaces the usual one."""
    later = {option.partition("=")[0] for option in more}
    short = [option for option in SHORT if option.partition("=")[0] not in later]
    return main(["evaluate", "--controllers", controllers, "--out", str(out), *short, *more])


def result_of(folder):
    """evaluation.json, read strictly."""

    def refuse(constant):
        raise AssertionError(constant)

    return json.loads((folder / "evaluation.json").read_text(), parse_constant=refuse)


def same(a, b):
    """Assert that two folders hold the same results, to the byte."""
    for names in (FILES, sorted(f"cells/{p.name}" for p in (a / "cells").iterdir())):
        for name in names:
            assert (a / name).read_bytes() == (b / name).read_bytes(), name
    assert len(list((a / "cells").iterdir())) == len(list((b / "cells").iterdir()))


def make_done(models, out):
    """A finished evaluation of a classical controller, two classes and two training seeds."""
    assert evaluate(out, everything(models), "--settings.fixed_slip.slip=0.2") == 0
    return out


def everything(models):
    """The controllers of `make_done`."""
    return f"{CLASSES},fixed_slip,ppo={models}/seed_*"
