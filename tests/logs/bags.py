"""Recordings for the tests: the example's bag, and MCAP files written by the library `mcap`
itself.
"""

import json
import runpy
from pathlib import Path

import yaml

from soil_env.logs.mapping import UNITS

EXAMPLE = Path(__file__).resolve().parents[2] / "examples" / "record_bag.py"
MAP = {
    "wheel": "planetary_rover",
    "channels": {
        "wheel_speed": {"topic": "/drive", "field": "speed"},
        "speed": {"topic": "/odom", "field": "twist.x"},
        "sinkage": {"topic": "/odom", "field": "depth", "unit": "mm"},
        "torque": {
            "topic": "/drive",
            "field": "motor.current",
            "unit": "A",
            "motor_constant": 0.05,
            "gear": 100,
        },
    },
}


def example():
    """{name: object} of what the script examples/record_bag.py defines, run as a module."""
    return runpy.run_path(str(EXAMPLE))


def write_map(folder, changes=None, name="map.yaml", base=MAP):
    """Path of a map written to `folder`: `base` with whole channels or top-level keys replaced by
    those of `changes`; None takes one out.
    """
    content = json.loads(json.dumps(base))
    for key, value in (changes or {}).items():
        place = content["channels"] if key in UNITS else content
        place[key] = value
        if value is None:
            del place[key]
    path = folder / name
    path.write_text(yaml.safe_dump(content))
    return path


def write_mcap(path, messages, **options):
    """Path of an MCAP file of messages (topic, time [ns], bytes or what JSON can hold); `options`
    are those of `mcap.writer.Writer`.
    """
    from mcap.writer import Writer

    with open(path, "wb") as stream:
        writer = Writer(stream, **options)
        channels = {}
        writer.start()
        for topic, time, content in messages:
            if topic not in channels:
                schema = writer.register_schema("any", "jsonschema", b"{}")
                channels[topic] = writer.register_channel(topic, "json", schema)
            data = content if isinstance(content, bytes) else json.dumps(content).encode()
            writer.add_message(channels[topic], time, data, time)
        writer.finish()
    return path


def write_json_mcap(path, steps=200, chunk=2000, payload=0, start=1_000_000_000, packed=None):
    """Path of an MCAP file of a drive in steps of 0.1 s on /drive and /odom; with `payload` also
    that many bytes a step on /camera, in whole 256.

    Wheel speed, slip and current change every 20 steps. `chunk`: size of a chunk [bytes]; `start`:
    time of the first message [ns]; `packed`: compression, by default ZSTD, none with a payload.
    """
    from mcap.writer import CompressionType

    def messages():
        """(topic, time [ns], content) of each message in order."""
        for k in range(steps):
            time = start + k * 100_000_000
            stage = k // 20 % 3
            speed = 2.0 + 0.5 * stage
            yield "/drive", time, {"speed": speed, "motor": {"current": 1.0 + 0.1 * stage}}
            yield (
                "/odom",
                time,
                {"twist": {"x": 0.15 * speed * (0.85, 0.8, 0.7)[stage]}, "depth": 22.0},
            )
            if payload:
                yield "/camera", time, image

    image = bytes(range(256)) * (payload // 256)
    compression = packed or (CompressionType.NONE if payload else CompressionType.ZSTD)
    return write_mcap(path, messages(), chunk_size=chunk, compression=compression)
