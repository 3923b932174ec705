"""A profile and a log that are changed as people get them wrong: what benchmarks/mistakes.py is made of.

A `Change` works on a `Case`: a profile as in TOML, and the messages of a log as protobuf.
"""

from __future__ import annotations

import math
import tomllib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import tomli_w

from svmdist.profile import Limits, load_profile, profile_path
from svmdist.recording.images import decode_still
from svmdist.recording.log import open_recording
from svmdist.recording.mcap import McapSource
from svmdist.recording.messages import kind_of, matrices, message_class
from svmdist.recording.writer import EncodedSample, RecordingWriter
from svmdist.transforms import Array, inverse, quaternion_xyzw_from_rotation, skew

INFOS, IMAGES = ("camera_info", "right_camera_info"), ("image", "right_image")
ROLES = (*INFOS, *IMAGES, "joints", "pose", "tf", "ground_truth_tf")
WORKPLACE_M = np.array([0.0, 0.0, 0.1])  # in the camera's frame
HAND_EYE_STD = (2e-3, 2e-3, 2e-3, 0.02, 0.02, 0.02)  # of a fitted transform, at the workplace, in m and rad
SEMI_AXES_M = (0.028, 0.022)  # of the outlines that the simulation's tissue has, about


@dataclass
class Case:
    """A profile and a log that a mistake changes: `profile` as in TOML, messages as [topic, log time, message]."""

    folder: Path
    profile: dict[str, Any]
    topics: dict[str, str | None]
    messages: list[list[Any]]
    metadata: dict[str, str]
    options: list[str] = field(default_factory=list)
    is_changed: bool = False

    def of(self, *roles: str, from_share: float = 0.0) -> Iterator[Any]:
        """The messages of some roles, which are about to be changed, from a share of the log on."""
        for topic in {self.topics[role] for role in roles} - {None}:
            entries = [entry[2] for entry in self.messages if entry[0] == topic]
            self.is_changed |= bool(entries)
            yield from entries[int(from_share * len(entries)) :]

    def at(self, path: str) -> tuple[Any, Any]:
        """Where a value of the profile is, by a path as `robot.joints.yaw.a_m`."""
        *way, last = path.split(".")
        place: Any = self.profile
        for key in way:
            place = next(one for one in place if one["name"] == key) if isinstance(place, list) else place[key]
        self.is_changed = True
        return place, last

    def transforms(self, role: str, parent: str, child: str) -> Iterator[Any]:
        """The logged transforms from a frame of the profile to another."""
        wanted = self.frame(parent), self.frame(child)
        for message in self.of(role):
            yield from (one for one in message.transforms if (one.parent_frame_id, one.child_frame_id) == wanted)

    def frame(self, key: str) -> str:
        """The name of a frame, by its key in the profile."""
        return str(self.profile.get("frames", {}).get(key, key))

    def write(self, path: Path) -> Path:
        """Write the log, and the profile beside it; give the profile's path."""
        (profile := self.folder / "profile.toml").write_text(tomli_w.dumps(self.profile))
        with RecordingWriter(path, self.metadata) as writer:
            for topic, stamp_ns, message in self.messages:
                schema, data = message.DESCRIPTOR.full_name, message.SerializeToString()
                writer.write(topic, EncodedSample(stamp_ns, schema, data))
        return profile


Change = Callable[[Case], object]
Turn = Callable[[Array, Array], tuple[Array, Array]]
Values = dict[str, float]


def put(path: str, value: Any) -> Change:
    """A value of the profile; None takes it out, and a function makes it of the right one."""

    def change(case: Case) -> None:
        place, key = case.at(path)
        if value is None:
            del place[key]
        else:
            place[key] = value(place[key]) if callable(value) else value

    return change


def times(path: str, factor: float) -> Change:
    """A number of the profile, multiplied."""
    return put(path, lambda right: factor * right)


def exchanged_joints(one: str, other: str) -> Change:
    """The names of two joints of the chain, exchanged: the log's values reach each other's row."""

    def change(case: Case) -> None:
        (a, key), (b, _) = case.at(f"robot.joints.{one}.name"), case.at(f"robot.joints.{other}.name")
        a[key], b[key] = b[key], a[key]

    return change


def other_chain(case: Case) -> None:
    """The robot of another profile."""
    put("robot", tomllib.loads(profile_path("dvrk-psm").read_text())["robot"])(case)
    case.profile.pop("simulation", None)


def mesh(case: Case, *, y_up: bool = False, raised_m: float = 0.0, factor: float = 1.0) -> None:
    """The dome as a closed mesh, on an ellipse that is turned as the true tissue."""
    tissue, _ = case.at("tissue.dome")
    dome = tissue.pop("dome")
    turn, radius = np.arange(64) * np.pi / 32, np.sin(np.linspace(0.0, np.pi / 2, 17)[1:])
    z_m = dome["height_m"] * (1.0 - radius ** dome["gauge_exponent"]) ** dome["height_exponent"]
    xy_m = radius[:, None, None] * np.stack([np.cos(turn), np.sin(turn)], -1) * SEMI_AXES_M
    rings = np.concatenate([xy_m, np.broadcast_to(z_m[:, None, None], (*xy_m.shape[:2], 1))], -1).reshape(-1, 3)
    vertices = factor * np.vstack([rings, [[0.0, 0.0, dome["height_m"]], [0.0, 0.0, 0.0]]])
    vertices = vertices @ np.array([[1, 0, 0], [0, 0, -1], [0, 1, 0]]) if y_up else vertices
    here = 1 + np.arange(len(rings)).reshape(len(radius), -1)
    after, top = np.roll(here, -1, axis=1), np.full(len(turn), len(rings) + 1)
    parts = [(here[:-1], here[1:], after[1:]), (here[:-1], after[1:], after[:-1])]
    parts += [(top, here[0], after[0]), (top + 1, after[-1], here[-1])]
    faces = [f"f {a} {b} {c}" for part in parts for a, b, c in np.stack(part, -1).reshape(-1, 3)]
    path = case.folder / "tissue.obj"
    path.write_text("\n".join([*(f"v {x} {y} {z}" for x, y, z in vertices), *faces]))
    true = next(case.transforms("ground_truth_tf", "camera", "tissue"))
    R = matrix(true.translation, true.rotation)
    tissue |= {"mesh": str(path), "mesh_position_m": [0.0, 0.0, raised_m], "surface_std_m": 1e-3}
    tissue["mesh_yaw_rad"] = math.atan2(-R[1, 0], R[0, 0])  # the camera looks along -z of the tissue


def matrix(t: Any, q: Any) -> Array:
    """The transform, shape (4, 4), of a translation and a quaternion of a log."""
    return np.asarray(matrices(np.array([[t.x, t.y, t.z, q.x, q.y, q.z, q.w]]))[0])


def base(turn: Turn) -> Change:
    """The logged transforms from camera to base, as a function of the right ones makes them."""

    def change(case: Case) -> None:
        for one in case.transforms("tf", "camera", "base"):
            T = matrix(one.translation, one.rotation)
            R, t = turn(T[:3, :3], T[:3, 3])
            one.translation.x, one.translation.y, one.translation.z = t
            one.rotation.x, one.rotation.y, one.rotation.z, one.rotation.w = quaternion_xyzw_from_rotation(R)

    return change


def hand_eye(turn: Turn) -> Change:
    """A hand-eye file, as a function of what the true pose of the tool makes of the recorded one."""

    def change(case: Case) -> None:
        true, nominal = next(case.transforms("ground_truth_tf", "camera", "tool")), next(case.of("pose")).pose
        T = matrix(true.translation, true.rotation) @ inverse(matrix(nominal.position, nominal.orientation))
        R, t = turn(T[:3, :3], T[:3, 3])
        J = np.eye(6)
        J[:3, 3:] = skew(WORKPLACE_M - T[:3, 3])
        one = {"instrument": "PSM1", "camera": case.frame("camera"), "base": case.frame("base")}
        one |= {"rotation": R.tolist(), "translation_m": t.tolist()}
        one["covariance"] = (J @ np.diag(HAND_EYE_STD) ** 2 @ J.T).tolist()
        path = case.folder / "hand-eye.toml"
        path.write_text(tomli_w.dumps({"format": "svmdist.hand-eye/1", "transforms": [one]}))
        case.options += ["--hand-eye", str(path)]

    return change


def about_y(degrees: float) -> Array:
    """A rotation, shape (3, 3)."""
    return np.asarray(cv2.Rodrigues(np.array([0.0, math.radians(degrees), 0.0]))[0])


def turned(degrees: float) -> Turn:
    """The base turned about the workplace."""
    Y = about_y(degrees)
    return lambda R, t: (Y @ R, Y @ (t - WORKPLACE_M) + WORKPLACE_M)


def infos(change: Callable[[Any], object], *roles: str, from_share: float = 0.0) -> Change:
    """The calibrations in the log, by a function that changes a message."""
    return lambda case: [change(message) for message in case.of(*(roles or INFOS), from_share=from_share)]


def optics(change: Callable[[Array], Array], *roles: str, from_share: float = 0.0) -> Change:
    """The cameras' matrices K, and P with the baseline that they have, by a function of K."""

    def changed(message: Any) -> None:
        K = np.array(message.K).reshape(3, 3)
        message.K[:] = change(K).ravel().tolist()
        message.P[:] = (change(K) @ np.linalg.inv(K) @ np.reshape(message.P, (3, 4))).ravel().tolist()

    return infos(changed, *roles, from_share=from_share)


def focal(factor: float, from_share: float = 0.0) -> Change:
    """Focal lengths multiplied."""
    return optics(lambda K: K * [[factor, 1, 1], [1, factor, 1], [1, 1, 1]], from_share=from_share)


def half_size(case: Case) -> None:
    """The calibration of images of half the size, which says so."""
    optics(lambda K: np.diag([0.5, 0.5, 1.0]) @ K)(case)
    for message in case.of(*INFOS):
        message.width, message.height = message.width // 2, message.height // 2


def baseline(factor: float) -> Change:
    """The right camera's position, multiplied."""
    return infos(lambda message: message.P.__setitem__(3, factor * message.P[3]), "right_camera_info")


def images(change: Callable[[Any], Any], from_share: float = 0.0) -> Change:
    """The images of both views, by a function of an image."""

    def changed(case: Case) -> None:
        for role in IMAGES:
            for message in case.of(role, from_share=from_share):
                image = np.ascontiguousarray(change(decode_still(message.data, Limits())))
                message.format = "jpeg"
                message.data = cv2.imencode(".jpg", image, (cv2.IMWRITE_JPEG_QUALITY, 92))[1].tobytes()

    return changed


def zoomed(image: Any) -> Any:
    """1.25 times as large about the middle."""
    height, width = image.shape[:2]
    A = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), 0.0, 1.25)
    return cv2.warpAffine(image, A, (width, height))


def exchanged_views(case: Case, *, twice: bool = False) -> None:
    """The images of both views exchanged, or the left one in the right one's place."""
    for right, left in zip(case.of("right_image"), case.of("image"), strict=False):
        left.data, right.data = left.data if twice else right.data, left.data


def late(role: str, seconds: float) -> Change:
    """Later stamps."""

    def change(case: Case) -> None:
        shifted = {id(message) for message in case.of(role)}
        for entry in (entry for entry in case.messages if id(entry[2]) in shifted):
            entry[1] += round(seconds * 1e9)
            entry[2].timestamp.FromNanoseconds(entry[1])
        case.messages.sort(key=lambda entry: int(entry[1]))

    return change


def joints(change: Callable[[Values], Values], from_share: float = 0.0) -> Change:
    """The joints' positions by name, as a function of the right ones makes them."""

    def changed(case: Case) -> None:
        for message in case.of("joints", from_share=from_share):
            values = {joint.name: joint.position for joint in message.joints}
            values |= change(values)
            for joint in message.joints:
                joint.position = values[joint.name]

    return changed


def stuck(*names: str) -> Change:
    """Joints that keep the value that they have a third into the log; all without names."""

    def change(case: Case) -> None:
        first = next(case.of("joints", from_share=1 / 3))
        kept = {joint.name: joint.position for joint in first.joints if joint.name in names or not names}
        joints(lambda _: kept, 1 / 3)(case)

    return change


def in_degrees(values: Values) -> Values:
    """Angles in degrees."""
    return {name: math.degrees(value) for name, value in values.items() if name not in ("insertion", "setup_1")}


def both(*changes: Change) -> Change:
    """Several changes that are one mistake."""
    return lambda case: [change(case) for change in changes]


def opened(path: str, profile_name: str, views: str, folder: Path) -> Case:
    """A case in which nothing is changed yet."""
    profile, checked = tomllib.loads(profile_path(profile_name).read_text()), load_profile(profile_name)
    profile.pop("calibration", None)  # of the planar methods, by a name beside the profile
    if checked.tissue and checked.tissue.mesh:
        profile["tissue"]["mesh"] = str(checked.tissue.mesh.absolute())
    log, source = open_recording(path, checked), McapSource(Path(path), Limits())
    topics = {role: log.topic_of(role) for role in ROLES}
    dropped = {topics["right_image"], topics["right_camera_info"]} if views == "one" else set()
    messages = [
        [raw.topic, raw.log_time_ns, message_class(raw.schema).FromString(raw.data)]
        for raw in source.messages()
        if raw.topic not in dropped and kind_of(raw)
    ]
    return Case(folder, profile, topics, messages, source.metadata())
