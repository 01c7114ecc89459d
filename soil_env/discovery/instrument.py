"""Errors of the rig and its sensors: candidates beside the effects of the catalogue, and nuisances
of every table.

`Setup.calibration` states how well a rig is levelled, its wheel measured and its sensors
calibrated, as standard deviations. Errors of that size are in the covariance of every fit
(`nuisances`), so that no effect is named for them. A larger one is a candidate with a name, in
`INSTRUMENT`. The simulated world has none of these, and model.yaml holds none.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from functools import cache
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from soil_env._io.loading import ParameterError, unknown_value
from soil_env.identification.table.calibration import (
    SENSORS,
    changes,
    sd_of_errors,
    sensor_unknowns,
    stated_errors,
)
from soil_env.identification.table.priors import Values
from soil_env.measurement.setup import Calibration, Setup
from soil_env.slip import slips_of_radius
from soil_env.terramechanics.effects import CATALOGUE
from soil_env.terramechanics.effects.entry import (
    CHANNELS,
    PULL,
    TORQUE,
    Bench,
    Channel,
    Effect,
    EffectParameter,
    Form,
)
from soil_env.terramechanics.model import Rows

from .unnamed import UNNAMED

#: Standard deviation of a zero error that is a candidate: that of the pull over the median load of
#: the table, that of the torque over this load times the radius.
OFFSET = 0.05
PRESSED = (0.2, 3.0)  # [stated load] least and largest true load that is sought; own choice
#: Limits of the second change of the load over the first. With them the load is extrapolated by 0.2
#: to 5 times the second change: a series that hardly converges is not followed to its end; own
#: choice.
GROWTH = (-4.0, 0.8)
STEADY = 1e-9  # [stated load] change of the load below which it is not extrapolated


def _entry(
    name: str,
    title: str,
    explained: str,
    moves: tuple[Channel, ...],
    p: EffectParameter,
    equation: str,
    priors=lambda bench: {},
) -> Effect:
    """An error of the rig as an effect of one parameter `p` and one form.

    `priors` is given where the prior depends on the rig, such as on its load.
    """
    return Effect(
        name,
        title,
        (p,),
        (Form("constant", (p.name,), equation, "calibration of the rig"),),
        moves,
        symbols={
            "DP_measured": "measured drawbar pull",
            "T_measured": "measured torque",
            "W_n": "force on the ground",
            "r_true": "true radius",
            "W_true": "true load",
            "z": "sinkage",
        },
        priors=priors,
        explained=explained,
    )


def _p(name: str, symbol: str, unit: str, most: float, sd: float, doc: str) -> EffectParameter:
    """A parameter with a prior of mean 0 and standard deviation `sd`, and bounds -`most` and
    `most`.

    Where `_within` sets the prior, `sd` is 0 and `most` so large that it does not count.
    """
    return EffectParameter(name, symbol, -most, most, sd, doc, unit)


def _within(
    name: str, sd: float, most: float, size: Callable[[Bench], float]
) -> Callable[[Bench], dict]:
    """Function for `Effect.priors`: the prior (sd, low, high) of the parameter `name` for a rig.

    `sd` and the bounds -`most` and `most` are in units of the `size` of the rig.
    """
    return lambda bench: {name: (sd * size(bench), -most * size(bench), most * size(bench))}


INSTRUMENT: Mapping[str, Effect] = MappingProxyType(
    {
        effect.name: effect
        for effect in (
            _entry(
                "tilt",
                "a rig that is not level",
                "The rig is not level, so that a part of the load is read as pull.",
                (PULL,),
                _p(
                    "angle_deg",
                    "e",
                    "deg",
                    15.0,
                    2.0,
                    "uphill tilt of the ground against the axes of the rig",
                ),
                "DP_measured = DP - W sin({angle_deg}); W_n = W cos({angle_deg})",
            ),
            _entry(
                "force_offset",
                "zero error of the drawbar pull",
                "The zero of the load cell that measures the pull is off.",
                (PULL,),
                _p("offset", "d", "N", 1e6, 0.0, "offset of the load cell"),
                "DP_measured = DP + {offset}",
                _within("offset", OFFSET, 1.0, lambda bench: bench.load),
            ),
            _entry(
                "force_gain",
                "gain error of the drawbar pull",
                "The load cell reads the pull too large or too small by a constant factor.",
                (PULL,),
                _p("gain", "g", "", 0.5, 0.08, "relative error of the load cell"),
                "DP_measured = DP (1 + {gain})",
            ),
            _entry(
                "torque_offset",
                "zero error of the torque",
                "The zero of the torque sensor is off.",
                (TORQUE,),
                _p("offset", "d", "N m", 1e6, 0.0, "offset of the torque sensor"),
                "T_measured = T + {offset}",
                _within("offset", OFFSET, 1.0, lambda bench: bench.load * bench.radius),
            ),
            _entry(
                "torque_gain",
                "gain error of the torque",
                "The torque sensor reads too much or too little by a constant factor.",
                (TORQUE,),
                _p("gain", "g", "", 0.5, 0.08, "relative error of the torque sensor"),
                "T_measured = T (1 + {gain})",
            ),
            _entry(
                "wheel_radius",
                "a wheel radius other than stated",
                (
                    "The wheel has another radius than the setup says, and the slip was computed "
                    "with that."
                ),
                CHANNELS,
                _p("error", "e", "", 0.3, 0.05, "relative error of the stated radius"),
                "r_true = r (1 + {error})",
            ),
            _entry(
                "force_crosstalk",
                "crosstalk of the torque in the drawbar pull",
                "The load cell reads a part of the torque as pull.",
                (PULL,),
                _p("share", "x", "", 0.5, 0.08, "torque over radius that is read as drawbar pull"),
                "DP_measured = DP + {share} T/r",
            ),
            _entry(
                "torque_crosstalk",
                "crosstalk of the drawbar pull in the torque",
                "The torque sensor reads a part of the pull as torque.",
                (TORQUE,),
                _p("share", "x", "", 0.5, 0.08, "drawbar pull that is read as torque over radius"),
                "T_measured = T + {share} r DP",
            ),
            _entry(
                "arm_load",
                "a load that goes with the torque",
                (
                    "The wheel hangs on an arm that its torque presses down or lifts, so that the "
                    "load changes with it."
                ),
                CHANNELS,
                _p(
                    "share",
                    "a",
                    "",
                    1.0,
                    0.2,
                    "radius over the lever of the arm that holds the wheel",
                ),
                "W_true = W + {share} T/r",
            ),
            _entry(
                "spring_load",
                "a load that goes with the sinkage",
                "A spring or the weight of an arm changes the load as the wheel sinks.",
                CHANNELS,
                _p("rate", "k", "N/m", 1e6, 0.0, "load that is lost over a metre of sinkage"),
                "W_true = W - {rate} z",
                _within("rate", 2.0, 8.0, lambda bench: bench.load / bench.radius),
            ),
        )
    }
)
#: Everything that can be named.
LISTED: Mapping[str, Effect] = MappingProxyType({**CATALOGUE, **INSTRUMENT})
#: Everything that can be named, and the laws without a name (`unnamed`).
LAWS: Mapping[str, Effect] = MappingProxyType({**LISTED, **UNNAMED})


def titles(names: Iterable[str]) -> str:
    """Titles of listed effects, with " and " between them."""
    return " and ".join(LISTED[name].title for name in names)


class Choice(NamedTuple):
    """One effect in one of its published forms."""

    effect: str  # name in `LAWS`
    form: int  # index in `Effect.forms`

    @property
    def published(self) -> Form:
        """The form itself."""
        return LAWS[self.effect].forms[self.form]

    @property
    @cache  # noqa: B019 (records of the catalogue: few; fits ask for it often)
    def free(self) -> tuple[str, ...]:
        """Names `<effect>_<parameter>` of the parameters that the form leaves to be fitted."""
        return tuple(f"{self.effect}_{p}" for p in self.published.free)

    @property
    def fixed(self) -> dict[str, float]:
        """Parameters that the form sets, by the same names."""
        return {f"{self.effect}_{p}": v for p, v in self.published.fixed}


Choices = tuple[Choice, ...]
Names = tuple[str, ...]  # a set of effects


def effect_names(choices: Choices) -> Names:
    """Names of the effects of these choices, in their order."""
    return tuple(c.effect for c in choices)


def ruled_out(setup: Setup) -> dict[str, str]:
    """Reason by name of the effects and errors of the rig that are no candidates.

    The setup rules them out by a check or by a calibration of 0, or has the tilt as a number or
    prior of its own. Raises `ParameterError` for a name in `checked` that is unknown or there
    twice, and where all are there.
    """
    checked = setup.checked
    for name in checked:
        if name not in LISTED:
            raise unknown_value(name, LISTED, f"{setup.source}: checked")
        if checked.count(name) > 1:
            raise ParameterError(
                f"{setup.source}: checked: {name} is there twice: expected each name once"
            )
    if len(checked) == len(LISTED):
        raise ParameterError(
            f"{setup.source}: checked: has all effects: expected those that a check has ruled out"
        )
    sure = [name for name, sd in stated_errors(setup.calibration).items() if sd == 0.0]
    known = dict.fromkeys(sure, "calibrated, by the setup")
    known |= dict.fromkeys(checked, "checked, by the setup")
    return known | ({"tilt": "tilt_deg of the setup has it"} if setup.tilt_deg is not None else {})


def odds_factors(setup: Setup, bench: Bench) -> dict[str, float]:
    """Factors on the prior odds of the errors of a rig, by name: 1 if the setup states nothing.

    A rig that is known five times better than usual is wrong a fifth as often, since somebody
    looked. One that is known worse keeps the usual odds.
    """
    own, usual = (
        sd_of_errors(x, bench.load, bench.radius, setup.source)
        for x in (setup.calibration, Calibration())
    )
    return {name: min(own[name] / usual[name], 1.0) for name in INSTRUMENT}


def true_rows(rows: Rows, values: Values) -> Rows:
    """Rows with the true wheel radius, by `wheel_radius_error` among `values`, and the true slip.

    The slip changes since the recorded one was computed with the stated radius.
    """
    error = values.get("wheel_radius_error", 0.0)
    if error == 0.0:
        return rows
    wheels = rows.wheels.copy()
    wheels[:, 0] *= 1.0 + error
    return rows._replace(
        wheels=wheels, slip=slips_of_radius(rows.slip, np.full(rows.slip.size, 1.0 / (1.0 + error)))
    )


def in_balance(rows: Rows, values: Values, outcome: Callable[[Rows], np.ndarray]) -> np.ndarray:
    """Sinkage, pull and torque [N, 3], by `outcome`, at the load that really presses on the wheel.

    An arm adds a share of torque/radius to the stated load, a spring takes its rate times the
    sinkage off, so load and outcome depend on each other. The load is extrapolated once from three
    loads, the stated one and two updates (Aitken 1926, Proc. R. Soc. Edinb. 46:289-305). It stays
    within `PRESSED`; at its ends there is no balance, and the outcome is NaN.
    """
    arm = values.get("arm_load_share", 0.0)
    spring = values.get("spring_load_rate", 0.0)
    out = outcome(rows)
    start = rows.load
    r = rows.wheels[:, 0]
    if arm == spring == 0.0:
        return out
    low, high = np.outer(PRESSED, start)

    def load_from(out: np.ndarray) -> np.ndarray:
        """Load [N] of each row under an outcome [N, 3], within `PRESSED`; sinkage and torque count
        as 0 where they are NaN.
        """
        z, _, torque = np.nan_to_num(out).T
        return np.clip(start + arm * torque / r - spring * z, low, high)

    first = load_from(out)
    second = load_from(outcome(rows._replace(load=first)))
    # Where the load hardly changes, an infinite first change makes the ratio 0: `second` is taken.
    change = np.where(np.abs(first - start) > STEADY * start, first - start, math.inf)
    ratio = np.clip((second - first) / change, *GROWTH)
    limit = np.clip(first + (second - first) / (1.0 - ratio), low, high)
    balanced = (low < limit) & (limit < high)
    return np.where(balanced[:, None], outcome(rows._replace(load=limit)), math.nan)


def nuisances(
    setup: Setup, bench: Bench, rows: Rows, output: np.ndarray, named: Names
) -> np.ndarray:
    """[N, 3, R] change of the readings [m, N, N m] by one standard deviation of each of R errors of
    the rig; `output` [N, 3]: model values.

    Nuisances are the `sensor_unknowns` that are not `named`. Errors that move all channels act
    through the model, and are candidates only.
    """
    known = {SENSORS.get(name) for name in named}
    unknowns = sensor_unknowns(setup, bench.load, bench.radius)
    return changes(output, {x.name: x.sd for x in unknowns if x.name not in known}, rows)
