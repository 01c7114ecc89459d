"""The cases of the oracle (tests/oracle.py): `CASES` maps a name to a function of nothing that
gives its quantities.
"""

from functools import partial

from soil_env.parameters import rover_names, scenario_names, soils
from tests.oracle_runs import (
    ROOT,
    SOFT,
    SOIL,
    drive,
    drive_many,
    drive_rover,
    identify,
    predict,
    soil_content,
    world,
)
from tests.terramechanics.cases import ACTING, CASES as EFFECTS

PAIRS = {
    "grousers_and_multipass": EFFECTS["grousers-shear_radius"] | EFFECTS["multipass-power"],
    "slip_sinkage_and_shear_softening": EFFECTS["slip_sinkage-ratio"]
    | EFFECTS["shear_softening-decaying"],
    "rear_contact_and_shear_rate": EFFECTS["rear_contact-midway"] | EFFECTS["shear_rate-power"],
}
LAW = [
    {"channel": "drawbar_pull", "coefficient": -0.05, "powers": {"slip": 1.5, "sinkage": 0.5}},
    {
        "channel": "torque",
        "coefficient": 0.08,
        "powers": {"slip": 1, "grade": 1},
        "ranges": {"grade": [-0.2, 0.2]},
    },
]

CASES = {}
_WORLDS = {name: EFFECTS[name] for name in ACTING} | PAIRS
_SHORT = {"course": {"length": 2.5}, "reward": {"information": 1.0}, "observation": "true_soil"}
_MOON = {
    "gravity": 1.62,
    "course": {"halt_time": 0.0},
    "observation": "blind",
    "action": "wheel_speed",
}

for _name in scenario_names():
    CASES[f"trajectory/{_name}"] = partial(drive, 0.35, scenario=_name)
    CASES[f"trajectory/{_name}_wheel_speed"] = partial(
        drive, 0.45, scenario=_name, action="wheel_speed", seed=4
    )
CASES["trajectory/mixed_short_true_soil"] = partial(drive, 0.5, **_SHORT)
CASES["trajectory/mixed_moon_blind"] = partial(drive, 0.4, **_MOON)
CASES["trajectory/mixed_backwards"] = partial(drive, 0.0, seed=6)
CASES["trajectory/loose_full_power"] = partial(drive, 0.9, scenario="loose_slopes", seed=7)
for _i, (_name, _effects) in enumerate(_WORLDS.items()):
    _more = {"action": ("torque", "wheel_speed")[_i % 2], "seed": 20 + _i}
    CASES[f"effect/{_name}"] = partial(drive, 0.4, model=world(_effects), **_more)
for _name in sorted(p.stem for p in (ROOT / "configs" / "worlds").glob("*.yaml")):
    CASES[f"world/{_name}"] = partial(
        drive, 0.4, model=ROOT / "configs" / "worlds" / f"{_name}.yaml"
    )
CASES["world/sensors_only"] = partial(
    drive, 0.4, model=world(EFFECTS["slip_bias-offset"] | EFFECTS["sinkage_offset-offset"])
)
CASES["world/residual_law"] = partial(drive, 0.4, model=world({}, LAW))
CASES["world/residual_law_and_effect_on_one_soil"] = partial(
    drive,
    0.45,
    model=world(EFFECTS["rear_contact-midway"], LAW, **SOFT),
    action="wheel_speed",
    observation="true_soil",
    course={"margin": [0.02, 0.04]},
)
_LUGS = world(PAIRS["grousers_and_multipass"])
CASES["vector/next_step"] = partial(drive_many, 11, max_episode_steps=70)
CASES["vector/same_step_wheel_speed"] = partial(
    drive_many,
    11,
    scenario="sticky",
    autoreset_mode="SameStep",
    max_episode_steps=60,
    action="wheel_speed",
    threads=1,
)
CASES["vector/disabled_blind"] = partial(
    drive_many,
    9,
    observation="blind",
    autoreset_mode="Disabled",
    max_episode_steps=55,
    scenario="unseen",
)
CASES["vector/effects"] = partial(drive_many, 10, model=_LUGS, max_episode_steps=70, threads=1)
CASES["vector/one_wheel"] = partial(drive_many, 1, scenario="loose_slopes", course={"length": 3.0})

for _name in rover_names():
    CASES[f"rover/{_name}"] = partial(drive_rover, rover=_name)
CASES["rover/torque_true_soil"] = partial(
    drive_rover, rover="mars_rover", action="torque", observation="true_soil"
)
CASES["rover/effects"] = partial(
    drive_rover, rover="field_rover", model=_LUGS, action="wheel_speed"
)

CASES["prediction/soils"] = lambda: predict(
    {k: world({}, **soil_content(s)) for k, s in soils().items()}
)
CASES["prediction/effects"] = lambda: predict(
    {k: world(e, **SOIL) for k, e in (EFFECTS | PAIRS).items()}
)
CASES["prediction/effects_soft"] = lambda: predict(
    {k: world(e, **SOFT) for k, e in (EFFECTS | PAIRS).items()}
)
CASES["prediction/residual_law"] = lambda: predict(
    {"law": world({}, LAW, **SOIL), "soft": world({}, LAW, **SOFT)}, 40
)

CASES["identification/rig"] = partial(
    identify, "examples/data/rig.csv", "examples/data/rig.setup.yaml"
)
CASES["identification/single_wheel"] = partial(
    identify, "examples/data/single_wheel.csv", "examples/data/setup.yaml"
)
