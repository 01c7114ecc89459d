"""Fit of the model, with or without effects, to a measurement table: the most probable parameters under the priors.

Priors of the soil and the least squares are those of `soil_env.identification` (`priors`, `weighted`), with slip and
load exact: the objective is

    J(u) = sum ((y - f(u)) / sigma)^2 + |u|^2

of the whitened unknowns u. Priors of the setup are widened (`PRIOR_WIDTH`), since a soil a little off its prior must
not be taken for a missing effect.

No published law of an effect is exact. A model with effects therefore carries *slack*: what an effect adds to a channel
may be off by a smooth factor 1 + a_0 + a_1 s + a_2 l + ... of the conditions with a ~ N(0, SLACK^2), which enters the
fit as linear unknowns.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from soil_env.discrepancy.data import CHANNELS, Data
from soil_env.discrepancy.noise import NoiseEstimate, find_noise
from soil_env.identification.priors import USUAL_SINKAGE, Unknown, known_digging, soil_state, soil_unknowns
from soil_env.identification.rig import predict_table
from soil_env.identification.weighted import differences, finite, most_probable
from soil_env.parameters import SoilState
from soil_env.terramechanics.catalogue import CATALOGUE
from soil_env.terramechanics.effects import NO_EFFECTS, Effects, sliding_speed
from soil_env.terramechanics.model import Rows

PRIOR_WIDTH = 1.5
SLACK = 0.01
SLACK_LIMIT = 2.5  # [SLACK] largest form error of any one kind
GRAVITY = 9.81


class Choice(NamedTuple):
    """One effect in one of its published forms."""

    effect: str
    form: int

    @property
    def free(self) -> tuple[str, ...]:
        """Parameters of the form, `<effect>_<parameter>`."""
        return tuple(f"{self.effect}_{p}" for p in CATALOGUE[self.effect].forms[self.form].free)

    @property
    def fixed(self) -> dict[str, float]:
        """Parameters that the form sets."""
        return {f"{self.effect}_{p}": v for p, v in CATALOGUE[self.effect].forms[self.form].fixed}


@dataclass(frozen=True, eq=False)
class Fit:
    """A fitted model. Whitened quantities: residuals in noise sd, unknowns in prior sd."""

    choices: tuple[Choice, ...]
    unknowns: tuple[Unknown, ...]
    u: np.ndarray  # [p]
    objective: float  # J, with slack
    misfit: float  # the part of J without the prior of the unknowns
    output: np.ndarray  # [N, 3] model values
    slackened: np.ndarray  # [N, 3] model values with the fitted form error
    residual: np.ndarray  # [M] whitened (y - f - slack) of the values in use
    jacobian: np.ndarray  # [M, p + slack] d(f)/d(u), whitened; slack columns last
    slack: np.ndarray  # [q] fitted slack unknowns
    evidence: float  # log evidence (Laplace), up to what all models share
    converged: bool
    form_errors: int = 0  # leading slack unknowns that are held within SLACK_LIMIT

    def parameters(self) -> dict[str, float]:
        """Every unknown by name."""
        return {k.name: k.value(u) for k, u in zip(self.unknowns, self.u, strict=True)}

    @property
    def columns(self) -> int:
        """Number of unknowns with slack."""
        return self.jacobian.shape[1]

    def covariance(self) -> np.ndarray:
        """[p + slack, p + slack] of the whitened unknowns (Laplace): inv(I + J'J)."""
        return np.linalg.inv(np.eye(self.columns) + self.jacobian.T @ self.jacobian)

    def linearised(self) -> tuple[np.ndarray, np.ndarray]:
        """(A [M + p, k], e [M + p]): the whitened problem about its solution, the priors as the last p rows.

        Unknowns and form errors that lie at a bound do not move.
        """
        x = np.concatenate([self.u, self.slack])
        free = np.ones(x.size, dtype=bool)
        for k, (unknown, u) in enumerate(zip(self.unknowns, self.u, strict=True)):
            at = unknown.mean + unknown.sd * u
            free[k] = min(at - unknown.low, unknown.high - at) > 1e-4 * unknown.sd
        form = slice(self.u.size, self.u.size + self.form_errors)
        free[form] = np.abs(x[form]) < SLACK_LIMIT - 1e-3
        return np.concatenate([self.jacobian, np.eye(x.size)])[:, free], np.concatenate([self.residual, -x])


#: Parameters about a value that the table sets.
_CENTRED = ("shear_softening_length", "shear_rate_onset_speed")


@dataclass(eq=False)
class Problem:
    """What all fits to one table share: unknowns of the soil, noise, values in use."""

    data: Data
    noise: np.ndarray  # [3]
    used: np.ndarray  # [N, 3] bool, measured and not an outlier
    freedom: float = math.inf  # degrees of freedom that the noise is known to
    soil: tuple[Unknown, ...] = ()
    known: dict[str, float] = field(default_factory=dict)
    scales: dict[str, tuple[float, float, float]] = field(default_factory=dict)  # sd, low, high that the data set
    offset: np.ndarray | None = None  # [N, 3] added to the model, a residual law

    def __post_init__(self):
        setup = self.data.setup
        self.soil, self.known = soil_unknowns(setup, self.data.rows.load, self.data.y[:, 0], PRIOR_WIDTH)
        self.density = 1500.0 if setup.soil.density is None else setup.soil.density.value
        self.digging = known_digging(setup)
        self._effect_scales()
        varied, one = self.data.varied, np.ones(self.data.rows.slip.size)
        common = [one, varied["slip"].scaled]
        if varied["slip"].levels > 2:
            common.append(varied["slip"].scaled ** 2)
        if "load" in varied:
            common.append(varied["load"].scaled)
        self.slack_basis = {  # effect -> [N, B]: slip, load and the condition that the effect itself is about
            e.name: np.stack(common + ([varied[e.varies].scaled] if e.varies in varied else []), axis=1)
            for e in CATALOGUE.values()
        }

    def _effect_scales(self) -> None:
        """Prior scales in the units of this rig, and reference speeds that the data set."""
        rows, r = self.data.rows, self.data.wheel.radius
        load, speed = float(np.median(rows.load)), rows.conditions[:, 0]
        z = self.data.y[:, 0]
        z = float(np.nanmedian(np.abs(z))) if np.any(np.isfinite(z)) else USUAL_SINKAGE * r
        torque, turning = 0.3 * load * r, max(float(np.median(speed)) / r, 1e-6)
        lugs = self.data.setup.wheel.grouser_count
        self.scales = {
            "drivetrain_friction_constant": (0.3 * torque, 0.0, 4.0 * torque),
            "drivetrain_friction_viscous": (0.2 * torque / turning, 0.0, 3.0 * torque / turning),
            "sinkage_offset_offset": (0.3 * z, -0.5 * r, 0.5 * r),
            "shear_softening_sharpness": (4.0, 1.0, 30.0),  # below 1 the law has no peak
            "shear_softening_onset": (0.15 * r, 0.0, 2.0 * r),
            "slip_sinkage_length": (0.3 * z, 0.0, 5.0 * z),
            "slip_sinkage_exponent_slope": (0.5, 0.0, 2.0),  # slip digs: less of it would be another effect
        }
        if lugs is not None:  # as many lugs a radian; part of each one's share is the other lugs'
            self.scales["grousers_blades"] = (lugs / (2.0 * math.pi), 0.0, lugs / math.pi)
        if np.min(rows.slip) > -0.02:  # every published peak of a driven wheel moves forward with slip
            self.scales["stress_peak_shift_slope"] = (0.3, 0.0, 0.9)
        slide = np.array([sliding_speed(i, v) for i, v in zip(rows.slip, speed, strict=True)])
        self.neutral = NO_EFFECTS._replace(shear_softening_length=0.3 * r)
        if np.all(speed > 0.0):
            middle = math.exp(float(np.mean(np.log(speed))))
            slide = slide[slide > 0.0]
            sliding = math.exp(float(np.mean(np.log(slide)))) if slide.size else middle
            self.neutral = self.neutral._replace(
                penetration_rate_reference_speed=middle,
                shear_rate_reference_speed=sliding,
                shear_rate_onset_speed=sliding,
            )

    # --- unknowns and outputs ---

    def unknowns(self, choices: tuple[Choice, ...]) -> tuple[Unknown, ...]:
        """Unknowns of a model: soil first, then the effects in order."""
        out = list(self.soil)
        for choice in choices:
            for full in choice.free:
                p = CATALOGUE[choice.effect].parameter(full[len(choice.effect) + 1 :])
                low, high = p.low, p.high
                if p.centre is not None:
                    centre = getattr(self.neutral, full) if full in _CENTRED else p.centre
                    out.append(Unknown(full, math.log(centre), p.scale, math.log(max(low, 1e-3 * centre)),
                                       math.log(high), True))  # fmt: skip
                    continue
                sd, low, high = self.scales.get(full, (p.scale, low, high))
                low, high = max(low, p.low), min(high, p.high)
                mean = self.digging[0] if full == "slip_sinkage_gain" else p.neutral
                out.append(Unknown(full, mean, sd, low, high, False))
        return tuple(out)

    def state(self, values: dict[str, float]) -> SoilState:
        """The soil of a set of parameters."""
        return soil_state(self.known | values, self.digging)

    def effects(self, choices: tuple[Choice, ...], values: dict[str, float]) -> Effects:
        """The effects of a set of parameters."""
        fx = self.neutral
        for choice in choices:
            fx = fx._replace(**choice.fixed, **{name: values[name] for name in choice.free})
        return fx

    def output(self, unknowns, u, choices, guess: np.ndarray) -> np.ndarray:
        """Model values [N, 3] at whitened unknowns; `guess` [N] of the sinkage is renewed."""
        values = {k.name: k.value(x) for k, x in zip(unknowns, u, strict=True)}
        return self.predict(values, choices, guess)

    def predict(self, values: dict[str, float], choices, guess: np.ndarray, rows: Rows | None = None) -> np.ndarray:
        """Model values [N, 3] of a set of parameters, at other `rows` than those of the table if given."""
        rows, setup, fx = rows or self.data.rows, self.data.setup, self.effects(choices, values)
        out = predict_table(setup, rows, self.known | values, self.density * GRAVITY, fx, guess)
        return out if self.offset is None else out + self.offset

    def sinkage_guess(self, fit: Fit) -> np.ndarray:
        """[N] sinkages to start a prediction from."""
        return np.maximum(fit.output[:, 0], 0.0)

    def whiten(self, values: np.ndarray) -> np.ndarray:
        """[M] of an array [N, 3]: the values in use over the noise."""
        return (values / (self.noise * self.data.relative_sd))[self.used]

    # --- the fit ---

    def fit(self, choices: tuple[Choice, ...] = (), start: dict[str, float] | None = None, slack: bool = True,
            prior_width: float = 1.0) -> Fit:  # fmt: skip
        """Most probable parameters of the model with the given effects.

        `start`: parameters by name; effects that it does not name start a little off neutral. `prior_width` widens the
        soil's priors further.
        """
        unknowns = self.unknowns(choices)
        if prior_width != 1.0:
            soil = len(self.soil)
            unknowns = tuple(k._replace(sd=k.sd * prior_width) for k in unknowns[:soil]) + unknowns[soil:]
        low, high = (np.array([k.bounds[end] for k in unknowns]) for end in (0, 1))
        u = np.array([k.at(start[k.name]) if start and k.name in start else self._first(k) for k in unknowns])
        u = np.clip(u, low + 1e-6 * np.minimum(high - low, 1.0), high - 1e-6 * np.minimum(high - low, 1.0))
        guess = np.zeros(self.data.rows.slip.size)
        u, ok = self._minimise(unknowns, choices, u, low, high, guess, False)
        eta = np.zeros(0)
        if slack and choices:
            q = 3 * sum(self.slack_basis[c.effect].shape[1] for c in choices)
            wide = np.full(q, SLACK_LIMIT)
            both, ok = self._minimise(
                unknowns, choices, np.concatenate([u, np.zeros(q)]), np.concatenate([low, -wide]),
                np.concatenate([high, wide]), guess, True,
            )  # fmt: skip
            u, eta = both[: u.size], both[u.size :]
        return self._finish(unknowns, choices, u, eta, guess, ok)

    @staticmethod
    def _first(unknown: Unknown) -> float:
        """Start of an unknown: the prior mean; strengths that are bounded at their neutral value a little off it."""
        bounded = not unknown.log and unknown.low >= unknown.mean and "_" in unknown.name
        return 0.3 if bounded else 0.0

    def _minimise(self, unknowns, choices, start, low, high, guess, slack):
        p = len(unknowns)

        def model(x):
            out, added = self.parts(unknowns, x[:p], choices, guess, slack)
            return self.whiten(self.with_slack(choices, out, added, x[p:]))

        def derivatives(x):
            return self.derivatives(unknowns, x[:p], x[p:], choices, guess)

        found, _, converged = most_probable(
            self.whiten(self.data.y), model, derivatives, start, (low, high), ftol=1e-5, xtol=1e-4, gtol=1e-4,
            max_nfev=25,
        )  # fmt: skip
        return found, converged

    def parts(self, unknowns, u, choices, guess, slack=True) -> tuple[np.ndarray, list[np.ndarray]]:
        """(output [N, 3], what each effect adds to it [N, 3]); the second is empty without `slack`."""
        values = {k.name: k.value(x) for k, x in zip(unknowns, u, strict=True)}
        full = self.predict(values, choices, guess)
        if not slack:
            return full, []
        rest = (choices[:k] + choices[k + 1 :] for k in range(len(choices)))
        return full, [full - self.predict(values, others, guess.copy()) for others in rest]

    def with_slack(self, choices, out: np.ndarray, added: list[np.ndarray], eta: np.ndarray) -> np.ndarray:
        """Output [N, 3] with the form errors eta of each effect."""
        at = 0
        for choice, a in zip(choices, added, strict=False):
            basis = self.slack_basis[choice.effect]
            weights = eta[at : at + 3 * basis.shape[1]].reshape(3, -1)
            out = out + SLACK * a * (basis @ weights.T)
            at += weights.size
        return out

    def derivatives(self, unknowns, u, eta, choices, guess) -> np.ndarray:
        """[M, p + q] of the whitened output by whitened unknowns (forward differences) and slack (exact)."""
        slack = eta.size > 0

        def model(x):
            there = self.parts(unknowns, x, choices, guess.copy(), slack)
            return self.whiten(self.with_slack(choices, *there, eta))

        out, added = self.parts(unknowns, u, choices, guess, slack)
        base = self.whiten(self.with_slack(choices, out, added, eta))
        columns = differences(model, u, unknowns, base)
        for choice, a in zip(choices, added, strict=False):
            for j in range(3):
                for v in self.slack_basis[choice.effect].T:
                    column = np.zeros_like(a)
                    column[:, j] = SLACK * a[:, j] * v
                    columns.append(self.whiten(column))
        return finite(columns, base.size)

    def _finish(self, unknowns, choices, u, eta, guess, ok) -> Fit:
        output, added = self.parts(unknowns, u, choices, guess, eta.size > 0)
        slack = self.with_slack(choices, output, added, eta)
        residual = self.whiten(self.data.y) - self.whiten(slack)
        residual = np.where(np.isfinite(residual), residual, 1e3)
        j = self.derivatives(unknowns, u, eta, choices, guess)
        misfit = float(residual @ residual + eta @ eta)
        objective = misfit + float(u @ u)
        _, logdet = np.linalg.slogdet(np.eye(j.shape[1]) + j.T @ j)
        return Fit(choices, unknowns, u, objective, misfit, output, slack, residual, j, eta,
                   -0.5 * objective - 0.5 * logdet, ok, eta.size)  # fmt: skip


def calibrate(data: Data) -> tuple[Problem, NoiseEstimate]:
    """`Problem` with its noise found and its outliers left out."""
    spread = np.array([np.nanstd(data.y[:, j]) if data.measured[:, j].any() else 1.0 for j in range(3)])
    rough = np.array([
        getattr(data.setup.noise, name) or max(0.05 * spread[j], 1e-12) for j, name in enumerate(CHANNELS)
    ])  # fmt: skip
    first = Problem(data, rough, data.measured)
    noise = find_noise(data, first.fit().output)
    known = [f for f, o in zip(noise.freedom, noise.origin, strict=True) if o]
    problem = Problem(data, noise.sd, noise.used, float(min(known)))
    return problem, noise
