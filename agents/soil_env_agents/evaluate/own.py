"""Controllers by their source, the name of a shipped one or `module:Thing`: their code and their
settings; what is made of a `module:Thing`.
"""

import ast
import hashlib
import importlib
import importlib.util
import inspect
import math
import site
import sys
import sysconfig
import traceback
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from soil_env._io.loading import ParameterError, nearest
from soil_env.parameters import RoverScenario, Scenario

from ..controllers import CONTROLLERS, Setting, within_bounds
from ..controllers.rover import ROVER_CONTROLLERS


def _search_here() -> None:
    """Have modules in the current folder found, by an installed command too."""
    if "" not in sys.path:
        sys.path.append("")


def imported(spec: str) -> Any:
    """What `module:Thing` names, where Thing may have dots; ParameterError in one line if it cannot
    be imported. The current folder is put on Python's path.
    """
    module_name, _, attribute = spec.partition(":")
    _search_here()
    try:
        thing = importlib.import_module(module_name)
    except (Exception, SystemExit) as error:  # the module may raise anything
        raise ParameterError(
            f"controllers: {spec}: cannot be imported ({describe(error)})"
        ) from None
    for part in attribute.split("."):
        if not hasattr(thing, part):
            known = [n for n in getattr(thing, "__dict__", {}) if not n.startswith("_")]
            raise ParameterError(
                f"controllers: {spec}: {module_name} has no {part!r}{nearest(part, known)}"
            )
        thing = getattr(thing, part)
    return thing


def code_digest(source: str) -> str:
    """SHA-256, in hexadecimal digits, of the code of a `source` `module:Thing`; empty if the module
    cannot be found.

    The code is the file of the module, and what it imports, directly or not, from the folder that
    it was found in. Of an installed module it is its file alone.
    """
    _search_here()
    name = source.partition(":")[0]
    try:
        found = importlib.util.find_spec(name)
        if not found or not found.origin:
            return ""
        file = Path(found.origin)
        files = {file}
        # The folder on Python's path: above the packages that the name has.
        folder = file.parents[name.count(".") + (file.stem == "__init__")]
        if not any(folder.is_relative_to(place) for place in _installed()):
            files |= _imported_files(name, folder)
        content = [file.read_bytes() for file in sorted(files)]
    except (ImportError, ValueError, OSError, IndexError):
        return ""
    return hashlib.sha256(b"".join(content)).hexdigest()


def _installed() -> tuple[str, ...]:
    """Folders of Python and of what is installed for it."""
    paths = [sysconfig.get_path(name) for name in ("stdlib", "purelib", "platlib")]
    return (*paths, *site.getsitepackages(), site.getusersitepackages())


def _imported_files(name: str, folder: Path) -> set[Path]:
    """Files in a folder of a module, of its packages and of what it imports by import statements,
    directly or not; a file that is no Python imports nothing.
    """
    files: set[Path] = set()
    left = [name]
    while left:
        parts = left.pop().split(".")
        if parts[0] == "soil_env":  # of a clone; `code_version` has it
            continue
        for count in range(1, len(parts) + 1):
            base = folder.joinpath(*parts[:count])
            for file in (base / "__init__.py", base.with_name(f"{base.name}.py")):
                if file.is_file() and file not in files:
                    files.add(file)
                    package = parts[:count] if file.stem == "__init__" else parts[: count - 1]
                    left += _imported_names(file, package)
    return files


def _imported_names(file: Path, package: list[str]) -> Iterator[str]:
    """Names of what the import statements of a file import, relative ones as absolute; `package`:
    the parts of the name of its package.
    """
    try:
        tree = ast.parse(file.read_bytes())
    except (OSError, SyntaxError, ValueError):
        return
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            above = package[: len(package) + 1 - node.level] if node.level else []
            origin = [*above, *filter(None, [node.module])]
            yield from (".".join([*origin, alias.name]) for alias in node.names)


def bounds_of_settings(source: str, scenario: Scenario) -> Mapping[str, Setting]:
    """Tunable settings of a controller by name, with their bounds; {} without.

    Of a shipped one or of the user's class (its `bounds`); of a rover those of the controller of
    its wheels.
    """
    if ":" not in source:
        rover = isinstance(scenario, RoverScenario)
        return CONTROLLERS[ROVER_CONTROLLERS[source].of_wheel if rover else source].bounds
    bounds = getattr(imported(source), "bounds", {})
    try:
        found = {name: Setting(*setting) for name, setting in bounds.items()}
        drawable = {
            name: 0.0 <= s.tuned[0] <= s.tuned[1] < math.inf and (s.tuned[0] > 0.0 or not s.log)
            for name, s in found.items()
        }
    except (AttributeError, TypeError, ValueError, IndexError):
        raise ParameterError(
            f"controllers: {source}: bounds = {bounds!r:.80}: expected {{name: Setting}}"
        ) from None
    for name, possible in drawable.items():
        if not possible:
            raise ParameterError(
                f"controllers: {source}: bounds[{name!r}].tuned = {found[name].tuned}: expected "
                "0 <= low <= high, and low above 0 where it is drawn in the logarithm"
            )
    return found


def as_driven(thing: Any, scenario: Any, who: str) -> Any:
    """The scenario as a controller drives it: with the values of `control` in the `drives` of the
    controller, or of its class, in place of the scenario's own.

    ParameterError for keys other than action and repeat, and for wrong values; `who` names the
    controller in the message.
    """
    drives = getattr(thing, "drives", {})
    if not (isinstance(drives, dict) and drives.keys() <= {"action", "repeat"}):
        raise ParameterError(
            f"controllers: {who}: drives = {drives!r:.60}: expected a mapping of action, repeat"
        )
    try:
        control = replace(scenario.control, **drives)
    except ParameterError as error:
        raise ParameterError(f"controllers: {who}: drives: {error}") from None
    return replace(scenario, control=control) if drives else scenario


def made(source: str, scenario: Scenario, settings: dict, where: str) -> Any:
    """The controller of a `source` of the form `module:Thing`.

    An object with `predict` is returned as it is. A class or function is called: with the scenario
    and its `settings` if it has `bounds`, with the scenario if it `_takes_scenario`, else without.
    One with `drives` gets the scenario as it drives it (`as_driven`).

    ParameterError where the call fails, and for wrong settings; `where`: their place, for messages.
    """
    thing = imported(source)
    known = bounds_of_settings(source, scenario)
    values = within_bounds(source, known, scenario, settings, where)
    if inspect.isclass(thing) or (callable(thing) and not hasattr(thing, "predict")):
        says = isinstance(getattr(thing, "drives", None), dict)  # else perhaps its objects do
        driven = as_driven(thing, scenario, source) if says else scenario
        try:
            if known:
                return thing(driven, **values)
            return thing(driven) if _takes_scenario(thing) else thing()
        except ParameterError:
            raise
        except (Exception, SystemExit) as error:
            raise ParameterError(
                f"controllers: {source}: cannot be made ({describe(error)})"
            ) from None
    return thing


def _takes_scenario(thing) -> bool:
    """True for something that can be called with one argument, which it needs or calls `scenario`;
    False for a callable without a readable signature.
    """
    try:
        signature = inspect.signature(thing)
        signature.bind(None)
    except (TypeError, ValueError):
        return False
    first = next(iter(signature.parameters.values()))
    return first.default is first.empty or first.name == "scenario"


def describe(error: BaseException) -> str:
    """An exception in one line: its class, its message, and file and line where it was raised.

    The place is the innermost one in the user's code, if there is any: neither in Python nor in an
    installed library.
    """
    ours = str(Path(__file__).parent), importlib.__file__
    frames = [
        f
        for f in traceback.extract_tb(error.__traceback__)
        if not f.filename.startswith((*ours, "<frozen"))
    ]
    frames = [f for f in frames if not f.filename.startswith(_installed())] or frames
    where = f", {Path(frames[-1].filename).name} line {frames[-1].lineno}" if frames else ""
    message = (str(error).splitlines() or [""])[0][:200]
    return f"{type(error).__name__}: {message}{where}"
