"""Contestants of an evaluation, parsed from `--controllers`; the help of the command lists the
forms.

Models that train.py did not write are unpickled in part, and modules are imported: both run code.
Name only what you trust.
"""

import glob
import hashlib
import re
from collections.abc import Collection
from dataclasses import dataclass, field
from pathlib import Path

from soil_env._io.loading import ParameterError, unknown_key, unknown_value

from ..cli import again
from ..controllers import CONTROLLERS
from ..exported import POLICY
from ..progress import show
from .comparing import ORACLE


@dataclass(frozen=True)
class Contestant:
    """One controller of a study: member `member` of algorithm `name`."""

    name: str
    member: int
    kind: str  # "classical", "model" or "class"
    source: str  # name of the controller, path of the model's file, or module:Thing
    digest: str = ""  # SHA-256 of that file
    settings: dict = field(default_factory=dict)  # of a controller that has some

    @property
    def key(self) -> str:
        """Its name in files, different from that of every other controller of the study."""
        return f"{self.name}/{self.member}"

    @property
    def label(self) -> str:
        """Name for messages."""
        return f"{self.name} ({self.source})" if self.source != self.name else self.name


_NAME = re.compile(r"[\w.+-]+")
MODELS = (".zip", ".onnx", ".npz")  # of Stable-Baselines3, exported, of a default policy
#: Policy that comes with the package: its names in a list, and its class.
SHIPPED = ("default_policy", "default")
SHIPPED_CLASS = f"{__package__.split('.')[0]}.default_policy:DefaultPolicy"
_CLASS = re.compile(r"[A-Za-z_][\w.]*:[A-Za-z_][\w.]*")


def code_in(content: object) -> list[str]:
    """Classes, as module:Class, that the content of a YAML file names as controllers, at any depth:
    code that would be imported and run.

    The class of the shipped policy is left out.
    """
    found = []
    if isinstance(content, dict):
        named = content.get("controller")
        if isinstance(named, str) and ":" in named:
            found.append(named)
        if content.get("kind") == "class":  # of a contestant
            found.append(str(content.get("source")))
        for value in content.values():
            found += code_in(value)
    elif isinstance(content, list):
        for value in content:
            found += code_in(value)
    return [spec for spec in found if spec != SHIPPED_CLASS]


def refuse_code(content: object, where: str, allowed: Collection[str] = ()) -> None:
    """ParameterError where a file names a module that would be imported, but for those `allowed`,
    which the command line names.
    """
    for spec in code_in(content):
        if spec not in allowed:
            raise ParameterError(
                f"{where}: names {spec!r}, which would be imported and run: expected --allow-code "
                "too, if you trust this file"
            )


def parse(
    text: str, settings: dict[str, dict] | None = None, known: Collection[str] = CONTROLLERS
) -> dict[str, Contestant]:
    """{key: contestant} of a comma-separated list; ParameterError with one line for what does not
    exist.

    `settings`: {name of a controller: its settings}; `known`: names of the classical ones. Entries
    with one NAME= are members of one algorithm, all models or all classes; else a name is taken
    once.
    """
    settings = settings or {}
    out: dict[str, Contestant] = {}
    # Kind, text and explicit naming of the first entry of a name.
    first: dict[str, tuple[str, str, bool]] = {}
    items = [item.strip() for item in text.split(",")]
    if not any(items):
        raise ParameterError("controllers: expected at least one, got none")
    for item in items:
        head, equals, rest = item.partition("=")
        named = bool(equals) and _NAME.fullmatch(head) is not None
        name, spec = (head, rest.strip()) if named else ("", item)
        if ORACLE in (name, spec):
            raise ParameterError(
                f"controllers: {ORACLE!r}: --oracle-courses N drives it; expected another name"
            )
        if not spec:
            raise ParameterError(
                f"controllers: {text!r}: an empty entry; expected NAME, PATH or NAME=PATH"
            )
        kind, sources = _sources(spec, known)
        if kind == "model" and len(sources) > 1 and not named:
            raise ParameterError(
                f"controllers: {spec}: {len(sources)} models; name the algorithm: NAME={spec}"
            )
        name = name or _default_name(kind, sources[0])
        first_kind, first_spec, first_named = first.setdefault(name, (kind, spec, named))
        own = [c for c in out.values() if c.name == name]
        if own and not (named and first_named):
            raise ParameterError(f"controllers: {name!r} twice; give one another name: NAME={spec}")
        if own and (kind != first_kind or kind == "classical"):
            raise ParameterError(
                f"controllers: {name!r}: {spec} beside {first_spec}: one name is one algorithm of "
                "several training seeds, models alone or classes alone; give another name"
            )
        for member, source in enumerate(sources, start=len(own)):
            found = digest(source) if kind == "model" else ""
            if any((c.digest or c.source) == (found or source) for c in own):
                raise ParameterError(
                    f"controllers: {name!r}: {source} twice: expected each training seed once"
                )
            chosen = {} if kind == "model" else dict(settings.get(name, {}))
            contestant = Contestant(name, member, kind, source, found, chosen)
            out[contestant.key] = contestant
    settable = {c.name for c in out.values() if c.kind != "model"}
    for name in settings:
        if name not in settable:
            raise unknown_key(name, settable, "--settings")
    return out


def _sources(spec: str, classical: Collection[str]) -> tuple[str, list[str]]:
    """(`Contestant.kind`, `Contestant.source` of each member) of one entry without its NAME=.

    The first that fits: a classical controller, the shipped policy, module:Class, a pattern of
    models, the path of one. A model is a file (`MODELS`), or a run or export folder that holds one.
    A pattern leaves out run folders without a model, with a line that names them. A path with the
    suffix of a model or with a / need not exist: who reads it says that it is missing. Raises
    `ParameterError` for anything else.
    """
    if spec in classical:
        return "classical", [spec]
    if spec in SHIPPED:
        return "class", [SHIPPED_CLASS]
    if _CLASS.fullmatch(spec):
        return "class", [spec]
    if any(c in spec for c in "*?[") and not Path(spec).exists():
        found = sorted(p for p in glob.glob(spec, recursive=True) if _is_model(Path(p)))
        undone = _undone(spec)
        left_out = f"{', '.join(undone)}: training is not done" if undone else ""
        if not found:
            expected = left_out or "expected files of models, or run or export folders"
            raise ParameterError(f"controllers: {spec}: no model matches; {expected}")
        if undone:
            show(f"controllers: {spec}: left out {left_out}.")
        return "model", list(dict.fromkeys(str(_file_of(Path(p))) for p in found))
    path = Path(spec)
    if path.suffix in MODELS or path.is_dir() or ("/" in spec and not path.is_file()):
        return "model", [str(_file_of(path))]
    if path.is_file():
        expected = (
            "a run folder, a model.zip, a policy.onnx, module:Class, or the name of a controller"
        )
        raise ParameterError(f"controllers: {spec}: no trained agent: expected {expected}")
    known = (*classical, *SHIPPED)
    raise ParameterError(
        f"{unknown_value(spec, known, 'controllers')}; or model.zip, policy.onnx, module:Class"
    )


def _is_model(path: Path) -> bool:
    """True for the file of a model, by its name, and for a folder that holds one."""
    return path.suffix in MODELS or (path.is_dir() and _file_of(path).is_file())


def _undone(pattern: str) -> list[str]:
    """Run folders without a model that a glob `pattern` matches.

    The pattern is one of run folders, or of their model.zip.
    """
    folders = sorted(map(Path, glob.glob(pattern.removesuffix("/model.zip"), recursive=True)))
    return [
        str(path)
        for path in dict.fromkeys(folders)
        if (path / "config.yaml").is_file() and not _file_of(path).is_file()
    ]


def _file_of(path: Path) -> Path:
    """The file of a model: in a run folder its zip, in the folder of an export its policy."""
    if not path.is_dir():
        return path
    exported = (path / POLICY).is_file() and not (path / "model.zip").is_file()
    return path / (POLICY if exported else "model.zip")


def _default_name(kind: str, source: str) -> str:
    """Name of an entry without NAME=: of a controller or the shipped policy its own, of a model the
    stem of its file.

    A file that a training or export named (model.zip, policy.onnx) has the name of its folder.
    """
    if kind != "model":
        return SHIPPED[0] if source == SHIPPED_CLASS else source
    path = Path(source)
    of_folder = path.stem in ("model", Path(POLICY).stem)
    return (path.resolve().parent.name or path.stem) if of_folder else path.stem


def model_bytes(path: str) -> bytes:
    """Content of the file of a model; ParameterError if it cannot be read."""
    try:
        return Path(path).read_bytes()
    except OSError as error:
        # In a run folder: its training has not written the model yet.
        there = Path(path).name == "model.zip" and (Path(path).parent / "config.yaml").is_file()
        if there and isinstance(error, FileNotFoundError):
            resume = again("train", "--resume", Path(path).parent)
            raise ParameterError(
                f"controllers: {path}: missing; its training is not done: {resume}"
            ) from None
        expected = "expected a model, .zip, .npz or .onnx, or a run folder"
        raise ParameterError(
            f"controllers: {path}: cannot be read ({error.strerror}); {expected}"
        ) from None


def digest(path: str) -> str:
    """SHA-256 of the file of a model, in hexadecimal digits; ParameterError as `model_bytes`."""
    return hashlib.sha256(model_bytes(path)).hexdigest()
