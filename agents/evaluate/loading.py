"""Loading and trial of contestants' controllers; failures of foreign code are errors of one
line.
"""

import hashlib
import importlib
import importlib.util
import inspect
import sys
import tempfile
import traceback
from pathlib import Path

import numpy as np

from soil_env._io.loading import ParameterError, nearest
from soil_env.parameters import Scenario
from soil_env.simulation.task import VARIANTS
from soil_env.terramechanics.model import WheelSoilModel

from ..controllers import CONTROLLERS, checked_settings
from ..controllers.rover import controllers_of
from .contestants import Contestant
from .driving import simulate


def load(contestant: Contestant, scenario: Scenario, content: bytes | None = None):
    """The controller: an object with `predict` and `variant`.

    `content`: of a model that is not here.
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
    return _from_class(contestant.source, contestant.name, scenario)


def _from_class(spec: str, name: str, scenario: Scenario):
    module_name, _, attribute = spec.partition(":")
    if "" not in sys.path:
        sys.path.append("")  # an installed command finds modules in the current folder too
    try:
        thing = importlib.import_module(module_name)
    except Exception as error:  # the module may raise anything
        raise ParameterError(
            f"controllers: {spec}: cannot be imported ({describe(error)})"
        ) from None
    for part in attribute.split("."):
        if not hasattr(thing, part):
            known = (
                [n for n in vars(thing) if not n.startswith("_")]
                if hasattr(thing, "__dict__")
                else []
            )
            raise ParameterError(
                f"controllers: {spec}: {module_name} has no {part!r}{nearest(part, known)}"
            )
        thing = getattr(thing, part)
    if inspect.isclass(thing) or (callable(thing) and not hasattr(thing, "predict")):
        try:
            thing = thing(scenario) if _takes_one(thing) else thing()
        except ParameterError as error:
            raise ParameterError(f"controllers: {name}: {error}") from None
        except Exception as error:
            raise ParameterError(
                f"controllers: {spec}: cannot be made ({describe(error)})"
            ) from None
    if not callable(getattr(thing, "predict", None)):
        raise ParameterError(
            f"controllers: {spec}: has no method predict(obs, state, episode_start, deterministic)"
        )
    variant = getattr(thing, "variant", "identified")
    if variant not in VARIANTS:
        raise ParameterError(
            f"controllers: {spec}: variant = {variant!r}: expected one of {', '.join(VARIANTS)}"
        )
    return _Wrapped(thing, variant, spec, getattr(scenario, "axles", 1))


def code_digest(spec: str) -> str:
    """SHA-256 of the file of the module of module:Class; empty if it cannot be found."""
    if "" not in sys.path:
        sys.path.append("")
    try:
        found = importlib.util.find_spec(spec.partition(":")[0])
        content = Path(found.origin).read_bytes() if found and found.origin else b""
    except (ImportError, ValueError, OSError):
        return ""
    return hashlib.sha256(content).hexdigest()


def _takes_one(thing) -> bool:
    try:
        inspect.signature(thing).bind(None)
    except (TypeError, ValueError):
        return False
    return True


class _Wrapped:
    """A controller from elsewhere; an exception in it is an error of one line."""

    def __init__(self, thing, variant: str, spec: str, axles: int):
        self.thing = thing
        self.variant = variant
        self.spec = spec
        self.axles = axles

    def predict(self, observation, state=None, episode_start=None, deterministic: bool = True):
        """As the object's own, with a copy of the observation, checked."""
        try:
            answer = self.thing.predict(
                observation.copy(),
                state=state,
                episode_start=episode_start,
                deterministic=deterministic,
            )
        except Exception as error:
            raise ParameterError(
                f"controllers: {self.spec}: predict failed ({describe(error)})"
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
        action = np.asarray(answer[0], dtype=float)
    except (TypeError, ValueError):
        raise ParameterError(
            f"{where} an action that is no number: expected shape {list(shape)}"
        ) from None
    if action.shape != shape:
        raise ParameterError(
            f"{where} actions of shape {list(action.shape)}: expected {list(shape)}"
        )
    return action, answer[1]


def describe(error: BaseException) -> str:
    """An exception in one line: its class, its message, and where it was raised."""
    ours = __file__, importlib.__file__
    frames = [
        f
        for f in traceback.extract_tb(error.__traceback__)
        if not f.filename.startswith((*ours, "<frozen"))
    ]
    where = f", {Path(frames[-1].filename).name} line {frames[-1].lineno}" if frames else ""
    message = (str(error).splitlines() or [""])[0][:200]
    return f"{type(error).__name__}: {message}{where}"


def check(contestant: Contestant, scenario: Scenario, model: WheelSoilModel | None = None) -> None:
    """Load a contestant and have it act once on three wheels; ParameterError if it cannot."""
    controller = load(contestant, scenario)
    sim = simulate(3, scenario, controller.variant, 1, model)
    for k in range(3):
        sim.seed(k, np.random.default_rng(k))
    fresh = np.ones(3, dtype=bool)
    sim.restart_where(fresh)
    answer = controller.predict(
        sim.worlds.observation, state=None, episode_start=fresh, deterministic=True
    )
    action, _ = _checked(answer, (3, getattr(scenario, "axles", 1)), contestant.label)
    wrong = np.flatnonzero(~np.isfinite(action))
    if wrong.size:
        given = f"{action[wrong[0], 0]} for wheel {wrong[0]}"
        raise ParameterError(
            f"controllers: {contestant.label}: predict gave {given}: expected finite numbers"
        )
