"""Recordings of every format to the same readings; what is missing, misnamed, cut off or
damaged.
"""

import json
import math
import re
import sqlite3
import tracemalloc
from contextlib import closing

import numpy as np
import pytest

from soil_env import ParameterError
from soil_env.logs import bags, read_map, read_recording, replay
from tests.logs.bags import MAP, example, write_json_mcap, write_map, write_mcap
from tests.refusals import refused

NS = 1_000_000_000
APART = 0.05  # [sd] largest difference of two estimates of which one took a step more
pytest.importorskip("mcap")
pytest.importorskip("rosbags")


def read(path, changes=None, *progress):
    """The readings of a recording by the map of `write_map` with these changes, written beside
    it.
    """
    return read_recording(path, read_map(write_map(path.parent, changes)), *progress)


@pytest.fixture(scope="module")
def drives(tmp_path_factory):
    """A drive of the environment in both storages of ROS 2, with its map: (folder, map, estimates
    while driving, changes of `write_map` for some of its topics).
    """
    folder = tmp_path_factory.mktemp("drives")
    code = example()
    for name in ("MCAP", "SQLITE3"):
        recorder = code["Recorder"](folder / name, code["StoragePlugin"][name])
        scenario, online = code["drive"](recorder, seed=1, steps=250)
        recorder.writer.close()
    (folder / "map.yaml").write_text(code["map_of"](scenario))
    others = {"torque": None, "sinkage": {"topic": "/range", "field": "range"}}
    return folder, read_map(folder / "map.yaml"), online, code["CHANNELS"] | others


@pytest.mark.parametrize("storage", ["MCAP", "SQLITE3"])
def test_the_identifier_on_the_bag_gives_what_it_gave_online(drives, storage):
    """But for rounding: the bag has float32. So of two fits one may take its last step, and the
    other not, where that step is about as short as `SETTLED` of the identifier's fit.
    """
    folder, log_map, online, _ = drives
    found = replay(read_recording(folder / storage, log_map), log_map)
    for name, sd in (
        ("friction_angle_deg", "friction_angle_sd_deg"),
        ("shear_modulus", "shear_modulus_relative_sd"),
        ("sinkage_coefficient", "sinkage_coefficient_relative_sd"),
    ):
        after = found.values[name]
        before, spread = (np.array([e[key] for e in online]) for key in (name, sd))
        near = np.abs(after / before - 1.0)
        apart = near / spread * (1.0 if "relative" in sd else before)
        assert np.max(apart) < APART and np.mean(near < 2e-4) > 0.9
        near = np.abs(found.values[sd] / spread - 1.0)
        assert np.max(near) < 1e-2 and np.mean(near < 1e-3) > 0.9
    assert list(found.status) == [type(found.prior.status)[e["status"]] for e in online]
    learnt = found.learnt(current=True)
    assert learnt["friction_angle_deg"] < 0.6 and learnt["shear_modulus"] < 0.3
    assert found.values["shear_modulus"].max() > 1.1 * found.values["shear_modulus"].min()


def test_a_bag_of_several_files_with_and_without_metadata(tmp_path):
    """Split by the recorder, whose metadata names the files in order. It may be missing, as after a
    power cut, or have more values than a file may. A file compressed as a whole is refused.
    """
    folder = tmp_path / "bag"
    folder.mkdir()
    write_json_mcap(folder / "z_0.mcap", steps=20)
    write_json_mcap(folder / "a_1.mcap", steps=30, start=3 * NS)
    named = {
        "rosbag2_bagfile_information": {"relative_file_paths": ["z_0.mcap", "a_1.mcap", "a_2.mcap"]}
    }
    (folder / "metadata.yaml").write_text(json.dumps(named))
    done = []
    log = read(folder, None, lambda at, size: done.append((at, size)))
    assert len(log) == 50 and log.start == NS and any("a_2.mcap" in note for note in log.notes)
    assert done[-1][0] == done[-1][1] and [at for at, _ in done] == sorted(at for at, _ in done)
    (folder / "metadata.yaml").unlink()
    bare = read(folder)  # in the order of the names, which is not that of time
    assert bare.start == log.start and np.array_equal(bare.readings["speed"], log.readings["speed"])
    gone = [f"gone_{k}.mcap" for k in range(25_000)]
    many = {"rosbag2_bagfile_information": {"relative_file_paths": gone}}
    (folder / "metadata.yaml").write_text(json.dumps(many))
    assert np.array_equal(read(folder).readings["speed"], log.readings["speed"])
    (folder / "a_1.mcap.zstd").write_bytes(b"")
    (folder / "metadata.yaml").write_text(json.dumps(named).replace("a_1.mcap", "a_1.mcap.zstd"))
    assert np.array_equal(read(folder).readings["speed"], log.readings["speed"])  # unpacked
    unpacked = (folder / "a_1.mcap").rename(folder / "elsewhere")
    with pytest.raises(ParameterError, match="a_1.mcap.zstd: is compressed as a whole"):
        read(folder)
    unpacked.rename(folder / "a_1.mcap")
    # A list that cannot be read; beside what it would name a packed copy and another file.
    (folder / "a_1.mcap.md5").write_text("0")
    no_list = {"rosbag2_bagfile_information": {"relative_file_paths": 5}}
    for text in ("[", json.dumps(no_list), json.dumps(no_list).replace("5", '"z_0.mcap"')):
        (folder / "metadata.yaml").write_text(text)
        assert len(read(folder)) == 50


def test_messages_that_are_compressed_one_by_one(tmp_path):
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    code = example()
    names = (*code["CHANNELS"], "sinkage")
    reading = {name: 0.1 * k for k, name in enumerate(names, 1)}
    # Without the constructor: a writer takes its compression before it is opened.
    recorder = code["Recorder"].__new__(code["Recorder"])
    recorder.writer = Writer(tmp_path / "b", version=9, storage_plugin=StoragePlugin.SQLITE3)
    recorder.connections = {}
    recorder.writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    recorder.writer.open()
    for k in range(1, 8):
        recorder.readings(0.1 * k, reading, 0.15)
    recorder.writer.close()
    file = next((tmp_path / "b").glob("*.db3"))
    assert b"\x28\xb5\x2f\xfd" in file.read_bytes()  # a frame of Zstandard begins so
    found = read(tmp_path / "b", code["CHANNELS"] | {"sinkage": None})
    for name, values in found.readings.items():
        assert values == pytest.approx(np.full(7, reading[name])), name


def test_a_packed_message_may_lack_its_size():
    """As one that was packed in a stream; not where it is larger than a message may be."""
    zstandard = pytest.importorskip("zstandard")
    packer = zstandard.ZstdCompressor(write_content_size=False)
    assert bags._unpacked(packer.compress(b"abc" * 99)) == b"abc" * 99
    with pytest.raises(zstandard.ZstdError):
        bags._unpacked(packer.compress(bytes(bags._MOST_MESSAGE + 1)))


def test_csv_and_parquet_give_what_the_bag_gives(drives, tmp_path):
    pyarrow = pytest.importorskip("pyarrow")
    parquet = pytest.importorskip("pyarrow.parquet")
    folder, log_map, *_ = drives
    whole = read_recording(folder / "MCAP", log_map)
    names = list(whole.readings)
    rows = np.column_stack([whole.time + whole.start * 1e-9, *whole.readings.values()])
    header = "# rig 3\n" + ",".join(["t", *names])
    np.savetxt(tmp_path / "drive.csv", rows, "%.17g", ",", header=header, comments="")
    changes = {name: {"column": name} for name in names} | {"time": {"column": "t", "unit": "s"}}
    times = pyarrow.array((rows[:, 0] * 1e9).round().astype("int64"), pyarrow.timestamp("ns"))
    columns = {"t": times} | {name: rows[:, k + 1] for k, name in enumerate(names)}
    parquet.write_table(pyarrow.table(columns), tmp_path / "drive.parquet", row_group_size=64)
    for file in ("drive.csv", "drive.parquet"):
        found = read(tmp_path / file, changes)
        assert found.start == pytest.approx(whole.start, abs=1000)
        for name, values in whole.readings.items():
            assert found.readings[name] == pytest.approx(values, rel=1e-12), (file, name)


def test_units_gear_and_motor_constant(tmp_path):
    bag = write_json_mcap(tmp_path / "a.mcap", steps=30)
    own = MAP["channels"]
    changes = {
        "wheel_speed": own["wheel_speed"] | {"unit": "rpm", "gear": 4, "sign": -1},
        "motor_torque": own["torque"] | {"efficiency": 0.5},
        "sinkage": own["sinkage"] | {"sign": -1, "offset": 0.15},
        "load": {"constant": 0.15, "unit": "kN"},
        "torque": None,
    }
    found = read(bag, changes).readings
    assert found["wheel_speed"][0] == pytest.approx(-2.0 * 2.0 * math.pi / 60.0 / 4.0)
    assert found["motor_torque"][0] == pytest.approx(1.0 * 0.05 * 100 * 0.5)
    assert found["sinkage"][0] == pytest.approx(0.15 - 0.022) and np.all(found["load"] == 150.0)
    assert found["speed"][25] == pytest.approx(0.15 * 2.5 * 0.8)


@pytest.mark.parametrize(
    ("channel", "source", "named"),
    [
        (
            "torque",
            {"topic": "/joint_state", "field": "effort[0]"},
            ("'/joint_state'", "did you mean '/joint_states'"),
        ),
        (
            "speed",
            {"topic": "/odom", "field": "twist.linear.x"},
            ("/odom", "'twist.twist.linear.x'"),
        ),
        (
            "torque",
            {"topic": "/joint_states", "field": "effort[whel]"},
            ("/joint_states", "'whel'", "'wheel'"),
        ),
        (
            "torque",
            {"topic": "/joint_states", "field": "position[0]"},
            ("/joint_states", "position[0]", "0 values"),
        ),
        (
            "torque",
            {"topic": "/joint_states", "field": "name[0]"},
            ("no number but text 'wheel'", "effort[0]"),
        ),
        ("pitch", {"topic": "/imu", "field": "orientation"}, ("orientation", "unit quaternion")),
        ("sinkage", {"column": "z"}, ("sinkage", "column z", "topic")),
    ],
)
def test_errors_name_topic_and_field_and_the_nearest_known(
    drives, tmp_path, channel, source, named
):
    folder, _, _, changes = drives
    log_map = read_map(write_map(tmp_path, changes | {channel: source}))
    refused(lambda: read_recording(folder / "MCAP", log_map), *named)


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"torque": {"topic": "/drive", "field": "i", "unit": "A"}}, ("torque", "motor_constant")),
        ({"speed": {"topic": "/drive", "field": "v", "gear": 3}}, ("speed.gear",)),
        ({"speed": {"topic": "/drive", "feild": "v"}}, ("channels.speed", "'feild'", "'field'")),
        ({"speed": {"topic": "/d", "field": "v", "column": "v"}}, ("speed", "column")),
        ({"speed": None}, ("speed", "slip")),
        ({"torque": {"topic": "/d", "field": "i", "sd": 1e9}}, ("channels.torque.sd", "at most")),
        ({"pitch": {"constant": 0.1, "unit": "quaternion"}}, ("channels.pitch", "topic and field")),
        ({"pitch": {"column": "q", "unit": "quaternion"}}, ("channels.pitch", "topic and field")),
        ({"wheel": "planetary_rovr"}, ("wheel", "'planetary_rover'")),
        ({"period": 0.1, "windows": {"duration": 0.3}}, ("windows", "duration")),
        ({"belief": {"soils": {"dry_sand": 0.0}}}, ("belief.soils", "a weight > 0")),
        ({"belief": {"method": "none"}}, ("belief.method", "'filter'")),
    ],
)
def test_a_map_that_cannot_be_right_is_refused(tmp_path, changes, named):
    refused(lambda: read_map(write_map(tmp_path, changes)), "map.yaml", *named)


def test_an_unknown_topic_is_named_as_it_is_written(tmp_path):
    """The message keeps the word "key" in the name of a topic and of a folder."""
    folder = tmp_path / "keys"
    folder.mkdir()
    bag = write_json_mcap(folder / "a.mcap", steps=4)
    speed = {"topic": "/monkey/odom", "field": "twist.x"}
    said = ("keys/a.mcap", "channels.speed.topic: unknown topic '/monkey/odom'", "/drive")
    refused(lambda: read(bag, {"speed": speed}), *said)


def test_a_name_in_brackets_may_have_dots(tmp_path):
    """Joints of some robot descriptions have names with dots."""
    joints = {"name": ["left.rear", "left.front"], "velocity": [9.0, 2.0]}
    rows = [("/joints", k * NS // 10, joints | {"twist": {"x": 0.2}}) for k in range(1, 20)]
    bag = write_mcap(tmp_path / "a.mcap", rows)
    wheel = {"topic": "/joints", "field": "velocity[left.front]"}
    speed = {"topic": "/joints", "field": "twist.x"}
    found = read(bag, {"wheel_speed": wheel, "speed": speed, "sinkage": None, "torque": None})
    assert np.all(found.readings["wheel_speed"] == 2.0) and np.all(found.readings["speed"] == 0.2)


DAMAGED = [  # bytes of a message, None where it has content of another kind
    b"",
    b"{",
    b"\xff\xfe",
    b"[" * 5000,
    b"null",
    b"[1]",
    b"{}",
    b'{"speed": null, "motor": {"current": 1.0}}',
    b'{"speed": "fast", "motor": {"current": 1.0}}',
    b'{"speed": [2.0], "motor": {"current": 1.0}}',
    b'{"speed": 1' + b"0" * 400 + b', "motor": {"current": 1.0}}',
    b'{"speed": 1' + b"0" * 5000 + b', "motor": {"current": 1.0}}',
    b'{"speed": {"__class__": 5}, "motor": {"current": 1.0}}',
]
HEADERS = [  # of a message: stamps that are none, zero or missing
    {"stamp": {"sec": 10**30, "nanosec": 0}},
    {"stamp": {"sec": "now", "nanosec": 0}},
    {"stamp": {"sec": math.nan}},
    {"stamp": {"sec": 0, "nanosec": 0}},
    {"stamp": None},
    {},
    None,
]


@pytest.mark.parametrize(
    "damaged", [*DAMAGED, *HEADERS], ids=lambda x: repr(x)[:40].replace("\\", "")
)
def test_a_damaged_message_is_left_out_and_named(tmp_path, damaged):
    """One of twenty on /drive, in its content or its header; the others give what they gave.

    A recording with eleven of twenty is refused, which is not tried for missing stamps.
    """
    header = not isinstance(damaged, bytes)

    def messages(wrong):
        """Twenty messages of each topic, of which those of /drive with a number in `wrong` are
        damaged.
        """
        for k in range(20):
            at = 100 * NS + k * NS // 10
            own = {"header": {"stamp": {"sec": at // NS, "nanosec": at % NS}}} if header else {}
            drive = {"speed": 2.0 + k, "motor": {"current": 1.0}} | own
            if k in wrong:
                drive = drive | {"header": damaged} if header else damaged
            yield "/drive", at, drive
            yield "/odom", at, {"twist": {"x": 0.1 * k}, "depth": 20.0}

    found = read(write_mcap(tmp_path / "a.mcap", messages({7})))
    assert found.readings["wheel_speed"] == pytest.approx(2.0 + np.arange(20))  # interpolated
    notes = [note for note in found.notes if "/drive" in note]
    assert notes and all("1 of 20" in note and "message 8" in note for note in notes), notes
    assert found.channels["wheel_speed"].readings == 19
    if not (header and (damaged or {"stamp": None})["stamp"] is None):
        write_mcap(tmp_path / "b.mcap", messages({*range(7, 18)}))
        with pytest.raises(ParameterError, match=r"b\.mcap: .*/drive.*11 of 20 .*message 8"):
            read(tmp_path / "b.mcap")


def sqlite_bag(folder, drives, *statements, **values):
    """Path of a copy in `folder` of the SQLite bag of the fixture `drives`, changed by SQL
    `statements`; `values`: of their placeholders.
    """
    bag = folder / "a.db3"
    bag.write_bytes(next((drives[0] / "SQLITE3").glob("*.db3")).read_bytes())
    with closing(sqlite3.connect(bag)) as base, base:
        for statement in statements:
            base.execute(statement, values)
    return bag


@pytest.mark.parametrize(
    "damaged", [b"", b"\0", b"\0\1\0\0" + b"\xff" * 40, b"\x28\xb5\x2f\xfd" * 9, 3, "text"]
)
def test_a_damaged_cdr_message_is_left_out_and_named(drives, tmp_path, damaged):
    joints = "FROM messages WHERE topic_id = (SELECT id FROM topics WHERE name = '/joint_states')"
    bag = sqlite_bag(
        tmp_path,
        drives,
        f"UPDATE messages SET data = :damaged WHERE id IN (SELECT id {joints} LIMIT 2)",
        # The third has a message that is whole, and a time that is none.
        f"UPDATE messages SET timestamp = 'x' WHERE id IN (SELECT id {joints} LIMIT 1 OFFSET 2)",
        damaged=damaged,
    )
    found = read_recording(bag, drives[1])
    (note,) = (n for n in found.notes if "/joint_states" in n)
    assert "3 of 250" in note and "message 1:" in note


def test_a_type_that_nothing_defines_is_given_in_the_map(drives, tmp_path):
    bag = sqlite_bag(
        tmp_path,
        drives,
        "UPDATE topics SET type = 'rover_msgs/msg/Wheel' WHERE name = '/range'",
        # Of the bag, but not to be read.
        "UPDATE message_definitions SET encoded_message_definition = 'float64'",
    )
    changes = drives[3]
    with pytest.raises(ParameterError, match=r"/range.*rover_msgs/msg/Wheel.*messages: \{rover_m"):
        read(bag, changes)
    text = (
        "std_msgs/Header header\nuint8 kind\nfloat32 view\nfloat32 least\nfloat32 most\n"
        "float32 range\nfloat32 variance\n"
    )
    found = read(bag, changes | {"messages": {"rover_msgs/msg/Wheel": text}})
    whole = read_recording(drives[0] / "SQLITE3", read_map(write_map(tmp_path, changes)))
    assert np.array_equal(found.readings["sinkage"], whole.readings["sinkage"])
    with pytest.raises(ParameterError, match=r"messages\.rover_msgs/msg/Wheel: not the text"):
        read(bag, changes | {"messages": {"rover_msgs/msg/Wheel": "float64"}})


ENDLESS = "WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n) "


@pytest.mark.parametrize(
    ("hostile", "words"),
    [
        ([f"CREATE VIEW messages AS {ENDLESS} SELECT * FROM n"], "messages is no plain table"),
        (
            [
                "ALTER TABLE topics RENAME TO old",
                "CREATE TABLE messages (id, topic_id, timestamp, data)",
                f"CREATE VIEW topics AS {ENDLESS} SELECT id, 'a', 'b' FROM n",
            ],
            "topics is no plain",
        ),
        (["CREATE VIRTUAL TABLE messages USING fts5(id, topic_id, timestamp, data)"], "no plain"),
        (
            [
                "CREATE TABLE messages (id INTEGER PRIMARY KEY, topic_id, timestamp, data AS "
                "(zeroblob(900000000)))"
            ],
            "no plain table",
        ),
        ([], "messages is no plain table"),
    ],
)
def test_a_bag_that_runs_something_is_refused(drives, tmp_path, hostile, words):
    bag = sqlite_bag(tmp_path, drives, "DROP TABLE messages", *hostile)
    before = bag.read_bytes()
    with pytest.raises(ParameterError, match=words):
        read_recording(bag, drives[1])
    assert bag.read_bytes() == before and [p.name for p in tmp_path.iterdir()] == ["a.db3"]


def test_a_name_in_the_schema_that_is_no_utf_8_is_refused(drives, tmp_path):
    """SQLite quotes it in the text of its error."""
    bag = sqlite_bag(tmp_path, drives)
    content = bag.read_bytes()
    bag.write_bytes(content.replace(b"timestamp_idx ON messages", b"timestamp_idx ON m\xa6ssages"))
    with pytest.raises(ParameterError, match="a.db3: cannot be read as a ROS 2 bag in SQLite"):
        read_recording(bag, drives[1])


def test_more_work_than_a_plain_bag_takes_is_ended(drives, tmp_path, monkeypatch):
    monkeypatch.setattr("soil_env.logs.bags._MOST_WORK", (1000, 0))
    monkeypatch.setattr("soil_env.logs.bags._WORK_STEP", 100)
    with pytest.raises(ParameterError, match="cannot be read as a ROS 2 bag in SQLite"):
        read_recording(drives[0] / "SQLITE3", drives[1])


def stamped(path, delay, back=20, odom=None):
    """Write 20 messages, 0.1 s apart, of /drive and as many of /odom; return the MCAP file's path.

    /drive has stamps of its own and is recorded `delay` [s] later, at the times of /odom. /odom has
    no stamps, or stamps `odom` [s] before its recording. From message `back` on, counted from 0,
    the clock of the stamps of /drive is set back by a second. The wheel speed of message 7 is
    infinite.
    """

    def header(at):
        """Header with the stamp `at` [ns]."""
        return {"stamp": {"sec": at // NS, "nanosec": at % NS}}

    def messages():
        for k in range(20):
            at = 100 * NS + k * NS // 10
            late = at + round(delay * NS)
            own = at - NS * (k >= back)
            yield (
                "/drive",
                late,
                {
                    "header": header(own),
                    "speed": 2.0 if k != 7 else 1e999,
                    "motor": {"current": 1.0},
                },
            )
            stamp = {} if odom is None else {"header": header(late - round(odom * NS))}
            yield "/odom", late, {"twist": {"x": 0.1 * k}, "depth": 20.0} | stamp

    return write_mcap(path, messages())


def test_the_clock_is_that_of_the_header_or_of_the_recording(tmp_path):
    """Readings of the two topics belong together by the clock of the recording; by the header they
    are 3 s apart.
    """
    bag = stamped(tmp_path / "a.mcap", delay=3.0)
    by_header = read(bag)
    assert by_header.start == 100 * NS and any("/odom" in note for note in by_header.notes)
    assert np.isnan(by_header.readings["speed"]).all()
    by_log = read(bag, {"clock": "log"})
    assert by_log.start == 103 * NS and by_log.readings["speed"] == pytest.approx(
        0.1 * np.arange(20)
    )
    soon = read(stamped(tmp_path / "b.mcap", delay=0.004))
    assert soon.readings["speed"] == pytest.approx(0.1 * np.arange(20))


@pytest.mark.parametrize("odom", [3.0, -4.0, 1.7e9])
def test_header_stamps_of_two_clocks_are_noted(tmp_path, odom):
    """Both topics have stamps: those of /odom are of another clock, as of a simulation."""
    apart = read(stamped(tmp_path / "a.mcap", 0.004, odom=odom)).notes
    assert [line for line in apart if "of /odom are" in line and "clock: log" in line], apart
    assert any(re.search("speed .* 20 readings, all before", line) for line in apart)
    for delay, clock in ((3.0, "header"), (0.004, "log")):
        bag = stamped(tmp_path / "b.mcap", delay, odom=delay if clock == "header" else odom)
        assert not any("/odom" in line for line in read(bag, {"clock": clock}).notes)


def test_stamps_that_go_back_are_counted_by_topic(tmp_path):
    """A clock that is set back: the stamps of one topic from then on are left out, but for one
    within max_gap.
    """
    found = read(stamped(tmp_path / "a.mcap", 0.0, back=15))
    out, late = found.notes[:2]
    assert "topic /drive" in out and "4 of 20" in out and "message 16 (100.500 s" in out
    assert "topic /drive" in late and "1 of 20" in late and "max_gap" in late
    assert found.channels["wheel_speed"].readings == 16 and found.channels["speed"].readings == 20


def steady(times):
    """Rows of steady driving below `HEADER` with these stamps, as one text."""
    return "".join(f"{t},2,0.25,0.02,5\n" for t in times)


def test_two_drives_in_one_file_are_told_from_stamps_that_are_wrong(tmp_path):
    """Where a second drive begins the note says where to split; a single wrong stamp is counted.

    The second drive is kept, and of the first what is at most 0.5 s, the longest gap, ahead of it.
    """
    drive = np.arange(0.0, 180.0, 0.1)
    out, late = read_csv(tmp_path, steady(np.concatenate([drive, drive]))).notes[:2]
    assert "The clock goes back at row 1802 (0.000 s after 179.900 s)" in out
    assert "where two recordings are in one file, split it there" in out
    assert "late by at most 0.5 s" in late and "after 0.500 s" in late
    alone = read_csv(tmp_path, steady([*drive[:900], 7.0, *drive[900:]])).notes[0]
    assert "left out 1 of 1801 time stamps" in alone and "goes back" not in alone


def test_whole_seconds_of_a_fast_log_are_told(tmp_path):
    """Ten rows with each stamp are, one pair of equal stamps is not."""
    for times, told in ((np.floor(np.arange(0.0, 60.0, 0.1)), 1), ([0.0, 0.1, 0.1, 0.2, 0.3], 0)):
        assert read_csv(tmp_path, steady(times)).notes[0].count("Take a finer time") == told


@pytest.mark.parametrize("name", ["a.mcap.lz4", "bag/a.db3.lz4", "a.csv.lz4"])
def test_files_compressed_as_a_whole_are_refused_with_what_unpacks_them(tmp_path, name):
    (tmp_path / "bag").mkdir()
    (tmp_path / name).write_bytes(b"\x04\x22\x4d\x18")
    path = (tmp_path / name).parent if "/" in name else tmp_path / name
    with pytest.raises(ParameterError, match=r"\.lz4: is compressed as a whole: .* lz4 -d"):
        read(path)


def test_chunks_compressed_by_lz4_are_read(tmp_path):
    from mcap.writer import CompressionType

    found = [
        read(write_json_mcap(tmp_path / f"{kind.value}.mcap", packed=kind))
        for kind in (CompressionType.LZ4, CompressionType.ZSTD)
    ]
    assert len(found[0]) == 200 and found[0].notes == found[1].notes


@pytest.mark.parametrize("name", ["a.mcap", "a.db3"])
@pytest.mark.parametrize(
    "content", [b"", b"no such thing" * 100, 8, 200], ids=["empty", "another kind", "8", "200"]
)
def test_a_file_without_a_message_is_refused(tmp_path, name, content):
    """Empty, of another kind, or cut off before its first message."""
    if isinstance(content, int):
        content = write_json_mcap(tmp_path / "whole.mcap").read_bytes()[:content]
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ParameterError, match=name):
        read(tmp_path / name)


def test_the_rate_of_a_channel_is_over_its_own_duration(tmp_path):
    """The wheel speed, which makes the time axis, may come for a small part of the recording; a
    single reading, of the pitch, has no rate.
    """
    rows = [f"{0.1 * k:.1f},,0.3,,\n" for k in range(201)]
    rows[100:103] = ["10.0,2,0.3,,\n", "10.1,2,0.3,,0.1\n", "10.2,2,0.3,,\n"]
    changes = COLUMNS | {"pitch": COLUMNS["torque"], "torque": None, "sinkage": None}
    channels = read_csv(tmp_path, "".join(rows), changes).channels
    assert channels["wheel_speed"].per_second == pytest.approx(10.0)
    assert channels["speed"].per_second == pytest.approx(10.0)
    assert np.isnan(channels["pitch"].per_second)


def test_a_value_that_cannot_be_is_left_out_and_counted(tmp_path):
    found = read(stamped(tmp_path / "a.mcap", 0.0))
    channel = found.channels["wheel_speed"]
    assert (channel.empty, channel.unusable, channel.readings) == (1, 0, 20)  # infinite
    assert any("wheel_speed" in note and "1 of 20" in note for note in found.notes)
    assert found.readings["wheel_speed"] == pytest.approx(2.0)  # interpolated there
    millimetres = MAP["channels"]["sinkage"] | {"unit": "m"}
    found = read(tmp_path / "a.mcap", {"sinkage": millimetres})
    assert found.channels["sinkage"].unusable == 20 and np.isnan(found.readings["sinkage"]).all()
    assert sum("sinkage" in note for note in found.notes) == 1
    with pytest.raises(ParameterError, match="sinkage"):
        read(tmp_path / "a.mcap", {"sinkage": {"constant": 20}})


@pytest.mark.parametrize("share", [0.2, 0.4, 0.6])
def test_a_cut_mcap_gives_what_is_whole_and_says_so(tmp_path, share):
    bag = write_json_mcap(tmp_path / "a.mcap")
    whole = read(bag)
    content = bag.read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(content[: int(share * len(content))])
    part = read(cut)
    assert any("cut.mcap" in note for note in part.notes) and not whole.notes
    assert 0 < len(part) < len(whole)
    for name, values in part.readings.items():
        # Messages of the last step may lie on both sides of the cut.
        inside = values[: len(part) - 1]
        assert np.array_equal(inside, whole.readings[name][: inside.size])
    cut.write_bytes(content[:-100])  # of the index, which is not needed
    part = read(cut)
    assert len(part) == len(whole) and not part.notes


def test_a_message_at_the_time_0_is_one(tmp_path):
    bag = write_json_mcap(tmp_path / "a.mcap", steps=1, chunk=1, payload=4096, start=0)
    content = bag.read_bytes()
    bag.write_bytes(content[: content.index(bytes(range(256))) + 100])  # within the picture
    (note,) = [note for note in read(bag).notes if "cut off" in note]
    assert "after the message recorded at 0.000 s" in note


def test_progress_is_shown_whatever_the_rows_of_other_topics(drives, tmp_path):
    """Rows that are read need not have round numbers."""
    bag = sqlite_bag(tmp_path, drives, "DELETE FROM messages WHERE rowid % 64 = 0")
    seen = []
    read_recording(bag, drives[1], lambda position, size: seen.append(position / size))
    assert sum(0.0 < share < 1.0 for share in seen) > 2


def test_a_damaged_chunk_is_left_out(tmp_path):
    bag = write_json_mcap(tmp_path / "a.mcap", payload=256)
    content = bytearray(bag.read_bytes())
    place = content.index(b'"twist"', len(content) // 2)
    content[place] ^= 1
    bag.write_bytes(content)
    part = read(bag)
    assert any("damaged" in note for note in part.notes)
    assert part.time[-1] == pytest.approx(19.9) and len(part) > 190


@pytest.mark.parametrize("share", [0.3, 0.71])
def test_a_cut_sqlite_bag_is_refused(drives, tmp_path, share):
    """SQLite reads the rest of a cut page as zeros."""
    bag = sqlite_bag(tmp_path, drives)
    content = bag.read_bytes()
    bag.write_bytes(content[: int(share * len(content)) + 17])
    with pytest.raises(ParameterError, match="a.db3: is cut off at byte"):
        read_recording(bag, drives[1])


COLUMNS = {n: {"column": n} for n in ("wheel_speed", "speed", "sinkage", "torque")} | {
    "time": {"column": "t"}
}
HEADER = "t,wheel_speed,speed,sinkage,torque\n"


def read_csv(folder, content, changes=COLUMNS):
    """The readings of a CSV file, written to `folder`, with this content below `HEADER`."""
    (folder / "a.csv").write_bytes((HEADER + content).encode("latin-1"))
    return read(folder / "a.csv", changes)


def lines(times):
    """Rows below `HEADER` with these stamps, of which the travel speed rises by 0.1 m/s a row."""
    return [f"{t:g},2,{0.1 * k:.1f},0.02,5\n" for k, t in enumerate(times)]


def test_a_csv_that_ends_in_the_middle_of_a_row(tmp_path):
    rows = "".join(lines(0.1 * np.arange(10)))
    part = read_csv(tmp_path, rows + "1.0,2,0.2")
    assert len(part) == 10 and any("a.csv" in note for note in part.notes)
    for content, named in (
        ("1.0,2,0.2\n" + rows, "1 of 11 rows cannot be read. Left out, first row 2"),
        (rows + "1.0,2,0.2,0.02,5,7\n", "1 of 11 rows cannot be read. Left out, first row 12"),
        (rows + "1.0,2,fast,0.02,5\n", "1 of 11 cells .* row 12: speed = 'fast'"),
        (rows.replace("0.02", "0.\xff2", 1), "1 of 10 cells .* row 2: sinkage"),
    ):
        part = read_csv(tmp_path, content)
        assert len(part) in (10, 11) and len(part.notes) == 1
        assert re.search(named, part.notes[0]), part.notes
    # Of the short ones the last is taken for one that was cut off.
    for bad in ("2,0.2\n" * 12, "1.0,2,0.1,zero,5\n" * 11):
        with pytest.raises(ParameterError, match="11 of 21 .* cannot be read, first row 12"):
            read_csv(tmp_path, rows + bad)


def test_a_table_as_a_spreadsheet_writes_it(tmp_path):
    """Every cell in quotes, after a byte order mark."""
    rows = "".join(lines(0.1 * np.arange(10)))
    plain = read_csv(tmp_path, rows)
    quoted = "\n".join(
        ",".join(f'"{cell}"' for cell in line.split(",")) for line in (HEADER + rows).splitlines()
    )
    (tmp_path / "a.csv").write_text(quoted, encoding="utf-8-sig")
    found = read(tmp_path / "a.csv", COLUMNS)
    assert np.array_equal(found.readings["speed"], plain.readings["speed"])


def test_a_slip_that_leads_to_no_speed_of_a_wheel_is_left_out(tmp_path):
    """A warning counts the steps; a channel without any value counts as not measured."""
    log_map = read_map(write_map(tmp_path, COLUMNS))
    log = read_csv(tmp_path, "".join(lines(0.1 * np.arange(30))))
    del log.readings["speed"]
    log.readings["slip"] = np.where(np.arange(len(log)) == 9, -0.98, 0.2)
    log.readings["wheel_speed"] = np.full(len(log), 20.0)
    log.readings["torque"] = np.full(len(log), math.nan)
    found = replay(log, log_map)
    assert any("In 1 of" in text and "is none of a wheel" in text for text in found.warnings)
    assert "torque" not in found.measured and "slip" in found.measured


TIMES = {  # unit -> three stamps a tenth of a second apart
    "s": ("1770000000.0", "1770000000.1", "1.7700000002e9"),
    "ms": ("1770000000000", "1770000000100", "1770000000200"),
    "us": ("1770000000000000", "1770000000100000", "1770000000200000.0"),
    "ns": ("1770000000000000000", "1770000000100000000", "1770000000200000000"),
    "iso": ("2026-02-02T02:40:00Z", "2026-02-02T03:40:00.100+01:00", "2026-02-02 02:40:00.2"),
    "excel": ("46055.11111111111", "46055.11111226852", "46055.11111342593"),
}


@pytest.mark.parametrize("unit", TIMES)
def test_time_stamps_of_every_unit_and_empty_cells(tmp_path, unit):
    rows = [f"{t},2,{v},0.02," for t, v in zip(TIMES[unit], ("0.25", "", "0.35"), strict=True)]
    (tmp_path / "a.csv").write_text(
        "\ufefft,wheel_speed,speed,sinkage,torque\n" + "\n".join(rows) + "\n\n", "utf-8"
    )
    found = read(tmp_path / "a.csv", COLUMNS | {"time": {"column": "t", "unit": unit}})
    assert found.start == pytest.approx(1_770_000_000 * NS, abs=1000)  # days have few digits
    assert found.time == pytest.approx([0.0, 0.1, 0.2])
    assert found.readings["speed"] == pytest.approx([0.25, 0.3, 0.35])
    assert np.isnan(found.readings["torque"]).all() and found.channels["speed"].readings == 2


@pytest.mark.parametrize(
    ("content", "named"),
    [
        ("\n \n", "expected a header"),
        ("t,wheel_sp", "cut off in its header"),
        ("Drive 3\n\n" + HEADER, "the header stands below the line 'Drive 3'"),
        (HEADER + "0,2,0.2", "cut off"),
        (HEADER + lines([0.0])[0] + "1e12,2,0.2,0.02,5\n" * 2, "row 3: t = '1e12'"),
        (HEADER + "1e999999999,2,0.2,0.02,5\n", "row 2: t = '1e999999999', expected a time in s"),
        (HEADER + "nan,2,0.2,0.02,5\n", "row 2: t = 'nan', expected a time in s"),
        (HEADER + "1_0,2,0.2,0.02,5\n", "row 2: t = '1_0', expected a time in s"),
        (HEADER + "10,2_0,0.2,0.02,5\n", "row 2: wheel_speed = '2_0', expected a number"),
        (HEADER + "2026-05-04 09:30:00+00:00,2,0.2,0.02,5\n", "give time: unit: iso"),
        (HEADER + "09:30:00,2,0.2,0.02,5\n", "text as .* give time: unit: iso"),
        (HEADER + "5/4/2026 9:30,2,0.2,0.02,5\n", "expected a time in s"),
        (HEADER.replace("torque", "speed") + lines([0.0])[0], "'speed' is that of columns 3, 5"),
        (HEADER + lines([3.0])[0] * 10, "all 10 time stamps are 3.000 s"),
    ],
)
def test_a_table_with_nothing_whole_in_it(tmp_path, content, named):
    (tmp_path / "a.csv").write_text(content)
    with pytest.raises(ParameterError, match="a.csv.*" + named):
        read(tmp_path / "a.csv", COLUMNS)


def test_time_that_goes_back_in_a_table(tmp_path):
    """A row that is late by less than max_gap is put where it belongs; others are left out, and
    counted.
    """
    times = [0.0, 0.1, 0.2, 0.4, 0.3, *(0.1 * k for k in range(5, 10)), 0.1, 0.2, 1.0]
    found = read_csv(tmp_path, "".join(lines(times)))
    assert found.readings["speed"] == pytest.approx(
        [0.0, 0.1, 0.2, 0.4, 0.3, 0.5, 0.6, 0.7, 0.8, 0.9, 1.2]
    )
    out, late = found.notes
    assert "2 of 13" in out and "row 12 (0.100 s after 0.900 s)" in out
    assert "1 of 13" in late and "row 6 (0.300 s after 0.400 s)" in late


@pytest.mark.parametrize("order", [(0, 1, 2, 3), (0, 2, 1, 3)])
def test_times_of_day_after_midnight(tmp_path, order):
    """Also with a row that is late by less than max_gap."""
    stamps = ("23:59:59.800", "23:59:59.9", "0:00:00.000", "00:00:00.100000")
    stamps = [stamps[k] for k in order]
    found = read_csv(tmp_path, steady(stamps), COLUMNS | {"time": {"column": "t", "unit": "iso"}})
    assert found.time == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert len(found.notes) == (order[1] == 2)


@pytest.mark.parametrize(
    ("place", "wrong"),
    [
        (0, [0.0]),
        (0, [0.0] * 5),
        (0, [4e9]),
        (30, [4e9]),
        (30, [0.0]),
        (30, [4e9, 4e9, -4e9]),
        (60, [4e9]),
        (60, [1.77e9 + 900.0]),
    ],
)
def test_stamps_of_another_time_are_left_out_and_no_others(tmp_path, place, wrong):
    """Zeros before a clock is set, and stamps of the future: at the begin, in between, at the
    end.
    """
    times = [1.77e9 + 0.1 * k for k in range(60)]
    times[place:place] = wrong
    found = read_csv(tmp_path, steady(times))
    assert found.start == 1_770_000_000 * NS and found.time == pytest.approx(0.1 * np.arange(60))
    assert found.channels["speed"].readings == 60
    (note,) = found.notes
    assert f"{len(wrong)} of {len(times)}" in note and f"row {place + 2} " in note


def test_equal_stamps_are_averaged_and_noted(tmp_path):
    found = read_csv(tmp_path, "".join(lines([0.0, 0.1, 0.1, 0.2])))
    assert found.readings["speed"] == pytest.approx([0.0, 0.15, 0.3])
    note, *apart = found.notes
    assert "in 1 of 4 time stamps" in note and "row 4" in note
    (speed,) = [line for line in apart if "readings of speed differ" in line]
    assert "differ at 1 time stamps that are there more than once, by up to 0.1 m/s" in speed


def test_rows_of_one_time_and_other_columns_are_one_row(tmp_path):
    """A table with a row for each sensor, as it is made of a bag."""
    cells = ("2,,,", ",0.2,,", ",,0.02,", ",,,5")
    rows = "".join(f"{t},{row}\n" for t in 0.1 * np.arange(20) for row in cells)
    found = read_csv(tmp_path, rows)
    assert len(found) == 20 and not found.notes
    assert found.readings["speed"] == pytest.approx(0.2)


def test_steps_longer_than_max_gap_are_no_gaps(tmp_path):
    changes = {"period": 1.0, "windows": {"duration": 4.0}}
    assert not read_csv(tmp_path, "".join(lines(0.1 * np.arange(100))), COLUMNS | changes).notes


def test_too_many_steps_of_the_time_axis_are_refused(tmp_path, monkeypatch):
    monkeypatch.setattr("soil_env.logs.align.MOST_STEPS", 50)
    with pytest.raises(ParameterError, match="period: .* 77 steps"):
        read_csv(tmp_path, "".join(lines(0.4 * np.arange(20))))
    monkeypatch.setattr("soil_env.logs.recordings.MOST_READINGS", 50)
    with pytest.raises(ParameterError, match=r"a\.csv: has more than 50 readings"):
        read(tmp_path / "a.csv", COLUMNS)


def test_memory_does_not_grow_with_the_bag(tmp_path):
    """40 MB with images of 200 kB: no more than a few chunks of 1 MB at a time."""
    peaks = []
    seen = []
    for steps in (20, 200):
        bag = write_json_mcap(
            tmp_path / f"{steps}.mcap", steps=steps, chunk=1_000_000, payload=200_192
        )
        tracemalloc.start()
        found = read(bag, None, lambda done, size: seen.append((done, size)))
        peaks.append(tracemalloc.get_traced_memory()[1])
        tracemalloc.stop()
        assert len(found) == steps
    assert bag.stat().st_size > 39e6 and peaks[1] < 8e6 and peaks[1] < peaks[0] + 2e6
    done, size = zip(*seen, strict=True)
    assert done[-1] == size[-1] == bag.stat().st_size and len(set(done)) > 20
