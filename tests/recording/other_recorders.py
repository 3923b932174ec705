"""The scene as other recorders write it: ROS 2, ROS 1 and Foxglove's JSON, by libraries that are not svmdist's."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from mcap_ros2.writer import Writer as Ros2McapWriter
from rosbags.rosbag1 import Writer as Bag1Writer
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from svmdist.samples import CameraSample, ImageSample, JointSample, PoseSample, Sample, TransformsSample
from svmdist.transforms import Array, quaternion_xyzw_from_rotation

from .builders import Entry

Message = tuple[str, str, dict[str, Any], int]
"""Topic, ROS type with `/msg/`, fields, and log time in ns."""


def header(stamp_ns: int, frame_id: str) -> dict[str, Any]:
    """A std_msgs/Header, with the number that only ROS 1 has."""
    stamp = {"sec": stamp_ns // 10**9, "nanosec": stamp_ns % 10**9}
    return {"seq": 0, "stamp": stamp, "frame_id": frame_id}


def rigid(T: Array, position: str, rotation: str) -> dict[str, Any]:
    """A position and a rotation under the names that a message gives them."""
    x, y, z, w = quaternion_xyzw_from_rotation(T[:3, :3]).tolist()
    return {
        position: dict(zip("xyz", T[:3, 3].tolist(), strict=True)),
        rotation: {"x": x, "y": y, "z": z, "w": w},
    }


def ros_image(image: np.ndarray, encoding: str) -> dict[str, Any]:
    """The fields of a sensor_msgs/Image without its header; `image` is laid out as `encoding` says."""
    return {
        "height": image.shape[0],
        "width": image.shape[1],
        "encoding": encoding,
        "is_bigendian": 0,
        "step": image[0].size,
        "data": image.ravel(),
    }


def ros_message(sample: Sample) -> tuple[str, dict[str, Any]] | None:
    """A sample as a ROS type and fields; None for what ROS has no message for."""
    match sample:
        case ImageSample():
            head = {"header": header(sample.stamp_ns, sample.frame_id)}
            return "sensor_msgs/msg/Image", head | ros_image(sample.image_bgr[:, :, ::-1], "rgb8")
        case CameraSample(camera=camera):
            return "sensor_msgs/msg/CameraInfo", {
                "header": header(sample.stamp_ns, camera.frame_id),
                "height": camera.height_px,
                "width": camera.width_px,
                "distortion_model": "plumb_bob",
                "d": camera.D,
                "k": camera.K.ravel(),
                "r": camera.R_rectified_camera.ravel(),
                "p": camera.P.ravel(),
                "binning_x": 0,
                "binning_y": 0,
                "roi": {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False},
            }
        case JointSample():
            return "sensor_msgs/msg/JointState", {
                "header": header(sample.stamp_ns, ""),
                "name": list(sample.names),
                "position": sample.positions,
                "velocity": np.zeros(0),
                "effort": np.zeros(0),
            }
        case PoseSample():
            return "geometry_msgs/msg/PoseStamped", {
                "header": header(sample.stamp_ns, sample.frame_id),
                "pose": rigid(sample.T_frame_pose, "position", "orientation"),
            }
        case TransformsSample():
            return "tf2_msgs/msg/TFMessage", {
                "transforms": [
                    {
                        "header": header(one.stamp_ns, one.parent),
                        "child_frame_id": one.child,
                        "transform": rigid(one.T_parent_child, "translation", "rotation"),
                    }
                    for one in sample.transforms
                ]
            }
    return None


def ros_messages(entries: Sequence[Entry]) -> list[Message]:
    """All entries that ROS has messages for."""
    found = [(entry, ros_message(entry.sample)) for entry in entries]
    return [(entry.topic, *message, entry.sample.stamp_ns) for entry, message in found if message]


def build(store: Typestore, type_name: str, fields: dict[str, Any]) -> Any:
    """Make a message object of rosbags from plain fields; ROS 1 writes D, K, R, P large."""
    values = {}
    for name, (node, argument) in store.get_msgdef(type_name).fields:
        value = fields[name if name in fields else name.lower()]
        if node.name == "NAME":
            value = build(store, str(argument), value)
        elif node.name in ("ARRAY", "SEQUENCE") and argument[0][0].name == "NAME":
            value = [build(store, str(argument[0][1]), item) for item in value]
        values[name] = value
    return store.types[type_name](**values)


def write_ros2_mcap(path: Path, messages: Sequence[Message], *, with_msg: bool = True) -> Path:
    """Write with mcap-ros2-support; `with_msg` chooses between the two ways to write a type's name."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    with path.open("wb") as output:
        writer = Ros2McapWriter(output, chunk_size=8192)
        schemas: dict[str, Any] = {}
        for topic, type_name, fields, log_time_ns in messages:
            if type_name not in schemas:
                definition, _ = store.generate_msgdef(type_name, ros_version=2)
                name = type_name if with_msg else type_name.replace("/msg/", "/")
                schemas[type_name] = writer.register_msgdef(name, definition)
            writer.write_message(topic, schemas[type_name], sanitize(fields), log_time_ns, log_time_ns)
        writer.finish()
    return path


def sanitize(value: Any) -> Any:
    """Arrays as bytes or lists, as mcap-ros2-support wants them."""
    if isinstance(value, np.ndarray):
        return value.tobytes() if value.dtype == np.uint8 else value.tolist()
    if isinstance(value, dict):
        return {key: sanitize(item) for key, item in value.items()}
    return [sanitize(item) for item in value] if isinstance(value, list) else value


def write_rosbag2(
    folder: Path, messages: Sequence[Message], storage: StoragePlugin, *, compressed: bool = False
) -> Path:
    """Write a rosbag2 folder with rosbags."""
    store = get_typestore(Stores.ROS2_HUMBLE)
    writer = Bag2Writer(folder, version=9, storage_plugin=storage)
    if compressed:
        writer.set_compression(CompressionMode.MESSAGE, CompressionFormat.ZSTD)
    _write_all(writer, store, store.serialize_cdr, messages)
    return folder


def write_rosbag1(
    path: Path, messages: Sequence[Message], compression: Bag1Writer.CompressionFormat | None = None
) -> Path:
    """Write a ROS 1 bag with rosbags."""
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))
    writer = Bag1Writer(path)
    if compression is not None:
        writer.set_compression(compression)
    writer.chunk_threshold = 8192
    _write_all(writer, store, store.serialize_ros1, messages)
    return path


def _write_all(
    writer: Bag1Writer | Bag2Writer,
    store: Typestore,
    serialize: Callable[[Any, str], bytes | memoryview],
    messages: Sequence[Message],
) -> None:
    """Write messages, with a connection for each topic made when its first one comes."""
    with writer:
        connections: dict[str, Any] = {}
        for topic, type_name, fields, log_time_ns in messages:
            if topic not in connections:
                connections[topic] = writer.add_connection(topic, type_name, typestore=store)
            writer.write(connections[topic], log_time_ns, serialize(build(store, type_name, fields), type_name))


MCAP, SQLITE, BAG1 = StoragePlugin.MCAP, StoragePlugin.SQLITE3, Bag1Writer.CompressionFormat
WRITERS: dict[str, Callable[[Path, list[Message]], Path]] = {
    "ros2 mcap": lambda folder, it: write_ros2_mcap(folder / "a.dat", it),
    "ros2 mcap without /msg/": lambda folder, it: write_ros2_mcap(folder / "a.mcap", it, with_msg=False),
    "rosbag2 sqlite": lambda folder, it: write_rosbag2(folder / "a", it, SQLITE),
    "rosbag2 sqlite compressed": lambda folder, it: write_rosbag2(folder / "a", it, SQLITE, compressed=True),
    "rosbag2 mcap": lambda folder, it: write_rosbag2(folder / "a", it, MCAP),
    "rosbag2 mcap compressed": lambda folder, it: write_rosbag2(folder / "a", it, MCAP, compressed=True),
    "bare db3": lambda folder, it: (write_rosbag2(folder / "a", it, SQLITE) / "a.db3").rename(folder / "b.dat"),
    "ros1 bag": lambda folder, it: write_rosbag1(folder / "a.dat", it),
    "ros1 bag lz4": lambda folder, it: write_rosbag1(folder / "a.bag", it, BAG1.LZ4),
    "ros1 bag bz2": lambda folder, it: write_rosbag1(folder / "a.bag", it, BAG1.BZ2),
}
