"""Info of the environments of a wheel, in the same words for one wheel and for many."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from soil_env._compiled.flags import names_of
from soil_env._io.loading import ParameterError
from soil_env.identification import Status
from soil_env.identification.published import FORESEEN, Traversability, published
from soil_env.parameters import Scenario
from soil_env.simulation.task import REWARD_TERMS, Cause, layout
from soil_env.simulation.world.wheel import WHEEL

from .wheels import Simulation

#: Values of the keyword `info`: all groups nested; those that need no estimate; all as flat
#: numbers; what costs next to nothing; nothing. "full" and "numeric" ask for an estimate of the
#: soil.
INFOS = ("full", "state", "numeric", "short", "none")
NESTED = ("full", "state")  # of them, with groups
IMMOBILISED = (Cause.ENTRAPPED, Cause.STALLED, Cause.BOGGED)
STUCK = np.array([cause in IMMOBILISED for cause in Cause])  # [causes] bool, by number of the cause
_STUCK = STUCK.tolist()
_CAUSES = tuple(cause.name for cause in Cause)
_TERMS = tuple(f"reward_{name}" for name in REWARD_TERMS)
STATE = names_of(WHEEL)[: names_of(WHEEL).index("grade") + 1]  # motion and forces
assert WHEEL.fields is not None
_TERMS_AT = WHEEL.fields["terms"][1] // 8  # place of the reward terms among the numbers of a wheel
_TERMS_END = _TERMS_AT + len(REWARD_TERMS)
Info = dict[str, Any]  # of a vehicle, or arrays of many
_COLUMNS = Traversability._fields
# places of load and pitch in an observation
_SEEN = [[e.name for e in layout("blind")].index(name) for name in ("load", "pitch")]


def checked(kind: object, observation: str = "identified") -> str:
    """The keyword `info` as one of `INFOS`: None stands for "full" with an observation
    "identified", for "state" with the others. ParameterError for any other value.
    """
    if kind is None:
        return "full" if observation == "identified" else "state"
    if kind not in INFOS:
        raise ParameterError(f"info = {kind!r}: expected one of {', '.join(map(repr, INFOS))}")
    return str(kind)


def asks(kind: str) -> bool:
    """True if this kind of info asks for an estimate of the soil."""
    return kind in ("full", "numeric")


def flat(nested: Mapping[str, Any], prefix: str = "") -> Info:
    """All numbers of a full info without nesting; causes and statuses in words become numbers.

    Keys: `reward_NAME`, `estimate_NAME`, `NAME` of state and traversability; `AXLE_NAME`,
    `AXLE_estimate_NAME` of an axle. Each begins with `prefix`.
    """
    prefixes = {
        "reward_terms": "reward_",
        "state": "",
        "traversability": "",
    }
    out: Info = {}
    for key, value in nested.items():
        if isinstance(value, Mapping):
            out |= flat(value, prefix + prefixes.get(key, f"{key}_"))
        elif isinstance(value, str):
            out[prefix + key] = (Cause if key == "cause" else Status)[value].value
        else:
            out[prefix + key] = value
    return out


def _numbers(info: Mapping[str, Any]) -> dict[str, np.number]:
    """Numpy numbers of a flat info, for readers that ask for a dtype: float64, but int64 for
    causes, statuses and truth values.

    True is 1, since the vector environments of gymnasium would gather `np.bool_` as objects.
    """
    return {
        name: np.float64(value) if isinstance(value, float) else np.int64(value)
        for name, value in info.items()
    }


def _whole(info: Mapping[str, np.ndarray]) -> Info:
    """Arrays of a flat info with causes and statuses as int64, the type that `_numbers` gives them.
    Arrays of truth values stay bool, to serve as masks.
    """
    return {
        name: values if values.dtype.kind in "fb" else values.astype(np.int64)
        for name, values in info.items()
    }


class VehicleInfos:
    """Infos of the vehicles of one simulation, of a `kind` of `INFOS`."""

    def __init__(self, simulation: Any, kind: str) -> None:
        self.scenario = simulation.scenario
        self.kind = kind
        self._simulation = simulation

    def many(self) -> Info:
        """Info of all vehicles, arrays [vehicles]; causes and statuses are numbers. Groups are
        nested with "full" and "state"; {} with "none".
        """
        if self.kind == "none":
            return {}
        worlds = self._simulation.worlds
        info = {"cause": worlds.cause.copy(), "immobilised": STUCK[worlds.cause]}
        terms = {name: worlds.terms[:, i].copy() for i, name in enumerate(REWARD_TERMS)}
        if self.kind == "short":
            short = dict(zip(_TERMS, terms.values(), strict=True))
            return _whole(info | {"x": worlds.state["x"].copy()} | short)
        full = info | {"reward_terms": terms} | self._groups()
        return full if self.kind != "numeric" else _whole(flat(full))

    def _groups(self) -> Info:
        """Groups of a full info, arrays [vehicles]: states, and what is estimated if the kind asks
        for it.
        """
        raise NotImplementedError


class Infos(VehicleInfos):
    """Infos of the wheels of one `Simulation`.

    The group `traversability` is that of the last change of the estimate, with the load and the
    pitch observed then, but for its probabilities of immobilisation, which are of now.
    """

    def __init__(self, simulation: Simulation, kind: str) -> None:
        super().__init__(simulation, kind)
        self._assess: Any = None
        self._foresight: Any = None
        if simulation.belief is not None:
            from soil_env.identification.online.ground import assess_ground
            from soil_env.identification.online.immobilisation import ImmobilisationWarning

            self._assess = assess_ground
            self._foresight = ImmobilisationWarning(self.scenario)
        self._traversability = np.zeros((simulation.count, len(_COLUMNS)))

    def one(self, k: int) -> Info:
        """Info of wheel k: in words and numbers of Python with "full" and "state", else numbers of
        numpy; {} with "none".
        """
        if self.kind == "none":
            return {}
        worlds = self._simulation.worlds
        cause = worlds.cause.item(k)
        if self.kind == "short":
            return {
                "cause": worlds.cause[k],
                "immobilised": np.int64(_STUCK[cause]),
                "x": worlds.state["x"][k],
                **dict(zip(_TERMS, worlds.terms[k].copy(), strict=True)),
            }
        # the record as plain numbers: `STATE` first, the reward terms from `_TERMS_AT` on
        numbers = worlds.state[k : k + 1].view(np.float64)
        info = {
            "cause": _CAUSES[cause],
            "immobilised": _STUCK[cause],
            "reward_terms": dict(zip(REWARD_TERMS, numbers[_TERMS_AT:_TERMS_END].tolist())),  # noqa: B905 (hot)
        }
        if asks(self.kind):
            ids = worlds.ids
            gain = self.scenario.belief.dig_gain
            known = published(ids.estimate[k].tolist(), ids.sd[k].tolist(), gain)
            info["estimate"] = known | {"status": Status(ids.status.item(k)).name}
            only = np.array([k])
            ground = dict(zip(_COLUMNS, self._renewed(worlds, only)[k].tolist(), strict=True))
            foreseen = self._foreseen(worlds, only)[0].tolist()
            ground["passable"] = ground["passable"] > 0.0
            info["traversability"] = ground | dict(zip(FORESEEN, foreseen, strict=True))
        info["state"] = dict(zip(STATE, numbers[: len(STATE)].tolist()))  # noqa: B905 (hot)
        return info if self.kind != "numeric" else _numbers(flat(info))

    def _foreseen(self, worlds: Any, rows: np.ndarray) -> np.ndarray:
        """Probabilities [n, 2] of immobilisation of the wheels `rows` [n], within each of
        `identification.published.HORIZONS`.
        """
        ids = worlds.ids
        return self._foresight.assess(rows, worlds.recent, ids.estimate, ids.sd).probabilities

    def _renewed(self, worlds: Any, rows: np.ndarray) -> np.ndarray:
        """Traversability of all wheels, [wheels, 6] in the order of `Traversability`.

        Those of `rows` [n] whose estimate has changed since the last call are computed anew first.
        The array is that of this object: callers copy what they return.
        """
        rows = rows[worlds.changed[rows] > 0]
        if rows.size:
            ids = worlds.ids
            seen = worlds.observation[:, _SEEN].astype(np.float64)
            setting = self._simulation.belief
            self._assess(rows, ids.estimate, ids.sd, seen, setting, self._traversability)
            worlds.changed[rows] = 0
        return self._traversability

    def _groups(self) -> Info:
        """State, and if the kind asks for them estimate and traversability, arrays [wheels]."""
        worlds = self._simulation.worlds
        groups = {"state": {name: worlds.state[name].copy() for name in STATE}}
        if not asks(self.kind):
            return groups
        rows = np.arange(self._simulation.count)
        ground = dict(zip(_COLUMNS, self._renewed(worlds, rows).T.copy(), strict=True))
        ground["passable"] = ground["passable"] > 0.0
        ground |= dict(zip(FORESEEN, self._foreseen(worlds, rows).T.copy(), strict=True))
        return {
            "estimate": estimates(worlds.ids, self.scenario),
            "traversability": ground,
            **groups,
        }


def estimates(known: Any, scenario: Scenario) -> dict[str, np.ndarray]:
    """`published` estimates of the soil under each wheel with their `status`, arrays [wheels] or
    [rovers, axles].

    `known`: `ids` or `known` of `Worlds`.
    """
    mean, sd = (np.moveaxis(array, -1, 0).copy() for array in (known.estimate, known.sd))
    found = published(mean, sd, scenario.belief.dig_gain, np)
    return found | {"status": known.status.copy()}


def masked(info: Info, which: np.ndarray) -> Info:
    """The part of an info that belongs to the vehicles `which` [vehicles] bool, in the form of
    Gymnasium's vector environments.

    `info`: arrays [vehicles] or dicts of them. Values are 0 where `which` is False, and beside each
    key stands a copy of `which` as `_key`.
    """
    out: Info = {}
    for key, value in info.items():
        out[key] = (
            masked(value, which)
            if isinstance(value, dict)
            else np.where(which, value, value.dtype.type(0))
        )
        out[f"_{key}"] = which.copy()
    return out
