"""Fit of the model, with or without effects, to a measurement table: the most probable parameters
under the priors.

Priors of the soil and the least squares are those of `soil_env.identification.table`, with noise of
slip and load as noise of the channels. The whitened unknowns u minimise

    J(u) = e'C^-1 e + |u|^2,    e = (y - f(u)) / sigma,    C = I + B B'

with the form errors B of `identification.table.form_error`: of the base law, in the stresses, and
of each effect, a smooth factor on what it adds to each channel. Priors of the setup are widened
(`PRIOR_WIDTH`), since a soil a little off its prior must not be taken for a missing effect.
"""

from __future__ import annotations

import copy
import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import compress
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np
from scipy.stats import gmean

from soil_env.identification.table.calibration import reading
from soil_env.identification.table.data import CHANNELS, Data
from soil_env.identification.table.form_error import (
    INPUTS,
    LAW_LENGTHS,
    LENGTHS,
    Conditions,
    Process,
    StressChange,
    by_stresses,
    compressed,
    finite,
    in_channels,
    whitened,
)
from soil_env.identification.table.noise import (
    NoiseEstimate,
    find_noise,
    rough_noise,
    with_noise_of_conditions,
)
from soil_env.identification.table.priors import (
    BROAD,
    Unknown,
    Values,
    bounds_of,
    given_laws,
    given_prior,
    middle_sinkage,
    parameters_at,
    soil_unknowns,
)
from soil_env.identification.table.problem import (
    COARSE,
    NO_VALUE,
    OFF_GUESS,
    ArrayFunction,
    Last,
    differences,
    most_probable,
)
from soil_env.identification.table.rig import predict_table, shifted
from soil_env.slip import sliding_speeds
from soil_env.terramechanics.effects import CATALOGUE, NO_EFFECTS, Effects
from soil_env.terramechanics.effects.entry import Bench
from soil_env.terramechanics.model import USUAL_DENSITY, Rows

from .instrument import (
    LAWS,
    LISTED,
    Choice,
    Choices,
    effect_names,
    in_balance,
    nuisances,
    true_rows,
)
from .unnamed import changed, factors, loaded

PRIOR_WIDTH = 1.5  # factor of the sd of the setup's priors
#: Size of the form error of an effect with `Effect.any_form` over that of other effects.
ANY_FORM = 10.0
AT_BOUND = 1e-4  # [prior sd] distance of an unknown from a bound, within which it does not move
#: Lower bound of a parameter with a log-normal prior, over its centre, where its own bound is lower
#: (0 has no logarithm); own choice.
LEAST_OF_CENTRE = 1e-3
#: [prior sd] distance of a given start from a bound; also that of two starts that are taken as the
#: same.
_SAME = 1e-6
#: [prior sd] distance of any other start from a bound; own choice. At its neutral value the other
#: parameters of an effect change nothing. And the first step of the search is as long as the start
#: is far from the prior mean: with all of them there and one next to a bound it would soon stop.
_OFF_BOUND = 0.3
_LAW_FUNCTIONS = 24  # most functions of the process of the base law's error
_EFFECT_FUNCTIONS = 24  # most functions of the process of an effect's form error
_FREE_FUNCTIONS = 40  # most functions of an anonymous contribution
#: Correlation lengths of the error of the base law, one as probable as another. The shortest is
#: about the step between two slips of a table, for laws that are right at some slips alone: soil
#: flows in two zones below a driven wheel, and in one at large slip (Wong 1967, J. Agric. Eng. Res.
#: 12:257-269).
ALL_LAW_LENGTHS = (*LAW_LENGTHS, LENGTHS | {"slip": 0.1})
#: Correlation lengths of a smooth anonymous contribution over those of a form error.
_LONGER = 1.6


class Sizes(NamedTuple):
    """Sizes of the form errors and of an anonymous contribution (`evidence`)."""

    law: float = 0.0  # alpha: error of the stresses of the base law, relative
    effect: float = 0.0  # beta: form error of an effect, relative to what it adds
    #: Smooth anonymous contribution to each channel, relative to the channel's rms.
    free: tuple[float, float, float] = (0.0, 0.0, 0.0)
    span: int = 0  # index in `ALL_LAW_LENGTHS`: correlation lengths of the base law's error
    #: sd of the values about the model over the noise: more than 1 if soils vary by row.
    scatter: float = 1.0
    patterns: tuple[tuple[str, float], ...] = ()  # (name in `evidence.patterns`, relative size)
    rig: float = 0.0  # nuisances of the instrument, over their standard deviations

    @property
    def of_form_errors(self) -> tuple[float, ...]:
        """Size of each block of `Fit.form_errors`.

        Of the blocks of the base law, that of the correlation lengths `span` has the size `law`,
        the others have 0.
        """
        laws = (self.law if k == self.span else 0.0 for k in range(len(ALL_LAW_LENGTHS)))
        return (self.rig, self.effect, *laws)


NOISE_ALONE = Sizes()  # no form error, and values that scatter as their noise says


def sinkage_guess(output: np.ndarray) -> np.ndarray:
    """Sinkages [N] in m from which a prediction starts: those of an output [N, 3], 0 for negative
    ones.
    """
    return np.maximum(output[:, 0], 0.0)


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model: N rows, M values in use, p unknowns.

    Whitened are residuals by the noise, unknowns by their priors. A form error of size 1 is the sum
    of its R columns with standard normal coefficients; R differs between form errors.
    """

    choices: Choices
    unknowns: tuple[Unknown, ...]
    u: np.ndarray  # [p] whitened
    output: np.ndarray  # [N, 3] model values [m, N, N m]
    added: tuple[np.ndarray, ...]  # [N, 3] what each effect adds to them
    residual: np.ndarray  # [M] whitened (y - f) of the values in use
    jacobian: np.ndarray  # [M, p] d(f)/d(u), whitened
    #: Whitened blocks [M, R] at the size 1: nuisances of the instrument, form error of the effects,
    #: and that of the base law for each of `ALL_LAW_LENGTHS`.
    form_errors: tuple[np.ndarray, ...]
    free: tuple[np.ndarray, ...]  # [M, R] of a smooth anonymous contribution to each channel
    converged: bool
    sizes: Sizes  # under which the unknowns are most probable

    def parameters(self) -> dict[str, float]:
        """Values of the unknowns by name, in their own units."""
        return parameters_at(self.unknowns, self.u)

    @property
    def free_unknowns(self) -> np.ndarray:
        """[p] True for the unknowns that are not within `AT_BOUND` of a bound."""
        low, high = bounds_of(self.unknowns)
        return np.minimum(self.u - low, high - self.u) > AT_BOUND

    def columns(self, sizes: Sizes) -> np.ndarray:
        """[M, R] whitened form errors, nuisances and smooth contributions at these sizes, side by
        side.

        `Sizes.scatter` is not applied. Those of size 0 are left out; [M, 0] if all are.
        `Sizes.patterns` do not count, since no fit is made with one.
        """
        blocks = zip(
            (*self.form_errors, *self.free), (*sizes.of_form_errors, *sizes.free), strict=True
        )
        return np.concatenate(
            [size * block for block, size in blocks if size > 0.0] or [self.jacobian[:, :0]], axis=1
        )

    def linearised(self) -> tuple[np.ndarray, np.ndarray]:
        """(A [M + p + R, k], e [M + p + R]): the whitened least squares |A x - e| about the fit.

        The first M rows are the values, over the noise times the scatter. The others are the priors
        of the p unknowns and of the R columns of form errors. x [k] are changes of the unknowns and
        then the R coefficients of the form errors, at the sizes of the fit. Unknowns at a bound
        have no column, since they do not move.
        """
        extra = self.columns(self.sizes)
        free = np.concatenate([self.free_unknowns, np.ones(extra.shape[1], bool)])
        x = np.concatenate([self.u, np.zeros(extra.shape[1])])
        top = np.concatenate([self.jacobian, extra], axis=1) / self.sizes.scatter
        return np.concatenate([top, np.eye(x.size)])[:, free], np.concatenate(
            [self.residual / self.sizes.scatter, -x]
        )


@dataclass(eq=False)
class Problem:
    """Table, unknowns of the soil, noise and values in use, which all fits to one table share."""

    data: Data
    noise: np.ndarray  # [3] standard deviation [m, N, N m]
    used: np.ndarray  # [N, 3] bool, measured and not an outlier
    freedom: float = math.inf  # degrees of freedom that the noise is known to

    def __post_init__(self) -> None:
        """Set what follows from table and setup: unknowns, priors that depend on the rig, and the
        processes of form errors.
        """
        setup = self.data.setup
        #: Unknowns of the soil with their widened priors; values by name that the setup knows.
        self.soil, self.known = soil_unknowns(
            setup, self.data.rows.load, self.data.y[:, 0], PRIOR_WIDTH
        )
        given = setup.soil.density
        self.density = USUAL_DENSITY if given is None else given.value  # [kg/m3]
        self.laws = given_laws(setup)  # values by name
        self.bench = self._bench()
        #: Prior (sd, low, high) of the parameters for which the rig sets it.
        self.scales = {
            f"{e.name}_{k}": v for e in LISTED.values() for k, v in e.priors(self.bench).items()
        }
        # `predict_table` adds a share of 1, and the sum has to be within the parameter's bound.
        if setup.load == "vertical":
            share = CATALOGUE["grade"].parameter("share")
            self.scales["grade_share"] = (share.scale, share.low, share.high - 1.0)
        #: Neutral value or centre of the parameters for which the rig sets it.
        self.centres = {
            f"{e.name}_{k}": v for e in LISTED.values() for k, v in e.neutral(self.bench).items()
        }
        self.neutral = NO_EFFECTS._replace(**self.centres)  # `Effects` of the base model
        self._lay_form_errors()

    def _lay_form_errors(self) -> None:
        """Lay Gaussian processes over the conditions of the table, and set `size` [3], the rms of
        each channel over its values in use, 0 without any.

        The form error of the base law has a process over `INPUTS` for each of `ALL_LAW_LENGTHS`.
        That of effects has one for each set of conditions that some effect depends on beside these.
        `free_functions` [N, R], for a smooth anonymous contribution, depend on all conditions and
        on the time, where it is known.
        """
        at = self.data.conditions | self.data.elapsed
        self.law_processes = [
            Process.over(at, of=INPUTS, most=_LAW_FUNCTIONS, lengths=x) for x in ALL_LAW_LENGTHS
        ]
        self.effect_processes = {
            more: Process.over(at, of=(*INPUTS, *more), most=_EFFECT_FUNCTIONS)
            for more in {e.conditions for e in LAWS.values()}
        }
        lengths = {k: _LONGER * v for k, v in LENGTHS.items()}
        self.free_functions = Process.over(
            at, additive=True, most=_FREE_FUNCTIONS, lengths=lengths
        ).at_points
        self.size = self._rms(self.data.y)

    def _bench(self) -> Bench:
        """Sizes of this rig, which priors of effects scale with.

        `speed` and `sliding` are geometric means: that of sliding over the rows that slip, or that
        of travel if none does. Both are 0 if a row has no speed. The sinkage is the
        `middle_sinkage` of absolute values, since a wrong zero can make measured ones negative.
        """
        data = self.data
        rows = data.rows
        r = data.wheel.radius
        wheel = data.setup.wheel
        speed = rows.conditions[:, 0]
        middle = 0.0
        sliding = 0.0
        if np.all(speed > 0.0):
            middle = gmean(speed)
            slide = sliding_speeds(rows.slip, speed)
            sliding = gmean(slide[slide > 0.0]) if np.any(slide > 0.0) else middle
        load = np.median(rows.load)
        return Bench(
            radius=r,
            load=load,
            pressure=load / (r * data.wheel.width),
            sinkage=middle_sinkage(np.abs(data.y[:, 0]), r),
            speed=middle,
            median_speed=np.median(speed),
            highest_speed=np.max(speed),
            sliding=sliding,
            lowest_slip=np.min(rows.slip),
            lugs=wheel.grouser_count,
            smooth=wheel.grouser_height == 0.0 and not np.any(rows.wheels[:, 2]),
        )

    @property
    def seen(self) -> np.ndarray:
        """[3] True for the channels with a value in use."""
        return np.any(self.used, axis=0)

    @property
    def channels(self) -> tuple[str, ...]:
        """Names of the channels with a value in use, in the order of `CHANNELS`."""
        return tuple(compress(CHANNELS, self.seen))

    def is_given(self, unknown: Unknown) -> bool:
        """True if the setup gives a prior of this soil parameter, of S also by `k_c` and `k_phi`.

        False for the tilt and for parameters of effects.
        """
        return unknown.name in BROAD and given_prior(self.data.setup, unknown.name) is not None

    def unknowns(self, choices: Choices) -> tuple[Unknown, ...]:
        """Unknowns of a model: soil first, then the free parameters of the effects in order.

        A parameter with a centre is fitted in its logarithm. Any other has its neutral value for
        the prior mean, the gain of slip-sinkage the `dig_gain` of the setup. A prior or centre that
        the rig sets (`scales`, `centres`) goes first; its bounds never exceed the parameter's own.
        """
        return (*self.soil, *(self._of_effect(c.effect, n) for c in choices for n in c.free))

    def _of_effect(self, effect: str, name: str) -> Unknown:
        """`Unknown` of the parameter `name`, "<effect>_<parameter>", of an effect, with the prior
        and the bounds that `unknowns` states.
        """
        p = LAWS[effect].parameter(name.removeprefix(f"{effect}_"))
        if p.centre is not None:
            centre = self.centres.get(name, p.centre)
            low = math.log(max(p.low, LEAST_OF_CENTRE * centre))
            return Unknown(name, math.log(centre), p.scale, low, math.log(p.high), log=True)
        sd, low, high = self.scales.get(name, (p.scale, p.low, p.high))
        mean = self.laws["dig_gain"] if name == "slip_sinkage_gain" else p.neutral
        return Unknown(name, mean, sd, max(low, p.low), min(high, p.high), log=False)

    def effects(self, choices: Choices, values: Values) -> Effects:
        """`Effects` of the world: those of the `choices` that are in the catalogue, with parameters
        `values` by name; all else neutral.
        """
        numbers: dict[str, float] = {}
        for choice in (c for c in choices if c.effect in CATALOGUE):
            numbers |= choice.fixed | {name: values[name] for name in choice.free}
        return self.neutral._replace(**numbers)

    def predict(
        self,
        values: dict[str, float],
        choices: Choices,
        guess: np.ndarray,
        rows: Rows | None = None,
        peak_shift: float = 0.0,
    ) -> np.ndarray:
        """What the rig reads by the model with these effects: sinkage [m], pull [N] and torque
        [N m], [N, 3]; NaN where the model has no value.

        `values`: fitted parameters by name. `guess` [N]: sinkages [m] to start from, overwritten by
        the solution. `rows`: those of the table if None. `peak_shift`: of a
        `form_error.StressChange`.

        Errors of the rig and laws without a name change the rows before the laws of the world, and
        the outcome after them.
        """
        fx = shifted(self.effects(choices, values), peak_shift)
        soil = self.known | values
        unit_weight = self.density * self.data.setup.gravity
        # Parameters of errors of the rig and of laws without a name.
        outside = {
            name: values[name] for c in choices if c.effect not in CATALOGUE for name in c.free
        }
        if "tilt_angle_deg" in outside:  # resolved by `predict_table` as a tilt of the setup
            soil["tilt_deg"] = outside["tilt_angle_deg"]
        rows = true_rows(rows or self.data.rows, outside)
        by_row = factors(rows, outside, self.bench)

        def outcome(under: Rows) -> np.ndarray:
            """Steady values [N, 3] by the laws of the world."""
            return predict_table(self.data.setup, under, soil, unit_weight, fx, guess, by_row)

        out = in_balance(loaded(rows, outside, self.bench.load), outside, outcome)
        return reading(changed(out, rows, outside, self.bench), outside, rows)

    @property
    def sd(self) -> np.ndarray:
        """[N, 3] standard deviation of the noise of each value [m, N, N m]."""
        return self.noise * self.data.relative_sd

    @property
    def rms_noise(self) -> np.ndarray:
        """[3] root mean square of `sd` over the values in use of each channel [m, N, N m]; `noise`
        where none is in use.
        """
        return self.noise * np.where(self.seen, self._rms(self.data.relative_sd), 1.0)

    def _rms(self, values: np.ndarray) -> np.ndarray:
        """[3] root mean square of values [N, 3] over those in use of a channel, 0 without any."""
        square = np.sum(values**2, axis=0, where=self.used)
        return np.sqrt(square / np.maximum(self.used.sum(axis=0), 1))

    def whiten(self, values: np.ndarray) -> np.ndarray:
        """[M, ..] the values in use of an array [N, 3, ..], each over its noise."""
        # Transposed, since further axes of `values` come last, and `sd` has none.
        return (values.T / self.sd.T).T[self.used]

    def without(self, rows: np.ndarray) -> Problem:
        """A copy of the problem that does not use the values of `rows` [N, bool].

        Noise and its freedom, priors, `size` and processes of form errors stay those of the whole
        table.
        """
        rest = copy.copy(self)
        rest.used = self.used & ~rows[:, None]
        return rest

    def fit(
        self,
        choices: Choices = (),
        start: dict[str, float] | None = None,
        sizes: Sizes = NOISE_ALONE,
        near: Fit | None = None,
    ) -> Fit:
        """Most probable parameters of the model with the given effects.

        `start`: parameters by name; others start at their prior mean.
        `near`: a fit to the same table, whose form errors at these `sizes` are in the covariance.
        Without it the covariance is that of the noise times the scatter, and no other size counts.
        No given start is nearer to a bound than `_SAME`, no other than `_OFF_BOUND`. Output,
        derivatives and form errors of the `Fit` are those at its optimum; a residual is `NO_VALUE`
        where the model has no value there.
        """
        law = Law(self, choices)
        low, high = law.bounds
        start = start or {}
        given = [k.name in start for k in law.unknowns]
        u = np.array([k.at(start[k.name]) if k.name in start else 0.0 for k in law.unknowns])
        off_bound = np.where(given, _SAME, _OFF_BOUND) * np.minimum(high - low, 1.0)
        u = np.clip(u, low + off_bound, high - off_bound)
        # A factor of the inverse of the covariance, which `whitened` applies.
        root = None if near is None else compressed(near.columns(sizes) / sizes.scatter)
        # The derivatives of `near` need not be found again.
        if near is not None and near.choices == choices and np.allclose(u, near.u, 0.0, _SAME):
            law.derivatives.know(u, near.jacobian)
        u, converged = law.fitted(u, lambda values: whitened(root, values / sizes.scatter))
        counted = sizes if near is not None else NOISE_ALONE._replace(scatter=sizes.scatter)
        output = law.output(u)
        residual = self.whiten(self.data.y) - self.whiten(output)
        added = law.added(u, output)
        form_errors = law.form_errors(u, output, added)
        free = [in_channels(self.free_functions, size) for size in np.diag(self.size)]
        return Fit(
            choices=choices,
            unknowns=law.unknowns,
            u=u,
            output=output,
            added=added,
            residual=finite(residual, NO_VALUE),
            jacobian=law.derivatives(u),
            form_errors=tuple(map(self.whiten, form_errors)),
            free=tuple(map(self.whiten, free)),
            converged=converged,
            sizes=counted,
        )

    def effect_process(self, choice: Choice) -> Process:
        """Process of the form error of an effect, over what the base law depends on and the
        conditions that the effect depends on.
        """
        return self.effect_processes[LAWS[choice.effect].conditions]


class Law:
    """The model of a table with some effects as a function of the whitened unknowns u [p].

    `guess` [N]: sinkages [m] that a prediction starts from; every `output` overwrites this array
    with its own. `priors`: fields of `Unknown` that differ from those of `Problem.unknowns`, by
    name of the unknown.
    """

    def __init__(
        self,
        problem: Problem,
        choices: Choices,
        guess: np.ndarray | None = None,
        priors: Mapping[str, Mapping[str, Any]] = MappingProxyType({}),
    ) -> None:
        self.problem = problem
        self.choices = choices
        self.unknowns = tuple(
            k._replace(**priors.get(k.name, {})) for k in problem.unknowns(choices)
        )
        self.bounds = bounds_of(self.unknowns)
        self.guess = np.zeros(problem.data.rows.slip.size) if guess is None else guess
        #: [M, p] derivatives of the whitened output by the whitened unknowns (differences).
        self.derivatives = Last(self._derivatives)

    def values(self, u: np.ndarray) -> dict[str, float]:
        """Values of the unknowns by name at u."""
        return parameters_at(self.unknowns, u)

    def output(self, u: np.ndarray) -> np.ndarray:
        """[N, 3] sinkage, pull and torque that the rig reads at u; NaN where the model has none.

        `guess` becomes the sinkages found.
        """
        return self.problem.predict(self.values(u), self.choices, self.guess)

    def _derivatives(self, u: np.ndarray) -> np.ndarray:
        """[M, p] `derivatives` at u, near which `output` was called last.

        Each prediction starts from sinkages a little off (`OFF_GUESS`) those found then, from which
        the solver would end at once.
        """

        def model(x: np.ndarray) -> np.ndarray:
            """[M] whitened output at whitened unknowns x [p]."""
            guess = OFF_GUESS * self.guess
            return self.problem.whiten(self.problem.predict(self.values(x), self.choices, guess))

        return differences(model, u, self.unknowns)

    def added(self, u: np.ndarray, output: np.ndarray) -> tuple[np.ndarray, ...]:
        """What each of the `choices` adds [N, 3]: the `output` at u less that of the same
        parameters without this choice; 0 where the model has no value.
        """
        values = self.values(u)
        rest = (tuple(c for c in self.choices if c != left_out) for left_out in self.choices)
        return tuple(
            finite(output - self.problem.predict(values, others, self.guess.copy()))
            for others in rest
        )

    def stresses(self, u: np.ndarray, output: np.ndarray) -> list[np.ndarray]:
        """Derivatives [N, 3] of the output at u by the relative size of each of the five
        `form_error.stress_changes`; the median of the `output` at u gives their typical sinkage.
        """
        values = self.values(u)
        sinkage = np.nanmedian(output[:, 0])

        def outcome(change: StressChange) -> np.ndarray:
            """[N, 3] output at u under a change of the stresses."""
            return self.problem.predict(
                values | change.soil,
                self.choices,
                OFF_GUESS * self.guess,
                peak_shift=change.peak_shift,
            )

        return by_stresses(outcome, self.problem.known | values, sinkage)

    def form_errors(
        self,
        u: np.ndarray,
        output: np.ndarray,
        added: Sequence[np.ndarray],
        at: Conditions | None = None,
    ) -> list[np.ndarray]:
        """Blocks as in `Fit.form_errors`, each [N, 3, R] in [m, N, N m], at u and at the size 1.

        They are the nuisances of the instrument, the form errors of the effects, and one block of
        the base law for each of `ALL_LAW_LENGTHS`.

        The error of the base law acts on the stresses. That of an effect is a factor on what it has
        `added`, of its own for each channel that the effect `moves`. For an effect with `any_form`
        it is one factor for all of them, `ANY_FORM` times as large. `output`: that at u. `at`:
        conditions of the rows, where they are not those of the processes.
        """
        problem = self.problem

        def functions_of(process: Process) -> np.ndarray:
            """[N, R] functions of a process at the rows."""
            return process.at_points if at is None else process.at(at)

        stresses = np.stack(self.stresses(u, output), axis=2)
        laws = [
            (stresses[..., None] * functions[:, None, None, :]).reshape(*output.shape, -1)
            for functions in map(functions_of, problem.law_processes)
        ]
        blocks = [np.zeros((*output.shape, 0))]
        for choice, factor in zip(self.choices, added, strict=True):
            functions = functions_of(problem.effect_process(choice))
            moved = np.array([name in LAWS[choice.effect].moves for name in CHANNELS])
            units = [ANY_FORM * moved] if LAWS[choice.effect].any_form else np.eye(3)[moved]
            blocks += [in_channels(functions, factor * unit) for unit in units]
        data = problem.data
        rig = nuisances(
            data.setup, problem.bench, data.rows, finite(output), effect_names(self.choices)
        )
        return [rig, np.concatenate(blocks, axis=2), *laws]

    def fitted(self, start: np.ndarray, whiten: ArrayFunction) -> tuple[np.ndarray, bool]:
        """(most probable u, True if the search converged), from u = `start`.

        `whiten`: C^-1/2 of values over the noise, [M] or [M, p], with C their covariance. The
        derivatives are over the noise already.
        """
        over_noise = self.problem.whiten
        u, _, converged = most_probable(
            whiten(over_noise(self.problem.data.y)),
            lambda x: whiten(over_noise(self.output(x))),
            lambda x: whiten(self.derivatives(x)),
            start,
            self.bounds,
            **COARSE,
        )
        return u, converged


def calibrate(data: Data) -> tuple[Problem, NoiseEstimate]:
    """(`Problem`, estimate of its noise) of a table, with outliers left out.

    A first fit of the base model under `rough_noise` gives the surface about which noise and
    outliers are found. Noise of slip and load that the setup states counts as noise of the
    channels. `Problem.freedom` is the least of the channels' degrees of freedom.
    """
    first = Problem(data, rough_noise(data), data.measured)
    fit = first.fit()

    def base(rows: Rows) -> np.ndarray:
        """Values [N, 3] of the calibrated base model."""
        return first.predict(fit.parameters(), (), sinkage_guess(fit.output), rows)

    data, counted = with_noise_of_conditions(data, base)
    noise = dataclasses.replace(find_noise(data, fit.output), of_conditions=counted)
    return Problem(data, noise.sd, noise.used, np.min(noise.freedom)), noise
