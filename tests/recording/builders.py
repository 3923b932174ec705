"""Small recordings for the tests: one scene, written natively or again with another compression."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from mcap.writer import CompressionType, Writer

from svmdist import samples
from svmdist.camera import Camera
from svmdist.profile import Limits
from svmdist.recording.mcap import McapSource
from svmdist.transforms import Array, make_transform, rotation_x, rotation_z
from tests.synthetic import write_samples

CAMERA = Camera.from_horizontal_fov(32, 24, 1.0)
PERIOD_NS = 40_000_000
COMPRESSIONS = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}


class Entry(NamedTuple):
    """A sample and the topic it belongs on."""

    topic: str
    sample: samples.Sample


def pose(number: int) -> Array:
    """A pose that turns and moves with its number."""
    return make_transform(rotation_z(0.1 * number) @ rotation_x(0.05 * number), [0.01 * number, 0.02, 0.1])


def scene(frame_count: int = 5, *, stamp_offset_ns: int = 1_000_000_000) -> list[Entry]:
    """Everything a recording can carry: images at 25 Hz, joints at 100 Hz, in the order of their stamps."""
    rng = np.random.default_rng(7)
    entries = []
    for frame in range(frame_count):
        stamp_ns = stamp_offset_ns + frame * PERIOD_NS
        image = rng.integers(0, 256, (CAMERA.height_px, CAMERA.width_px, 3), np.uint8)
        tf = samples.TransformSample(stamp_ns, "camera", "tool", pose(frame))
        entries += [
            Entry("/ECM/left/camera_info", samples.CameraSample(stamp_ns, CAMERA)),
            Entry("/ECM/left/image", samples.ImageSample(stamp_ns, "camera", image)),
            Entry("/PSM1/measured_cp", samples.PoseSample(stamp_ns, "base", pose(frame))),
            Entry("/tf", samples.TransformsSample(stamp_ns, (tf,))),
            Entry("/ground_truth/tf", samples.TransformsSample(stamp_ns, (tf,))),
            Entry("/ground_truth/distance", samples.DistanceSample(stamp_ns, 0.1, 0.2, -0.001 * frame)),
        ]
        for step in range(4):
            joint_ns = stamp_ns + step * PERIOD_NS // 4
            positions = np.array([0.5 * frame + 0.125 * step, -1.0])
            entries.append(Entry("/PSM1/measured_js", samples.JointSample(joint_ns, ("yaw", "pitch"), positions)))
    return entries


def write_scene(path: Path, entries: list[Entry], metadata: dict[str, str] | None = None) -> Path:
    """Write entries with the recording's own writer."""
    return write_samples(path, entries, metadata or {"scenario": "test", "seed": "7"})


def rewrite(source: Path, target: Path, compression: str, *, chunk_size: int = 4096, data_crc: bool = True) -> Path:
    """Copy a recording into smaller chunks of another compression."""
    whole = McapSource(source, Limits())
    rows = [(m.topic, m.schema, m.message_encoding, bytes(m.data), m.log_time_ns) for m in whole.messages()]
    options = {"chunk_size": chunk_size, "enable_data_crcs": data_crc}
    return write_messages(target, rows, compression, whole.metadata(), **options)


def write_messages(
    path: Path,
    messages: list[tuple[str, str, str, bytes, int]],
    compression: str = "zstd",
    metadata: Mapping[str, str] = {},
    **options: Any,
) -> Path:
    """Write raw messages, each as topic, schema name, message encoding, data and log time in ns."""
    with path.open("wb") as output:
        writer = Writer(output, compression=COMPRESSIONS[compression], **options)
        writer.start()
        if metadata:
            writer.add_metadata("svmdist", dict(metadata))
        channels: dict[tuple[str, str, str], int] = {}
        for topic, schema, encoding, data, log_time_ns in messages:
            key = (topic, schema, encoding)
            if key not in channels:
                schema_id = writer.register_schema(schema, {"cdr": "ros2msg"}.get(encoding, encoding), b"")
                channels[key] = writer.register_channel(topic, encoding, schema_id)
            writer.add_message(channels[key], log_time_ns, data, log_time_ns)
        writer.finish()
    return path
