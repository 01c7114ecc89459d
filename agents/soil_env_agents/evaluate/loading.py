"""Loading and trial of contestants' controllers; failures of foreign code are errors of one
line.
"""

import math
import tempfile
from collections.abc import Callable
from numbers import Real
from pathlib import Path
from typing import Any

import numpy as np

from soil_env._io.loading import ParameterError
from soil_env.envs.course_env import real_numbers
from soil_env.parameters import Scenario
from soil_env.simulation.task import VARIANTS
from soil_env.terramechanics.model import WheelSoilModel

from ..controllers import CONTROLLERS, checked_settings
from ..controllers.rover import controllers_of
from .contestants import Contestant
from .driving import simulate
from .own import as_driven, describe, made

_PREDICT = "predict(obs, state, episode_start, deterministic)"


def load(contestant: Contestant, scenario: Scenario, content: bytes | None = None):
    """The controller: an object with `predict`, `variant` and, but for models, `settings`.

    `content`: of the file of a model, where this machine does not have it. ParameterError where the
    contestant cannot be loaded or does not fit the scenario.
    """
    if contestant.kind == "classical":
        known, make = controllers_of(scenario)
        if known is CONTROLLERS:
            checked_settings(
                contestant.source, scenario, contestant.settings, f"--settings.{contestant.name}"
            )
        return make(contestant.source, scenario, **contestant.settings)
    if contestant.kind == "model":
        from .models import load_model  # takes seconds

        source = Path(contestant.source)
        if content is None:
            return load_model(source, scenario)
        with tempfile.TemporaryDirectory() as folder:
            file = Path(folder) / source.name
            file.write_bytes(content)
            return load_model(file, scenario)
    return _from_class(contestant.source, contestant.name, scenario, contestant.settings)


def maker(source: str, scenario: Scenario) -> Callable[..., Any]:
    """Function that makes a controller, a shipped one or `module:Class`, of its settings, given as
    keywords.
    """
    if ":" in source:
        # Without a name of its own it is named by its source in messages.
        return lambda **settings: _from_class(source, source, scenario, settings)
    _, make = controllers_of(scenario)
    return lambda **settings: make(source, scenario, **settings)


def _from_class(spec: str, name: str, scenario: Scenario, settings: dict):
    """The controller of a `module:Thing`, named `name` in messages and wrapped (`_Wrapped`).

    ParameterError where it cannot be made, has no `predict`, or names a `variant` that does not
    exist. Without one it reads `identified`.
    """
    try:
        thing = made(spec, scenario, settings, f"--settings.{name}")
    except ParameterError as error:
        own = str(error).startswith(("controllers: ", "--settings."))
        raise ParameterError(str(error) if own else f"controllers: {name}: {error}") from None
    if not callable(getattr(thing, "predict", None)):
        raise ParameterError(f"controllers: {spec}: has no method {_PREDICT}")
    variant = getattr(thing, "variant", "identified")
    if variant not in VARIANTS:
        raise ParameterError(
            f"controllers: {spec}: variant = {variant!r}: expected one of {', '.join(VARIANTS)}"
        )
    as_driven(thing, scenario, spec)  # refuses what it cannot drive
    made_with = getattr(thing, "settings", settings)
    if not (
        isinstance(made_with, dict)
        and all(isinstance(name, str) for name in made_with)
        and all(isinstance(x, Real) and math.isfinite(x) for x in made_with.values())
    ):
        raise ParameterError(
            f"controllers: {spec}: settings = {made_with!r:.60}: expected a mapping of names to "
            "numbers"
        )
    return _Wrapped(thing, variant, spec, getattr(scenario, "axles", 1), settings)


class _Wrapped:
    """A controller from elsewhere (`thing`, of `module:Thing` in `spec`); an exception in it is an
    error of one line. `settings` are those it was made with, unless it has some of its own.
    """

    def __init__(self, thing, variant: str, spec: str, axles: int, settings: dict):
        self.thing = thing
        self.variant = variant
        self.spec = spec
        self.axles = axles
        self.settings: dict[str, float] = getattr(thing, "settings", settings)
        self.drives: dict = getattr(thing, "drives", {})
        if hasattr(thing, "attach"):
            self.attach = self._attach

    def _attach(self, *simulation) -> None:
        """Call the object's own `attach`; ParameterError where it raises."""
        try:
            self.thing.attach(*simulation)
        except (Exception, SystemExit) as error:
            raise ParameterError(
                f"controllers: {self.spec}: attach failed ({describe(error)})"
            ) from error

    def predict(self, observation, state=None, episode_start=None, deterministic: bool = True):
        """(actions [n, axles], state) of the object's own `predict`, which gets a copy of the
        observation; ParameterError where it raises, or returns anything else.
        """
        try:
            answer = self.thing.predict(
                observation.copy(),
                state=state,
                episode_start=episode_start,
                deterministic=deterministic,
            )
        except (Exception, SystemExit) as error:
            # An error without a frame below this one is of the call: of other arguments.
            called = error.__traceback__ is not None and error.__traceback__.tb_next is not None
            expected = "" if called else f": expected {_PREDICT}"
            raise ParameterError(
                f"controllers: {self.spec}: predict failed ({describe(error)}){expected}"
            ) from error
        return _checked(answer, (len(observation), self.axles), self.spec)


def _checked(answer, shape: tuple[int, int], who: str) -> tuple[np.ndarray, object]:
    """(actions of this shape, state) of a call of `predict`; ParameterError for anything else."""
    where = f"controllers: {who}: predict gave"
    if not (isinstance(answer, tuple) and len(answer) == 2):
        given = (
            f"{len(answer)} values"
            if isinstance(answer, tuple)
            else "nothing"
            if answer is None
            else "one value"
        )
        raise ParameterError(f"{where} {given}: expected (action, state)")
    try:
        action = real_numbers(answer[0])
    except (TypeError, ValueError):
        raise ParameterError(
            f"{where} an action that is no number: expected shape {list(shape)}"
        ) from None
    if action.shape != shape:
        raise ParameterError(
            f"{where} actions of shape {list(action.shape)}: expected {list(shape)}"
        )
    return action, answer[1]


def check(contestant: Contestant, scenario: Scenario, model: WheelSoilModel | None = None) -> str:
    """Load a contestant and have it act once on three wheels; ParameterError if it cannot. Returns
    the observation that it reads.
    """
    controller = load(contestant, scenario)
    rngs = [np.random.default_rng(k) for k in range(3)]
    sim = simulate(rngs, scenario, controller.variant, 1, model)
    if hasattr(controller, "attach"):
        controller.attach(sim, 1, model)
    answer = controller.predict(
        sim.worlds.observation,
        state=None,
        episode_start=np.ones(3, dtype=bool),
        deterministic=True,
    )
    action, _ = _checked(answer, (3, getattr(scenario, "axles", 1)), contestant.label)
    wrong = np.argwhere(~np.isfinite(action))
    if wrong.size:
        course, axle = wrong[0]
        of_axle = f", axle {axle}" if action.shape[1] > 1 else ""
        given = f"{action[course, axle]} for observation {course}{of_axle}"
        raise ParameterError(
            f"controllers: {contestant.label}: predict gave {given}: expected finite numbers"
        )
    variant: str = controller.variant
    return variant
