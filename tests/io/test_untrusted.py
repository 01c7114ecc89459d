"""Files from elsewhere: YAML made to be a burden, zips broken, foreign or hostile: one line, and no
code is run.
"""

import base64
import copy
import functools
import json
import os
import pickle
import re
import time
import zipfile

import numpy as np
import pytest
import yaml

from soil_env._io.loading import MOST_VALUES, ParameterError, parse_yaml, read_yaml
from soil_env.logs import read_map, read_recording
from soil_env.measurement.setup import read_setup
from soil_env.measurement.table import read_table
from soil_env.parameters import load_rover, load_scenario
from soil_env.terramechanics.model import WheelSoilModel
from tests.conftest import ROOT
from tests.fuzz_cases import damaged, damaged_zip
from tests.logs.bags import MAP, example, write_map, write_mcap
from tests.refusals import refused

#: 10 ** 9 values by aliases of aliases.
BOMB = "a: &a [x, x, x, x, x, x, x, x, x, x]\n" + "".join(
    f"{b}: &{b} [{', '.join(['*' + a] * 10)}]\n"
    for a, b in zip("abcdefgh", "bcdefghi", strict=True)
)
#: {name: (content, part of the message)}.
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
    "a long number of hex digits": ("gravity: 0x" + "F" * 4000, "expected a number below"),
    "such a number in a list": ("gravity: [0x" + "F" * 4000 + "]", "expected a number below"),
    "a longer one": ("base: 0x" + "F" * 900_000, "expected a number below"),
    "no number": ("gravity: !!int abc", "invalid literal"),
    "no text of a number": ("gravity: !!int ''", "IndexError"),
    "a list as a number": ("gravity: !!float []", "not valid YAML"),
    "no truth value": ("gravity: !!bool x", "KeyError"),
    "no time": ("gravity: !!timestamp x", "not valid YAML"),
    "NUL": ("a: \0", "special characters"),
    "no text": (b"\xff\xfe\x00", "not valid YAML"),
    "large": (b"#" * 2_000_000, "larger than"),
    "octal": ("gravity: 0150", "0150: expected a decimal number"),
    "octal of a year": ("gravity: -0_10", "-0_10: expected a decimal number"),
    "sixtieths": ("gravity: 1:30", "1:30: expected a decimal number"),
    "sixtieths and a fraction": ("gravity: 1:30.5", "1:30.5: expected a decimal number"),
    "beyond floats": ("gravity: 1.0e+400", "expected a number below 1.8e+308"),
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
    """Each of `YAMLS` is refused in one line that names the file, and nothing is run."""
    monkeypatch.chdir(tmp_path)
    content, words = YAMLS[name]
    path = tmp_path / "x.yaml"
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(ParameterError) as raised:
        load(path)
    message = str(raised.value)
    assert "x.yaml" in message and words in message and "\n" not in message and len(message) < 1200
    assert [p.name for p in tmp_path.iterdir()] == ["x.yaml"]


def test_text_of_a_number_beyond_floats_is_no_number():
    reading = functools.partial(load_scenario, "mixed", {"gravity": "1e400"})
    refused(reading, "gravity = '1e400': expected a number")


def test_plain_aliases_merges_and_shipped_files_are_read():
    assert parse_yaml("a: &a {x: 1}\nb: {<<: *a, y: 2}\nc: [*a, *a]")["b"] == {"x": 1, "y": 2}
    for path in (ROOT / "configs").rglob("*.yaml"):
        assert path.stat().st_size < 100_000 and read_yaml(path)  # far below the limits


def test_no_unsafe_loading_in_the_sources():
    """No yaml.load but the one with our SafeLoader, no pickle."""
    unsafe = re.compile(
        r"yaml\.(load\(|unsafe|full)|pickle\.load|allow_pickle=True|(?<!retri)eval\(|exec\("
    )
    found = [
        (path.name, line.strip())
        for folder in ("soil_env", "agents", "benchmarks", "examples")
        for path in (ROOT / folder).rglob("*.py")
        for line in path.read_text("utf-8").splitlines()
        if unsafe.search(line)
    ]
    assert found == [("loading.py", "return yaml.load(text, _Strict)  # a SafeLoader")]


@pytest.fixture(scope="module")
def saved(tmp_path_factory):
    """Path of the zip of a model with hardly any training, for the default scenario."""
    pytest.importorskip("stable_baselines3")
    from tests.agents import learnt

    return learnt.saved(tmp_path_factory.mktemp("saved"), load_scenario()) / "model.zip"


def load_here(path):
    """Load the model at `path` to drive the default scenario."""
    from soil_env_agents.evaluate.models import load_model

    return load_model(path, load_scenario())


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
    """Entries of the member `data` of a model's zip, in which SB3 keeps pickles as text."""
    return json.loads(zipfile.ZipFile(path).read("data"))


def test_our_models_are_loaded_without_unpickling(saved, tmp_path, monkeypatch):
    """Every pickle in the zip is a bomb: none goes off, and the model is the same."""
    from soil_env_agents.agent import load_agent

    data = data_of(saved)
    pickled = [value for value in data.values() if ":serialized:" in repr(value)]
    assert len(pickled) > 5
    for value in pickled:
        value[":serialized:"] = base64.b64encode(pickle.dumps(Bomb())).decode()
    hostile = zipped(tmp_path / "m.zip", saved, data=json.dumps(data))
    for load in (load_agent, load_here):
        own, other = (load(path).policy.state_dict() for path in (saved, hostile))
        assert all(own[key].equal(other[key]) for key in own)


def test_a_foreign_model_is_loaded_with_a_warning(saved, tmp_path, capsys):
    zipped(tmp_path / "m.zip", saved, without=("soil_env.json",))
    for _ in range(2):
        load_here(tmp_path / "m.zip")
    error = capsys.readouterr().err
    assert error.count("\n") == 1 and "unpickled" in error and "trust" in error


def foreign(path, source, **entries):
    """Write a zip of which `data`, its only member, is that of the model `source` with other
    `entries`.
    """
    zipped(path, data=json.dumps(data_of(source) | entries))


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "not a model"),
        (b"hello", "not a model"),
        (lambda s, p: p.write_bytes(s.read_bytes()[:5000]), "not a model"),
        ({"other": "x"}, "not a model"),
        ({"data": "{"}, "not a model"),
        ({"data": "[" * 100_000}, "not a model"),
        ({"data": "[1]"}, "expected a mapping"),
        ({"data": b" " * 60_000_000}, "too large"),
        (
            lambda s, p: foreign(p, s, policy_class={":serialized:": "", "__module__": "os"}),
            "policy of 'os'",
        ),
        (lambda s, p: zipped(p, s, **{"policy.pth": b"no"}), "cannot be loaded"),
        (lambda s, p: zipped(p, s, **{"policy.pth": pickle.dumps(Bomb())}), "cannot be loaded"),
        (lambda s, p: p.mkdir(), "cannot be read"),
    ],
)
def test_a_zip_that_is_none(saved, tmp_path, content, words):
    """`content`: bytes, members of a zip, or a function (path of a good model, path to write)."""
    path = tmp_path / "m.zip"
    if isinstance(content, bytes):
        path.write_bytes(content)
    elif isinstance(content, dict):
        zipped(path, **content)
    else:
        content(saved, path)
    began = time.process_time()
    refused(lambda: load_here(path), words, "m.zip")
    assert time.process_time() - began < 30.0


def test_weights_that_unpack_to_much_are_refused(saved, tmp_path, monkeypatch):
    """Weights of a default policy, 80 MB of zeros in 80 kB, and those of a model, 10 MB."""
    from soil_env_agents.default_policy import DefaultPolicy

    np.savez_compressed(tmp_path / "w.npz", made="{}", mean=np.zeros(10**7))
    refused(lambda: DefaultPolicy("mixed", tmp_path / "w.npz"), "not the weights")
    monkeypatch.setattr("soil_env_agents.agent.MOST_BYTES", 10**6)
    inner = zipped(tmp_path / "inner.zip", zeros=bytes(10**7)).read_bytes()
    zipped(tmp_path / "m.zip", saved, **{"policy.pth": inner})
    refused(lambda: load_here(tmp_path / "m.zip"), "unpacks to 10000000 bytes")


@pytest.mark.parametrize(
    ("kind", "words"),
    [("grows", "shape"), ("loops", "operators Expand"), ("elsewhere", "other files")],
)
def test_a_graph_that_no_export_makes_is_refused(tmp_path, kind, words):
    """Two vectors of 5000 that add up to 25 million numbers, an operator that no export has, and
    data in another file.
    """
    onnx = pytest.importorskip("onnx")
    pytest.importorskip("onnxruntime")
    from soil_env_agents.exported import ExportedAgent

    column = onnx.numpy_helper.from_array(np.zeros((5000, 1), np.float32), "a")
    row = onnx.numpy_helper.from_array(np.zeros((1, 5000), np.float32), "b")
    if kind == "elsewhere":
        onnx.external_data_helper.set_external_data(column, "/etc/hostname")
        column.ClearField("raw_data")
    node = onnx.helper.make_node("Expand" if kind == "loops" else "Add", ["a", "b"], ["c"])
    last = onnx.helper.make_node("Identity", ["c"], ["action"])
    out = onnx.helper.make_tensor_value_info("action", onnx.TensorProto.FLOAT, None)
    graph = onnx.helper.make_graph([node, last], "policy", [], [out], [column, row])
    onnx.save(onnx.helper.make_model(graph), tmp_path / "p.onnx")
    refused(lambda: ExportedAgent(tmp_path / "p.onnx"), "p.onnx: cannot be loaded ", words)


FUZZ = int(os.environ.get("SOIL_ENV_FUZZ", "200"))  # cases a kind
# The torque of `MAP` comes of a motor current, which no message of `json_mcap` has.
WITHOUT_TORQUE = {name: of for name, of in MAP["channels"].items() if name != "torque"}
BAG_MAP = MAP | {"channels": WITHOUT_TORQUE}
CDR_MAP = {
    "wheel": "planetary_rover",
    "channels": {
        "wheel_speed": {"topic": "/wheel", "field": "data"},
        "speed": {"topic": "/speed", "field": "point.x"},
    },
}
TABLE_MAP = {
    "wheel": "planetary_rover",
    "time": {"column": "t", "unit": "iso"},
    "channels": {"wheel_speed": {"column": "w"}, "speed": {"column": "v", "unit": "mm/s"}},
}
YAML_OF = {
    "setup": ROOT / "examples" / "data" / "rig.setup.yaml",
    "scenario": ROOT / "configs" / "scenarios" / "mixed.yaml",
    "rover": next((ROOT / "configs" / "rovers").glob("*.yaml")),
    "model": ROOT / "configs" / "worlds" / "bulldozing.yaml",
}
LOADERS = {
    "setup": read_setup,
    "scenario": load_scenario,
    "rover": load_rover,
    "model": WheelSoilModel.load,
    "map": read_map,
    "table": lambda path: read_table(path, read_setup(YAML_OF["setup"]).wheel),
}


def check_reading(read, content, folder, name, mutate=damaged):
    """Check that `FUZZ` damaged copies of `content` are each read by `read(path)` or refused in one
    line.

    They are written to `name` in `folder`, by `mutate(content, rng)` with a seed that follows from
    the name.
    """
    rng = np.random.default_rng([*name.encode()])
    path = folder / name
    for case in range(FUZZ):
        path.write_bytes(mutate(content, rng))
        try:
            read(path)
        except ParameterError as error:
            assert "\n" not in str(error) and len(str(error)) < 1300
        except Exception as error:  # of which the test says what the file was
            raise AssertionError(f"case {case} of {name}: {path.read_bytes()[:2000]!r}") from error


@pytest.mark.parametrize("kind", LOADERS)
def test_damaged_text(tmp_path, kind):
    """Of a kind of `LOADERS`: a shipped file, the beginning of a table, or a map."""
    if kind == "table":
        lines = (ROOT / "examples" / "data" / "rig.csv").read_bytes().splitlines(keepends=True)
        content = b"".join(lines[:12])
    elif kind == "map":
        maps = BAG_MAP | {"belief": {"friction_angle_deg": 32}, "windows": {"duration": 1}}
        content = yaml.safe_dump(maps).encode()
    else:
        content = YAML_OF[kind].read_bytes()
    check_reading(LOADERS[kind], content, tmp_path, f"a.{'csv' if kind == 'table' else 'yaml'}")


def test_damaged_study(tmp_path, monkeypatch):
    pytest.importorskip("stable_baselines3")
    from soil_env_agents.study.config import read_config

    content = (
        b"scenarios: {mixed: {trained_on: mixed}}\ncontrollers: [soft_start]\nseeds: 2\n"
        b"train: {timesteps: 1024, ppo: {num_envs: 8, layer: 8}}\narms:\n  blind: {}\n"
        b"  other: {train: {observation: blind, changes: {gravity: 3.7}}}\nresamples: 50\n"
    )
    # The shipped scenarios, which are read again and again, are whole.
    shipped = functools.cache(read_yaml)
    monkeypatch.setattr(
        "soil_env.parameters.scenario.read_yaml", lambda path: copy.deepcopy(shipped(path))
    )
    check_reading(read_config, content, tmp_path, "study.yaml")


def json_mcap(folder):
    """An MCAP file with messages in JSON; without checksums damage reaches the messages."""
    from mcap.writer import CompressionType

    def messages():
        """Twelve messages of each of two topics, a second apart, one topic without headers."""
        for k in range(12):
            header = {"stamp": {"sec": k, "nanosec": 10**8}}
            yield "/drive", k * 10**9, {"header": header, "speed": 2.0 + 0.1 * k}
            yield "/odom", k * 10**9, {"twist": {"x": 0.25}, "depth": 22.0}

    options = {"compression": CompressionType.NONE, "enable_crcs": False, "chunk_size": 400}
    return write_mcap(folder / "whole.mcap", messages(), **options)


def ros_bag(folder, storage):
    """Path of the file with the messages of a ROS 2 bag, in the `storage` MCAP or SQLITE3."""
    code = example()
    recorder = code["Recorder"](folder / "bag", code["StoragePlugin"][storage])
    for k in range(1, 12):
        recorder.write("/wheel", 0.1 * k, "std_msgs/msg/Float64", 2.0)
        point = code["T"]["geometry_msgs/msg/Point"](0.25, 0.0, 0.0)
        recorder.write("/speed", 0.1 * k, "geometry_msgs/msg/PointStamped", point)
    recorder.writer.close()
    return next(p for p in (folder / "bag").iterdir() if p.suffix != ".yaml")


COLUMNS = {
    "t": [f"2026-05-04T09:30:{k:02d}" for k in range(12)],
    "w": [2.0 + 0.1 * k for k in range(12)],
    "v": [250 + k for k in range(12)],
}


def rover_table(folder):
    """Columns of TABLE_MAP as CSV."""
    lines = [",".join(map(str, row)) for row in zip(*COLUMNS.values(), strict=True)]
    (folder / "whole.csv").write_text("\n".join([",".join(COLUMNS), *lines]) + "\n")
    return folder / "whole.csv"


def rover_parquet(folder):
    """Columns of TABLE_MAP as Parquet."""
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    plain = {"compression": "none", "use_dictionary": False, "write_statistics": False}
    parquet.write_table(pyarrow.table(COLUMNS), folder / "whole.parquet", **plain)
    return folder / "whole.parquet"


#: Name of the file -> (function of a folder that makes the recording, map). A bag of ROS 1 is
#: refused by its name, whatever it holds.
RECORDINGS = {
    "json.mcap": (json_mcap, BAG_MAP),
    "cdr.mcap": (lambda folder: ros_bag(folder, "MCAP"), CDR_MAP),
    "cdr.db3": (lambda folder: ros_bag(folder, "SQLITE3"), CDR_MAP),
    "ros1.bag": (lambda folder: ros_bag(folder, "MCAP"), CDR_MAP),
    "rows.csv": (rover_table, TABLE_MAP),
    "rows.parquet": (rover_parquet, TABLE_MAP),
}


@pytest.mark.parametrize("name", RECORDINGS)
def test_damaged_recordings(tmp_path, name):
    pytest.importorskip("mcap")
    pytest.importorskip("rosbags")
    make, content = RECORDINGS[name]
    log_map = read_map(write_map(tmp_path, base=content))
    whole = make(tmp_path)
    if name != "ros1.bag":
        assert len(read_recording(whole, log_map)) > 9
    check_reading(lambda p: read_recording(p, log_map), whole.read_bytes(), tmp_path, name)


def test_damaged_models(saved, tmp_path, monkeypatch):
    """A model and a checkpoint, weights of a default policy, and an exported policy."""
    from soil_env_agents import ppo
    from soil_env_agents.agent import load_agent
    from soil_env_agents.default_policy import WEIGHTS, DefaultPolicy
    from tests.agents.learnt import TINY

    task = load_scenario()
    model = ppo.build(task, "identified", TINY, 0)
    monkeypatch.setattr(ppo, "build", lambda *arguments: model)
    unread = ("data", "pytorch_variables.pth", "_stable_baselines3_version", "system_info.txt")
    small = zipped(tmp_path / "small.zip", saved, unread)
    for name, content, read in (
        ("model.zip", small, load_here),
        ("checkpoint.zip", small, lambda p: ppo.resume(p, task, "identified", TINY, 0, None)),
        ("weights.npz", WEIGHTS, lambda p: DefaultPolicy(task, p)),
    ):
        check_reading(read, content.read_bytes(), tmp_path, name, damaged_zip)
    pytest.importorskip("onnxruntime")
    pytest.importorskip("onnx")
    from soil_env_agents.export import policy

    agent = load_agent(saved)
    exported = policy.onnx_model(agent, policy.describe(agent, "a", task, None))
    check_reading(load_here, exported.SerializeToString(), tmp_path, "policy.onnx")


def test_damaged_cells_and_checksums(tmp_path):
    """Results of a study, and the checksums of compiled code."""
    from soil_env._compiled.cache import CHECKSUMS, Kept
    from soil_env_agents.cells import cell_file, read_cell

    def cells(path):
        """Read the cell that lies at `path`, as a study reads it."""
        read_cell(tmp_path, "1", lambda found: {n: float(x) for n, x in found.items()})

    def checksums(path):
        """Check the checksums in the folder, where none of the files is that they name."""
        assert not code._check()

    (tmp_path / "cells").mkdir()
    content = json.dumps({f"metric{k}": 0.1 * k for k in range(9)}).encode()
    path = cell_file(tmp_path, "1")
    check_reading(cells, content, tmp_path, str(path.relative_to(tmp_path)))
    path.write_text("[" * 100_000)
    refused(lambda: cells(path), "is damaged")
    code = Kept.__new__(Kept)
    code._folder = tmp_path
    code._drop = lambda: None  # the folder is that of the damaged files
    content = json.dumps({f"f{k}.nbi": f"{k:064x}" for k in range(4)}).encode()
    check_reading(checksums, content, tmp_path, CHECKSUMS)
