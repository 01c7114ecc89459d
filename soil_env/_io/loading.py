"""Strict loading: dataclass fields with units and bounds, and YAML into dataclasses.

Every physical number of the package is a field made by `quantity`, which carries its unit and its
admissible range. A value outside the range, an unknown key or a wrong type raises `ParameterError`:
one line with key, value and what was expected.
"""

import dataclasses
import difflib
import functools
import math
import numbers
import sys
import types
import typing
from collections.abc import Iterable, Sequence
from dataclasses import field
from decimal import Context
from pathlib import Path

import numpy as np
import yaml

# Characters of an error's message, and of its two ends where it is longer; own choices.
_LONGEST = 1000
_HEAD = 700
_TAIL = 200
_MOST_SHOWN = 10**15  # largest whole number that an error writes in full
_MOST_QUOTED = 200  # characters of a library's message in an error


class ParameterError(ValueError):
    """A parameter is unknown, of the wrong type or outside its physical range.

    The message is one line. Of one longer than `_LONGEST` the middle is left out, since it may
    quote whatever a file has.
    """

    def __init__(self, message: str = "") -> None:
        text = " ".join(str(message).splitlines())  # a quoted name may have line breaks
        super().__init__(text if len(text) <= _LONGEST else f"{text[:_HEAD]} ... {text[-_TAIL:]}")


class FieldError(ParameterError):
    """The field `name` of a dataclass has a wrong value.

    `problem` is the rest of the message, as " = 3: expected ...". `load` puts the place in the file
    before it, in place of the class.
    """

    def __init__(self, owner: object, name: str, problem: str) -> None:
        self.name = name
        self.problem = problem
        super().__init__(f"{type(owner).__name__}.{name}{problem}")

    def __reduce__(self) -> tuple[typing.Any, ...]:
        """State for copies and pickles: message, `name` and `problem`, without the dataclass.

        It is made anew without `__init__`, which would need the dataclass.
        """
        return FieldError.__new__, (FieldError, str(self)), vars(self)


def quantity(
    unit: str,
    low: float = -math.inf,
    high: float = math.inf,
    *,
    default=dataclasses.MISSING,
    doc: str = "",
):
    """A dataclass field for a number in [low, high] of the given unit, both ends included, or for a
    tuple of numbers that are; a pair must not fall.

    `doc` is its meaning, which errors and `soil-env describe` show. Only classes derived from
    `Checked` check it.
    """
    return field(default=default, metadata={"unit": unit, "low": low, "high": high, "doc": doc})


def _of_python(value: typing.Any) -> typing.Any:
    """`value` as Python's own number if it is a real number of numpy, else `value` itself."""
    return value.item() if isinstance(value, numbers.Real) and hasattr(value, "item") else value


def said(value: object) -> str:
    """A value as an error writes it: its `repr`, but a whole number beyond `_MOST_SHOWN` rounded to
    six digits.
    """
    if type(value) is int and abs(value) > _MOST_SHOWN:
        return f"{Context(prec=6).create_decimal(value).normalize():e}"
    return repr(value)


def _bound(x: float) -> str:
    """A bound as an error writes it: to six digits, a whole number that needs more in full."""
    short = f"{x:g}"
    return str(x) if isinstance(x, int) and float(short) != x else short


_hints = functools.cache(typing.get_type_hints)  # {field: type} of a class, found once


class Checked:
    """Base of the parameter classes: every `quantity`, every `Literal` and every field that is
    itself a parameter class is checked on construction, `FieldError` for a wrong one.

    A `quantity` is finite and in its range, or None where its type has None. Whole numbers in a
    field of floats become floats: compiled code would be compiled anew for them. Mappings, tuples
    and texts are checked as those of a file.
    """

    def __post_init__(self) -> None:
        """Check each field by itself, in their order, then `_check_together`."""
        own: typing.Any = type(self)
        for f in dataclasses.fields(own):
            name = f.name
            hint = _hints(own)[name]
            origin = typing.get_origin(hint)
            items = typing.get_args(hint)
            value = getattr(self, name)
            if origin is typing.Literal and value not in items:
                raise FieldError(self, name, str(unknown_value(value, items)))
            parts = [k for k in (hint, *items) if isinstance(k, type) and issubclass(k, Checked)]
            is_part = origin in (None, typing.Union, types.UnionType)
            if is_part and parts and not isinstance(value, hint):
                expected = f"a {parts[0].__name__}{' or None' if items else ''}"
                raise FieldError(self, name, f" = {said(value)}: expected {expected}")
            if "unit" in f.metadata and not (value is None and type(None) in items):
                if origin is tuple and not isinstance(value, tuple):
                    raise FieldError(self, name, f" = {said(value)}: expected a tuple")
                _check_quantity(self, f, value)
            object.__setattr__(self, name, _convert(hint, value, f"{own.__name__}.{name}"))
        self._check_together()

    def _check_together(self) -> None:
        """Raise `ParameterError` where fields, each right by itself, do not go together; a class
        whose fields can contradict each other has this method.
        """


def _check_quantity(owner: Checked, f: dataclasses.Field, value: typing.Any) -> None:
    """Raise `FieldError` unless the value of a `quantity`, or each of a tuple, is a finite number
    in its range, and a pair does not fall.
    """
    low = f.metadata["low"]
    high = f.metadata["high"]
    for x in map(_of_python, value if isinstance(value, tuple) else (value,)):
        is_number = isinstance(x, (int, float)) and not isinstance(x, bool)
        if not (is_number and low <= x <= high and abs(x) <= sys.float_info.max):
            end = ")" if high == math.inf else "]"
            limits = f"[{_bound(low)}, {_bound(high)}{end} {f.metadata['unit']}".rstrip()
            means = f" ({doc})" if (doc := f.metadata["doc"]) else ""
            raise FieldError(
                owner, f.name, f" = {said(value)}: expected a number in {limits}{means}"
            )
    if isinstance(value, tuple) and len(value) == 2 and value[0] > value[1]:
        raise FieldError(owner, f.name, f" = {list(value)}: expected the smaller number first")


def unknown_key(key, known, where: str, said: str = "unknown key") -> ParameterError:
    """Return the error for a key that does not exist, with the nearest known name. `said` stands
    before the key.
    """
    return ParameterError(f"{where}: {said} {key!r}{nearest(key, known)} (known: {_listed(known)})")


def unknown_value(value, known, where: str = "") -> ParameterError:
    """Return the error for a value that is none of the known ones, with the nearest of them."""
    expected = f"one of {_listed(known)}" if known else "none"
    return ParameterError(
        f"{where}: unknown value {value!r}{nearest(value, known)} (expected {expected})"
    )


class UnknownKeyword(ParameterError, TypeError):
    """Error for a keyword argument that does not exist, with the nearest known one.

    It is a `TypeError` as Python's own. Without `known`, `key` is the whole message.
    """

    def __init__(self, key, known=()) -> None:
        text = f"unexpected keyword argument {key!r}{nearest(key, known)} (known: {_listed(known)})"
        super().__init__(text if known else key)  # copying and unpickling pass the message alone


#: Keys of quantities that are often written by their symbol.
SYMBOLS = {
    "phi": "friction_angle_deg",
    "K": "shear_modulus",
    "S": "sinkage_coefficient",
    "c": "cohesion",
    "n": "sinkage_exponent",
}


def nearest(name, known) -> str:
    """'; did you mean ...?' with the known name that is most like `name`; "" where none is like it.
    A symbol of `SYMBOLS` counts as the name that it stands for.
    """
    name = SYMBOLS.get(str(name), str(name))
    near = difflib.get_close_matches(name, map(str, known), n=1)
    return f"; did you mean {near[0]!r}?" if near else ""


def plural(count: int, word: str) -> str:
    """The count and the word, with an s unless the count is 1."""
    return f"{count} {word}" + ("" if count == 1 else "s")


Keys = dict[str, typing.Any]  # nested, as in a YAML file
TITLES = 20  # lines of a CSV file, from the first, among which a header is looked for


def refuse_title(path: Path, lines: Iterable[Sequence[str]], names: Iterable[str]) -> None:
    """Raise `ParameterError` where a line below the first has the `names` of columns and the first
    has not: there is a title above the header.

    `lines` are the first ones of the file at `path`, each in cells.
    """
    bare = [[cell.strip().strip('"') for cell in cells] for cells in lines]
    has_names = [set(names) <= set(cells) for cells in bare]
    if any(has_names) and not has_names[0]:
        title = " ".join(filter(None, bare[0]))
        raise ParameterError(
            f"{path}: the header stands below the line {title!r:.80}: expected it first; take out "
            "the lines above, or begin them with #"
        )


def _listed(known) -> str:
    """Known names for an error, in alphabetical order with commas between them."""
    return ", ".join(sorted(map(str, known)))


def load(cls, mapping, where: str = ""):
    """Build dataclass `cls` from a mapping of its fields; nested dataclasses from nested mappings.

    Raises `ParameterError` for unknown or missing keys, wrong types and values out of range. The
    message begins with `where` the mapping came from, a file as a rule, and the path of keys in it:
    "setup.yaml: wheel.radius = 150: ...". Without `where` it begins with the name of the class.

    A class may have `more_keys`, names of keys that are taken out of a file before this is called.
    They are among those that are proposed for a misspelt key.
    """
    where = where or cls.__name__
    names = {f.name: f for f in dataclasses.fields(cls) if f.init}
    if not isinstance(mapping, dict):
        raise ParameterError(
            f"{where}: expected a mapping of {', '.join(names)}, got {said(mapping)}"
        )
    for key in mapping:
        if key not in names:
            raise unknown_key(key, (*names, *getattr(cls, "more_keys", ())), where)
    values = {
        key: _convert(_hints(cls)[key], value, _below(where, key)) for key, value in mapping.items()
    }
    missing = [
        n
        for n, f in names.items()
        if n not in values and f.default is f.default_factory is dataclasses.MISSING
    ]
    if missing:
        raise ParameterError(f"{where}: missing {', '.join(missing)}")
    try:
        return cls(**values)
    except FieldError as error:
        if where == cls.__name__:  # its message begins with the class already
            raise
        raise ParameterError(f"{_below(where, error.name)}{error.problem}") from None
    except ParameterError as error:
        # A message that begins with a field continues the path of keys; any other stands behind it.
        of_field = str(error).startswith(tuple(f"{name}{end}" for name in names for end in " .:"))
        raise ParameterError(
            _below(where, str(error)) if of_field else f"{where}: {error}"
        ) from None


def _below(where: str, key: str) -> str:
    """The place of a key below `where`: "file: key" below a file, "file: section.key" below a
    section.
    """
    return f"{where}{'.' if ': ' in where else ': '}{key}"


def _convert(hint, value, where: str):
    """`value` as the annotated type `hint` of a field; `where`: the place for an error.

    `ParameterError` for a value of another type. Of a union only X | None is known; a hint for
    which there is no rule is a TypeError, a mistake in the class.
    """
    origin = typing.get_origin(hint)
    items = typing.get_args(hint)

    def expect(right: bool, what: str) -> None:
        """Raise `ParameterError`, with `what` was expected, unless the value is `right`."""
        if not right:
            raise ParameterError(f"{where} = {said(value)}: expected {what}")

    if origin in (typing.Union, types.UnionType):  # X | None
        known = next(item for item in items if item is not type(None))
        return None if value is None else _convert(known, value, where)
    if hint is typing.Any:
        return value
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        return value if isinstance(value, hint) else load(hint, value, where)
    if origin is tuple:
        is_list = isinstance(value, (list, tuple))
        if items[1:] == (Ellipsis,):
            expect(is_list, "a list")
            items = items[:1] * len(value)
        expect(is_list and len(value) == len(items), f"a list of {len(items)} values")
        return tuple(_convert(item, v, where) for item, v in zip(items, value, strict=True))
    if hint is dict or origin is dict:
        expect(isinstance(value, dict), "a mapping")
        if not items:
            return value
        return {str(k): _convert(items[1], v, f"{where}.{k}") for k, v in value.items()}
    if origin is typing.Literal:
        expect(value in items, f"one of {', '.join(map(repr, items))}")
        return value
    if hint in (float, int):
        return number(hint, value, where)
    if hint not in (bool, str):
        raise TypeError(f"{where}: no rule to load a {hint!r}")
    expect(isinstance(value, hint), "true or false" if hint is bool else "text")
    return value


def truth(value: object, where: str) -> bool:
    """`value`, a truth value of Python or numpy, as Python's bool.

    `ParameterError`, with the place `where`, for anything else.
    """
    if not isinstance(value, (bool, np.bool_)):
        raise ParameterError(f"{where} = {value!r:.60}: expected True or False")
    return bool(value)


def number(kind: type, value, where: str):
    """`value` as float or int (`kind`), also from the text of a number and from one of numpy.

    `ParameterError`, with the place `where`, for anything else, and for True and False. Infinities
    and NaN pass as floats: the ranges of `quantity` refuse them.
    """
    if isinstance(value, str):  # YAML 1.1 reads 1e6 as text
        try:
            found = float(value)
            # 1e400 stays text and is refused: as a float it would be infinite without being meant.
            if math.isfinite(found) or value.strip(" +-")[:1] in "iInN":
                value = found
        except ValueError:
            pass
    value = _of_python(value)
    if (
        isinstance(value, bool)
        or not isinstance(value, (int, float))
        or sys.float_info.max < abs(value) < math.inf
    ):
        raise ParameterError(f"{where} = {said(value)}: expected a number")
    if kind is int:
        if not math.isfinite(value) or value != int(value):
            raise ParameterError(f"{where} = {value!r}: expected a whole number")
        return int(value)
    return float(value)


def decimal(text: str) -> float:
    """The number that `text` is, nan and inf too; ValueError for any other text, and for 1_0 and
    digits of other scripts, which Python reads as well. Blanks around it pass; 1e400 is inf.
    """
    if "_" in text or not text.isascii():
        raise ValueError(text)
    return float(text)


def merge(base: dict, changes: dict) -> dict:
    """`base` with the values of `changes`; neither argument is modified. Nested values are shared.

    A value replaces that of `base`, but where both are mappings they are merged key by key.
    """
    out = dict(base)
    for key, value in changes.items():
        both = isinstance(value, dict) and isinstance(out.get(key), dict)
        out[key] = merge(out[key], value) if both else value
    return out


def to_dict(instance: object) -> dict[str, typing.Any]:
    """A dataclass as nested plain values, ready for YAML: mappings, and lists for tuples."""

    def plain(x):
        """`x` with dataclasses, mappings, tuples and lists in it made plain, and all else kept."""
        if dataclasses.is_dataclass(x):
            return {f.name: plain(getattr(x, f.name)) for f in dataclasses.fields(x)}
        if isinstance(x, dict):
            return {k: plain(v) for k, v in x.items()}
        return [plain(v) for v in x] if isinstance(x, (tuple, list)) else x

    return plain(instance)


MOST_BYTES = 1_000_000  # of a YAML file; shipped ones are far below, here and in the next two
MOST_VALUES = 20_000  # scalars, lists and mappings of a file
DEEPEST = 40  # levels of nesting
_TOO_MUCH = f"more than {MOST_VALUES} values, or nested deeper than {DEEPEST} levels"


class _Strict(yaml.SafeLoader):
    """SafeLoader that refuses a key given twice, of which YAML would keep the last, and files that
    stand for too much (`MOST_VALUES`, `DEEPEST`).

    Aliases are counted as often as they are used: ten lines of them can stand for more values than
    memory holds.
    """

    values = 0  # counted so far in this file

    def get_single_node(self):
        """The root node of the file, None if it is empty.

        All nodes are checked here, before a value is made of any.
        """
        node = super().get_single_node()
        if node is not None:
            self._check(node, ())
        return node

    def _check(self, node: yaml.Node, above: tuple[yaml.Node, ...]) -> None:
        """Check a node and all below it; `above`: the nodes that it is in.

        Raise `yaml.YAMLError` for more than `MOST_VALUES` values or `DEEPEST` levels, for a node
        that contains itself, and for a key that is given twice.
        """
        self.values += 1
        if self.values > MOST_VALUES or len(above) >= DEEPEST:
            raise _wrong(node, _TOO_MUCH)
        if node in above:
            raise _wrong(node, "a value that contains itself")
        if isinstance(node, yaml.ScalarNode):
            return
        keys = set()
        for item in node.value:  # of a mapping (key, value), of a list a node
            parts = item if isinstance(item, tuple) else (item,)
            for part in parts:
                self._check(part, (*above, node))
            if len(parts) == 2 and isinstance(parts[0], yaml.ScalarNode):
                key = parts[0].value
                if key in keys:
                    raise _wrong(parts[0], f"key {key!r} appears twice")
                keys.add(key)


def _wrong(node: yaml.Node, said: str) -> yaml.YAMLError:
    """Return the error `said` with the line of the node."""
    return yaml.constructor.ConstructorError(None, None, said, node.start_mark)


def _number_of(loader: _Strict, node: yaml.ScalarNode) -> int | float:
    """The number of a YAML node, where it means what a reader takes it for.

    `yaml.YAMLError` for 0150, which YAML 1.1 reads as octal, for 1:30, which it reads in sixtieths,
    and for a number too large for a float. Only inf, written so, is infinite.
    """
    text = node.value.replace("_", "").lstrip("+-")
    whole = node.tag.endswith(":int")
    if ":" in text or (whole and len(text) > 1 and text[0] == "0" and text.isdecimal()):
        raise _wrong(
            node,
            f"{node.value}: expected a decimal number without leading 0 and :, or quoted text",
        )
    found = loader.construct_yaml_int(node) if whole else loader.construct_yaml_float(node)
    if abs(found) > sys.float_info.max and "inf" not in text.lower():
        raise _wrong(node, f"{node.value:.40}: expected a number below {sys.float_info.max:.2g}")
    return found


for _kind in ("int", "float"):
    _Strict.add_constructor(f"tag:yaml.org,2002:{_kind}", _number_of)


def parse_yaml(text: str):
    """The value that a YAML text stands for, None for an empty text.

    `yaml.YAMLError` for a text that is no YAML or that `_Strict` refuses. Other errors of the
    library become one: of impossible numbers and dates, of tags on a value of another kind.
    """
    try:
        return yaml.load(text, _Strict)  # a SafeLoader
    except RecursionError:
        raise yaml.YAMLError(_TOO_MUCH) from None
    # a day 2001-99-99, a number of 5000 digits, !!int [], !!bool x
    except (ValueError, OverflowError, LookupError, AttributeError, TypeError) as error:
        raise yaml.YAMLError(f"{type(error).__name__}: {error}") from None


def read_yaml(path: Path) -> dict:
    """The mapping in a YAML file, {} of an empty one; `ParameterError` if it cannot be read as one
    or is larger than `MOST_BYTES`.
    """
    try:
        with open(path, "rb") as stream:
            raw = stream.read(MOST_BYTES + 1)
        if len(raw) > MOST_BYTES:
            raise ParameterError(
                f"{path}: larger than {MOST_BYTES // 1000} kB: expected a file of parameters"
            )
        content = parse_yaml(raw.decode("utf-8"))
    except OSError as error:
        raise ParameterError(f"{path}: cannot be read ({error.strerror})") from None
    except (yaml.YAMLError, UnicodeDecodeError) as error:
        said = " ".join(str(error).split()).replace('in "<unicode string>", ', "in ")
        raise ParameterError(f"{path}: not valid YAML ({said[:_MOST_QUOTED]})") from None
    if content is None:
        return {}
    if not isinstance(content, dict):
        raise ParameterError(f"{path}: expected a mapping at the top, got {type(content).__name__}")
    return content


def one_line(error: BaseException, which: int = 0) -> str:
    """Line `which` of the message of an error, cut to `_MOST_QUOTED` characters.

    The name of the error's class stands for an empty message. Python's index -1 is the last line.
    """
    return (str(error).strip().splitlines() or [type(error).__name__])[which][:_MOST_QUOTED]


def config_dir() -> Path:
    """Folder of the shipped YAML files."""
    return shipped_dir("configs")


def shipped_dir(name: str) -> Path:
    """A folder that comes with the package: inside it where it is installed, else beside it in the
    clone. Where it is missing, its path in the clone.
    """
    here = Path(__file__).resolve().parents[1]  # soil_env/
    installed = here / name
    return installed if installed.is_dir() else here.parent / name
