"""Files from elsewhere: YAML made to be a burden, zips broken, foreign or hostile: one line, and no
code is run.
"""

import base64
import json
import pickle
import re
import time
import zipfile
from pathlib import Path

import pytest

from soil_env._io.loading import MOST_VALUES, ParameterError, parse_yaml, read_yaml
from soil_env.measurement.setup import read_setup
from soil_env.parameters import load_scenario
from soil_env.terramechanics.model import WheelSoilModel

ROOT = Path(__file__).resolve().parents[2]
BOMB = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join(['*' + a] * 10)}]\n"
    for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
YAMLS = {
    "aliases": (BOMB, "more than"),
    "many values": ("wheel: [" + ",".join("1" for _ in range(MOST_VALUES)) + "]", "more than"),
    "deep": ("wheel: " + "[" * 10_000 + "]" * 10_000, "nested deeper"),
    "deep mappings": ("wheel: " + "{a: " * 300 + "1" + "}" * 300, "nested deeper"),
    "itself": ("wheel: &w {preset: *w}", "contains itself"),
    "merged with itself": ("wheel: &w {<<: *w}", "contains itself"),
    "a call": (
        "wheel: !!python/object/apply:os.system ['touch pwned']",
        "could not determine a constructor",
    ),
    "a name": ("!!python/name:os.system", "could not determine a constructor"),
    "no date": ("wheel: 2001-99-99", "month must be in"),
    "a long number": ("gravity: " + "9" * 5000, "not valid YAML"),
    "no number": ("gravity: !!int abc", "invalid literal"),
    "NUL": ("a: \0", "special characters"),
    "no text": (b"\xff\xfe\x00", "not valid YAML"),
    "large": (b"#" * 2_000_000, "larger than"),
    "a list": ("[1, 2]", "expected a mapping"),
    "twice": (
        "a: 1\nb:\n  c: 1\n  d: 2\n  c: 3\n",
        "key 'c' appears twice in line 5, column 3: c: 3",
    ),
    "no key": ("? [a]\n: 1", "not valid YAML"),
    "long text": ("wheel: " + "x" * 900_000, "wheel"),
}


SLOW = ("many values", "large", "long text")  # seconds to read


@pytest.mark.parametrize(
    ("name", "load"),
    [
        (name, load)
        for name in YAMLS
        for load in (load_scenario, WheelSoilModel.load, read_setup)
        if load is load_scenario or name not in SLOW
    ],
)
def test_yaml(tmp_path, monkeypatch, name, load):
    monkeypatch.chdir(tmp_path)
    content, words = YAMLS[name]
    path = tmp_path / "x.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ParameterError) as raised:
        load(path)
    message = str(raised.value)
    assert "x.yaml" in message and words in message and "\n" not in message and len(message) < 1200
    assert [p.name for p in tmp_path.iterdir()] == ["x.yaml"]


def test_plain_aliases_merges_and_shipped_files_are_read():
    assert parse_yaml("a: &a {x: 1}\nb: {<<: *a, y: 2}\nc: [*a, *a]")["b"] == {"x": 1, "y": 2}
    for path in (ROOT / "configs").rglob("*.yaml"):
        assert path.stat().st_size < 100_000 and read_yaml(path)  # far below the limits


def test_no_unsafe_loading_in_the_sources():
    """No yaml.load but the one with our SafeLoader, no pickle."""
    unsafe = re.compile(
        r"yaml\.(load\(|unsafe|full)|pickle\.load|allow_pickle=True|(?<!retri)eval\(|exec\("
    )
    files = [
        p
        for folder in ("soil_env", "agents", "benchmarks", "examples")
        for p in (ROOT / folder).rglob("*.py")
    ]
    lines = [
        (path.name, line.strip()) for path in files for line in path.read_text("utf-8").splitlines()
    ]
    assert sorted((name, line) for name, line in lines if unsafe.search(line)) == [
        ("loading.py", "return yaml.load(text, _Strict)  # a SafeLoader"),
    ]


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    pytest.importorskip("stable_baselines3")
    from agents import ppo
    from agents.config import PPOConfig

    path = tmp_path_factory.mktemp("saved") / "model.zip"
    config = PPOConfig(num_envs=8, n_steps=8, batch_size=64, layer=8, history=0)
    model = ppo.build(load_scenario(), "identified", config, 0)
    model.learn(64)
    ppo.save(model, path)
    return path


def zipped(path, source=None, without=(), **members):
    """A zip at `path` of the members of the zip `source`, if any, less some, and of others in their
    place.
    """
    kept = {}
    if source:
        with zipfile.ZipFile(source) as old:
            kept = {name: old.read(name) for name in old.namelist() if name not in without}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as new:
        for name, content in (kept | members).items():
            new.writestr(name, content)
    return path


class Bomb:
    """An object whose unpickling ends the process."""

    def __reduce__(self):
        return exec, ("raise SystemExit('unpickled')",)


def data_of(path):
    return json.loads(zipfile.ZipFile(path).read("data"))


def test_our_models_are_loaded_without_unpickling(saved, tmp_path, monkeypatch):
    """Every pickle in the zip is a bomb: none goes off, and the model is the same."""
    from agents.agent import load_agent
    from agents.evaluate.models import load_model

    data = data_of(saved)
    pickled = [
        key for key, value in data.items() if isinstance(value, dict) and ":serialized:" in value
    ]
    assert len(pickled) > 5
    for key in pickled:
        data[key][":serialized:"] = base64.b64encode(pickle.dumps(Bomb())).decode()
    hostile = zipped(tmp_path / "m.zip", saved, data=json.dumps(data))
    for load in (load_agent, lambda p: load_model(p, load_scenario())):
        a = load(saved)
        b = load(hostile)
        weights = [agent.policy.state_dict() for agent in (a, b)]
        assert all((weights[0][key] == weights[1][key]).all() for key in weights[0])


def test_a_foreign_model_is_loaded_with_a_warning(saved, tmp_path, capsys):
    from agents.evaluate.models import load_model

    zipped(tmp_path / "m.zip", saved, without=("soil_env.json",))
    for _ in range(2):
        load_model(tmp_path / "m.zip", load_scenario())
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "unpickled" in error and "trust" in error


def foreign(path, source, **entries):
    """A zip that train.py did not write, with other entries in its data."""
    zipped(path, data=json.dumps(data_of(source) | entries))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda s, p: p.write_bytes(b""), "not a model"),
        (lambda s, p: p.write_bytes(b"hello"), "not a model"),
        (lambda s, p: p.write_bytes(s.read_bytes()[:5000]), "not a model"),
        (lambda s, p: zipped(p, other="x"), "not a model"),
        (lambda s, p: zipped(p, data="{"), "not a model"),
        (lambda s, p: zipped(p, data="[" * 100_000), "not a model"),
        (lambda s, p: zipped(p, data="[1]"), "expected a mapping"),
        (lambda s, p: zipped(p, data=b" " * 60_000_000), "too large"),
        (
            lambda s, p: foreign(p, s, policy_class={":serialized:": "", "__module__": "os"}),
            "policy of 'os'",
        ),
        (lambda s, p: zipped(p, s, **{"policy.pth": b"no"}), "cannot be loaded"),
        (lambda s, p: zipped(p, s, **{"policy.pth": pickle.dumps(Bomb())}), "cannot be loaded"),
        (lambda s, p: p.mkdir(), "cannot be read"),
    ],
)
def test_a_zip_that_is_none(saved, tmp_path, make, words):
    from agents.evaluate.models import load_model

    path = tmp_path / "m.zip"
    make(saved, path)
    began = time.process_time()
    with pytest.raises(ParameterError) as raised:
        load_model(path, load_scenario())
    message = str(raised.value)
    assert words in message and "m.zip" in message and "\n" not in message, message
    assert time.process_time() - began < 30.0
