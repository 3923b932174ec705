"""Import: images or video, a calibration, and tables of poses and joints, written as a log."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

import numpy as np

from svmdist.camera import Camera
from svmdist.errors import SvmdistError
from svmdist.importing.cameras import CalibrationOptions, complete, stated_cameras
from svmdist.importing.tables import ImageTimes, read_joints, read_poses
from svmdist.profile import Limits
from svmdist.recording.messages.encoding import EncodedSample, encode_still
from svmdist.recording.writer import RecordingWriter
from svmdist.samples import CameraSample, ImageSample, JointSample, PoseSample, Sample
from svmdist.workflows.import_views import Picture, View, ViewOptions, halves, open_views

SIDES = ("left", "right")
FRAMES = ("camera", "camera_right")
Message = tuple[int, str, "Sample | EncodedSample"]
"""Stamp in ns, topic, and what is written."""


@dataclass(frozen=True)
class ImportOptions:
    """All that an import reads; `poses` and `joints` are tables by the instrument's name."""

    views: ViewOptions
    calibration: CalibrationOptions
    poses: Mapping[str, Path] = field(default_factory=dict)
    joints: Mapping[str, Path] = field(default_factory=dict)
    joint_names: tuple[str, ...] | None = None
    jpeg_quality: int | None = None


@dataclass(frozen=True)
class ImportResult:
    """What was written: numbers of messages by topic, the size in bytes, and whether a pair has a known baseline."""

    path: Path
    counts: dict[str, int]
    size_bytes: int
    has_baseline: bool | None


def import_log(
    options: ImportOptions,
    output: Path,
    *,
    force: bool = False,
    limits: Limits | None = None,
    on_progress: Callable[[int, int], None] | None = None,
) -> ImportResult:
    """Write a log of files; `on_progress` hears of (images done, images in all).

    PNG and JPEG files are written as they are. Decoded pictures become PNG, or JPEG of `jpeg_quality`, 1 to 100.
    Raises UsageError, SourceError or OutputError in one line, and leaves no file then.
    """
    limits = limits or Limits()
    stated = stated_cameras(options.calibration, options.views.count)
    views = open_views(options.views, limits)
    count = options.views.count
    sizes = [_size_of(view, options.views) for view in views] * (count // len(views))
    cameras = complete(stated, sizes, FRAMES[:count])
    times = ImageTimes(views[0].names, views[0].stamps_ns)
    tables = [*_pose_messages(options, times), *_joint_messages(options, times)]
    images = [_image_messages(views, at, cameras, options, limits) for at in range(len(views))]
    total = sum(len(range(0, len(view.names), options.views.every)) for view in views)
    counts: dict[str, int] = {}
    done = 0
    writer = RecordingWriter(output, _metadata(options), force=force, jpeg_quality=options.jpeg_quality)
    try:
        with writer:
            for _, topic, sample in heapq.merge(*images, *tables, key=lambda message: message[0]):
                writer.write(topic, sample)
                counts[topic] = counts.get(topic, 0) + 1
                if topic.endswith("/image") and on_progress is not None:
                    done += 1
                    on_progress(done // (count // len(views)), total)
    except SvmdistError:
        with suppress(OSError):
            if writer.opened:
                writer.part_path.unlink(missing_ok=True)
        raise
    has_baseline = None if count == 1 else bool(np.any(np.asarray(cameras[1].P)[:2, 3]))
    return ImportResult(output, counts, output.stat().st_size, has_baseline)


def _size_of(view: View, options: ViewOptions) -> tuple[int, int]:
    width_px, height_px = view.size_px
    return (width_px // 2, height_px) if options.side_by_side else (width_px, height_px)


def _image_messages(
    views: Sequence[View], at: int, cameras: Sequence[Camera], options: ImportOptions, limits: Limits
) -> Iterator[Message]:
    """Calibration and images of one view, or of both that a picture has side by side."""
    view = views[at]
    for place, picture in view.read():
        stamp_ns = view.stamps_ns[place]
        parts: Sequence[Picture] = (picture,)
        if options.views.side_by_side:
            parts = halves(picture, view.names[place], limits)
        for side, part in enumerate(parts, at):
            yield stamp_ns, f"/ECM/{SIDES[side]}/camera_info", CameraSample(stamp_ns, cameras[side])
            yield stamp_ns, f"/ECM/{SIDES[side]}/image", _image(stamp_ns, FRAMES[side], part, limits)


def _image(stamp_ns: int, frame_id: str, picture: Picture, limits: Limits) -> Sample | EncodedSample:
    if isinstance(picture, bytes):
        return encode_still(stamp_ns, frame_id, picture, limits)
    return ImageSample(stamp_ns, frame_id, picture)


def _pose_messages(options: ImportOptions, times: ImageTimes) -> list[list[Message]]:
    found: list[list[Message]] = []
    for name, path in options.poses.items():
        poses = read_poses(path, times, options.calibration.unit_m)
        found.append(
            [
                (stamp_ns, f"/{name}/measured_cp", PoseSample(stamp_ns, f"{name}_base", T))
                for stamp_ns, T in zip(poses.stamps_ns, poses.T, strict=True)
            ]
        )
    return found


def _joint_messages(options: ImportOptions, times: ImageTimes) -> list[list[Message]]:
    found: list[list[Message]] = []
    for name, path in options.joints.items():
        joints = read_joints(path, times, options.joint_names)
        found.append(
            [
                (stamp_ns, f"/{name}/measured_js", JointSample(stamp_ns, joints.names, positions))
                for stamp_ns, positions in zip(joints.stamps_ns, joints.positions, strict=True)
            ]
        )
    return found


def _metadata(options: ImportOptions) -> dict[str, str]:
    """What the log says of its origin: names of files, without folders."""
    views = options.views
    sources = [views.source.name] + ([views.right.name] if views.right is not None else [])
    tables = [path.name for path in (*options.poses.values(), *options.joints.values())]
    return {
        "imported_from": ", ".join([*sources, *tables]),
        "side_by_side": "yes" if views.side_by_side else "no",
        "version_svmdist": version("svmdist"),
    }
