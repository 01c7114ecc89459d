"""A complete task of one wheel, and the scenarios of configs/scenarios."""

import os
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any, ClassVar

from soil_env._io.loading import (
    Checked,
    Keys,
    ParameterError,
    config_dir,
    load,
    merge,
    quantity,
    read_yaml,
    to_dict,
    unknown_key,
    unknown_value,
)

from .belief import Belief
from .course import Camera, CourseSpec
from .presets import shipped
from .sensors import Noise
from .soil import EARTH_GRAVITY, Soil, SoilSpread, SoilState, soils
from .task import Control, Limits, RewardWeights
from .wheel import Wheel, with_preset

#: Scenario of the environments, of training and of evaluation, where none is named.
DEFAULT_SCENARIO = "two_lines"
_HEAVIEST = 1e9  # [-] weight of a soil in the draw, so that their sum stays finite; own choice


@dataclass(frozen=True)
class Scenario(Checked):
    """A complete task: wheel, ground, sensors, and what counts as success."""

    more_keys: ClassVar = ("base",)  # of a file, beside the fields

    wheel: Wheel
    # name of a soil -> weight in the draw
    soils: dict[str, float] = field(default_factory=dict)
    # soils by name, beside and before the presets
    own_soils: dict[str, Soil] = field(default_factory=dict)
    name: str = "unnamed"
    gravity: float = quantity("m/s2", 0.1, 30.0, default=EARTH_GRAVITY)
    relaxation: float = quantity(
        "wheel radii", 0.05, 50.0, default=2.0, doc="distance in which sinkage adapts"
    )
    spread: SoilSpread = SoilSpread()
    course: CourseSpec = CourseSpec()
    noise: Noise = Noise()
    camera: Camera = Camera()
    belief: Belief = Belief()
    limits: Limits = Limits()
    reward: RewardWeights = RewardWeights()
    control: Control = Control()

    def _check_together(self) -> None:
        """Raise `ParameterError` for soils that `library` does not have, for their weights, for
        moduli that give no S > 0 here, and for a reward of information without an identifier.

        A weight is in [0, `_HEAVIEST`], in `belief.soils` above 0; those of `soils` are not all 0.
        """
        if not self.soils:
            raise ParameterError("soils: expected at least one soil name with its weight")
        library = self.library
        for place, weights, least in (
            ("soils", self.soils, ">= 0"),
            ("belief.soils", self.belief.soils, "> 0"),
        ):
            for name, weight in weights.items():
                if name not in library:
                    raise unknown_key(name, library, place)
                if not 0.0 <= weight <= _HEAVIEST or (weight == 0.0 and least == "> 0"):
                    expected = f"expected a weight {least}, at most {_HEAVIEST:g}"
                    raise ParameterError(f"{place}.{name} = {weight!r}: {expected}")
        for name in (*self.soils, *self.belief.soils):
            self.beneath(library[name])  # refuses moduli whose S is not positive for this wheel
        if self.belief.method == "none" and self.reward.information > 0.0:
            raise ParameterError(
                "reward.information: expected 0 where belief.method = 'none' identifies nothing"
            )
        if sum(self.soils.values()) <= 0.0:
            raise ParameterError("soils: expected at least one weight > 0")

    @property
    def library(self) -> dict[str, Soil]:
        """{name: soil} that `soils` may name: the presets and `own_soils`, which win where both
        have a name.
        """
        return soils() | self.own_soils

    def beneath(self, soil: Soil) -> SoilState:
        """A soil as compiled code takes it, under this wheel without payload at this gravity
        (`Soil.under`); `ParameterError` where its moduli give no S > 0.
        """
        return soil.under(self.wheel.radius, self.wheel.width, self.weight, self.gravity)

    @property
    def weight(self) -> float:
        """Weight [N] of the wheel with its share of the body, without payload."""
        return self.wheel.body_mass * self.gravity

    @property
    def periods(self) -> int:
        """Control periods until the time limit, to the nearest whole number."""
        return round(self.control.time_limit / self.control.period)

    @property
    def steps(self) -> int:
        """Actions until the time limit, rounded up."""
        return -(-self.periods // self.control.action_periods)


ScenarioLike = str | Path | Keys | Scenario  # name, file, mapping, or as it is


def scenario_names() -> list[str]:
    """Names of the shipped scenarios."""
    return shipped("scenarios")


def load_scenario(
    which: ScenarioLike = DEFAULT_SCENARIO, changes: Keys | None = None, place: str = "changes"
) -> Scenario:
    """A scenario by name, by path of a YAML file, as a mapping or as it is, with `changes` merged
    over it.

    `changes` is a nested mapping. The key `base` of a file or mapping names the scenario that its
    other keys are changes of. Errors in `changes` name `place` as their origin. `wheel` may be the
    name of a preset, or a mapping whose key `preset` names one. `soils`, where given in `changes`,
    replaces the whole mixture. Raises `ParameterError` with one line for anything unknown or out of
    range.
    """
    scenario: Scenario = load_scenario_as(Scenario, "scenarios", which, changes, place)
    return scenario


def load_scenario_as(
    kind: type[Scenario],
    folder: str,
    which: ScenarioLike,
    changes: Keys | None,
    place: str,
    complete: Callable[[Keys], Keys] = dict,
) -> Any:
    """`load_scenario` of the class `kind`, whose shipped scenarios are in a `folder` of configs/.

    `complete` adds to the mapping what follows from the rest of it. With `changes` the scenario is
    first loaded without them: where that succeeds, an error lies in the changes and names `place`.
    """
    changes = {} if changes is None else changes
    if not isinstance(changes, dict):
        raise ParameterError(f"{place} = {changes!r:.60}: expected a mapping")
    mapping, where = _given(kind, folder, which, changes)
    if changes:
        with suppress(ParameterError):
            load(kind, complete(_merged(mapping, {}, where)), where)
            where = place  # all that can be wrong now is in the changes
    return load(kind, complete(_merged(mapping, changes, where)), where)


def _given(
    kind: type[Scenario],
    folder: str,
    which: ScenarioLike,
    changes: Keys,
    above: tuple[Path, ...] = (),
) -> tuple[Keys, str]:
    """(the mapping of a scenario without `changes`, the place it comes from for messages).

    `kind`, `folder`, `which`: as in `load_scenario_as`. The changes serve only to tell a rover from
    a wheel. `above`: the files that led here by their `base`, the nearest last; a path is relative
    to that one, and none of them may be named again.
    """
    singular = folder.removesuffix("s")
    if isinstance(which, dict):
        mapping = _on_base(kind, folder, which, singular, above)
        _check_kind(mapping, changes, folder, singular)
        return mapping, singular
    if isinstance(which, kind):
        mapping = to_dict(which)
        where = f"{singular} {which.name!r}"
        _check_kind(mapping, {}, folder, where)
        return mapping, where
    if not isinstance(which, (str, Path)) or which == "" or "\0" in str(which):
        raise ParameterError(
            f"{singular} = {which!r:.60}: expected a name or the path of a YAML file, or a "
            f"{kind.__name__}"
        )
    path = Path(which)
    if path.suffix not in (".yaml", ".yml"):
        path = _shipped_file(folder, which)
    elif above:  # a path in a file is relative to the file
        path = above[-1].parent / path
    if os.path.realpath(path) in map(os.path.realpath, above):
        raise ParameterError(f"{str(which)!r}: expected a file that is no change of this one")
    mapping = _on_base(kind, folder, read_yaml(path), str(path), (*above, path))
    _check_kind(mapping, changes, folder, f"{singular}: {str(which)!r}")
    mapping.setdefault("name", path.stem)
    return mapping, path.name if path.parent == config_dir() / folder else str(path)


def _on_base(
    kind: type[Scenario], folder: str, mapping: Keys, where: str, above: tuple[Path, ...]
) -> Keys:
    """The mapping of a scenario, without the key `base`: where it has one, merged over the scenario
    that `base` names, but for the `name` of that. `above` as in `_given`.
    """
    own = dict(mapping)
    if "base" not in own:
        return own
    base = own.pop("base")
    if not isinstance(base, str) or not base:
        raise ParameterError(
            f"{where}: base = {base!r:.60}: expected the name of a scenario or the path of its "
            "YAML file"
        )
    try:
        given, _ = _given(kind, folder, base, own, above)
    except ParameterError as error:
        raise ParameterError(f"{where}: base: {error}") from None
    given.pop("name", None)
    return _merged(given, own, where)


def _shipped_file(folder: str, which: str | Path) -> Path:
    """The file of the scenario `which` in a `folder` of configs/; `ParameterError` if there is
    none.
    """
    singular = folder.removesuffix("s")
    path = config_dir() / folder / f"{which}.yaml"
    with suppress(OSError):  # of a text that no file system takes for a name
        if path.is_file():
            return path
        if Path(which).is_dir():
            raise ParameterError(
                f"{singular} = {str(which)!r}: is a folder; expected a name or a YAML file"
            )
        for other in ("scenarios", "rovers"):
            if other != folder and (config_dir() / other / f"{which}.yaml").is_file():
                raise ParameterError(
                    f"{singular}: {which!r} is one of configs/{other}; {_expected(folder)}"
                )
    raise unknown_value(str(which)[:60], shipped(folder), singular)


def _expected(folder: str) -> str:
    """What a message expects: a name of those shipped in a `folder` of configs/, or a path."""
    names = ", ".join(shipped(folder))
    return f"expected one of {names}, or the path of a {folder.removesuffix('s')}'s YAML file"


def _check_kind(mapping: Keys, changes: Keys, folder: str, where: str) -> None:
    """Raise `ParameterError` for a rover where a wheel's scenario is asked for (`folder`
    "scenarios"), or the reverse ("rovers").

    A rover has `vehicle`. A mapping without it is the scenario of a wheel if it is not empty and
    its keys and those of `changes` are all fields of `Scenario`. Any other passes: `load` names
    what it lacks. The message begins with `where`.
    """
    known = {f.name for f in fields(Scenario)}
    if folder == "scenarios" and "vehicle" in mapping:
        raise ParameterError(f"{where} is a rover, having `vehicle`; {_expected(folder)}")
    if folder == "rovers" and mapping and known.issuperset((*mapping, *changes)):
        raise ParameterError(
            f"{where} is the scenario of a wheel, having no `vehicle`; {_expected(folder)}"
        )


def _merged(mapping: Keys, changes: Keys, where: str) -> Keys:
    """The mapping of a scenario with `changes` merged over it; a preset of its wheel is replaced by
    the values of that.

    `soils` in the changes replace the whole mixture. A `belief.soils` that was equal to the old
    mixture follows the new one, without soils of weight 0. `belief.soils` in the changes replace
    it. A wheel in the changes that is no mapping, or that names a `preset`, replaces the
    whole wheel. Neither mapping is modified. `ParameterError`, beginning with `where`, for an
    unknown preset.
    """
    mapping = {key: _plain(value) for key, value in mapping.items()}
    changes = dict(changes)
    belief = _mapping(mapping.get("belief"))
    asked = _mapping(_plain(changes.get("belief")))  # the changes of the belief
    if "soils" in changes:  # replaces the whole mixture
        given = changes.pop("soils")
        if "soils" in mapping and belief.get("soils") == _weighted(mapping["soils"]):
            belief = belief | {"soils": _weighted(given)}
            mapping["belief"] = belief
        mapping["soils"] = given
    if "soils" in asked:
        belief = belief | {"soils": asked["soils"]}
        mapping["belief"] = belief
    if "wheel" in changes:
        wheel = changes["wheel"]
        if not isinstance(wheel, dict):
            mapping["wheel"] = changes.pop("wheel")  # an object stays one
        elif "preset" in wheel:
            mapping.pop("wheel", None)
    if isinstance(mapping.get("wheel"), str):
        mapping["wheel"] = {"preset": mapping["wheel"]}  # to merge changes of its values over it
    mapping = merge(mapping, {key: _plain(value) for key, value in changes.items()})
    if "wheel" in mapping:
        mapping["wheel"] = with_preset(mapping["wheel"], where)
    return mapping


def _weighted(mixture: Any) -> Any:
    """A mixture of soils without those of weight 0; anything else as it is."""
    if not isinstance(mixture, dict):
        return mixture
    return {name: weight for name, weight in mixture.items() if weight != 0.0}


def _plain(value: Any) -> Any:
    """A parameter class as the mapping of its fields; anything else as it is."""
    return to_dict(value) if isinstance(value, Checked) else value


def _mapping(value: Any) -> Keys:
    """The value if it is a mapping, else an empty one: `load` refuses any other value later."""
    return value if isinstance(value, dict) else {}
