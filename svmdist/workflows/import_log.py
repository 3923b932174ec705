"""The views that an import reads: files or videos, their times, and each image as a message or as pixels.

A PNG or JPEG is passed on as it is. Other formats, frames of a video and halves of pictures side by side are decoded.
"""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from importlib.metadata import version
from pathlib import Path

import numpy as np

from svmdist.camera import Camera
from svmdist.errors import SourceError, SvmdistError, UsageError
from svmdist.importing.calibration import CalibrationOptions, complete, stated_cameras
from svmdist.importing.images import ImageFiles, Video, list_images, pair
from svmdist.importing.tables import (
    ImageTimes,
    read_joints,
    read_poses,
    read_times,
    require_rising,
    stamps_at_rate,
    stamps_from_names,
)
from svmdist.profile import Limits
from svmdist.recording.encode import EncodedSample, encode_still
from svmdist.recording.images import ImageError, decode_file, read_file, still_size
from svmdist.recording.writer import RecordingWriter
from svmdist.samples import CameraSample, Image, ImageSample, JointSample, PoseSample, Sample

Picture = bytes | Image
"""A file's bytes, PNG or JPEG, or decoded pixels, BGR."""


@dataclass(frozen=True)
class ViewOptions:
    """Which files, and where their times come from; `rate_hz`, `times`, or else names and videos themselves."""

    source: Path
    right: Path | None = None
    pattern: str | None = None
    right_pattern: str | None = None
    side_by_side: bool = False
    rate_hz: float | None = None
    start_ns: int = 0
    times: Path | None = None
    every: int = 1

    @property
    def count(self) -> int:
        """How many views there are."""
        has_right = self.side_by_side or self.right is not None or self.right_pattern is not None
        return 2 if has_right else 1


@dataclass(frozen=True)
class View:
    """One stream of pictures: names and stamps in ns of all of them, the size in px of one, and how to read them.

    `read` gives (place, picture) of every `ViewOptions.every`-th of them, in order.
    """

    names: list[str]
    stamps_ns: list[int]
    size_px: tuple[int, int]
    read: Callable[[], Iterator[tuple[int, Picture]]]


def open_views(options: ViewOptions, limits: Limits) -> list[View]:
    """One view, or the left and the right one; a single view that is side by side has both.

    Raises SourceError and UsageError in one line.
    """
    if options.side_by_side and (options.right is not None or options.right_pattern is not None):
        raise UsageError("--side-by-side has both views in one picture: it takes no second source")
    if options.rate_hz is not None and options.times is not None:
        raise UsageError("--rate and --times exclude each other: which of them tells the time?")
    for source in (options.source, options.right):
        if source is not None and not source.exists():
            raise SourceError(f"{source}: no such folder or video")
    if options.source.is_dir():
        views = _file_views(options, limits)
    elif options.right is not None and options.right.is_dir():
        raise UsageError(
            f"{options.right}: is a folder, and {options.source} a video: both views come in one form"
        )
    else:
        views = _video_views(options, limits)
    if options.side_by_side and views[0].size_px[0] % 2:
        raise SourceError(
            f"{views[0].names[0]}: {views[0].size_px[0]} px wide: two views side by side have one width"
        )
    return views


def halves(picture: Picture, name: str, limits: Limits) -> tuple[Image, Image]:
    """The left and the right view of a picture that has them side by side."""
    image = decode_file(picture, name, limits) if isinstance(picture, bytes) else picture
    middle = image.shape[1] // 2
    return np.ascontiguousarray(image[:, :middle]), np.ascontiguousarray(image[:, middle:])


def _file_views(options: ViewOptions, limits: Limits) -> list[View]:
    left = list_images(options.source, options.pattern)
    files = ImageFiles(left)
    own_stamps = None
    if options.right is not None or options.right_pattern is not None:
        folder = options.right or options.source
        if not folder.is_dir():
            raise UsageError(
                f"{folder}: is no folder, and {options.source} is one: both views come in one form"
            )
        right = list_images(folder, options.right_pattern or (options.pattern if options.right else None))
        if set(right) & set(left):
            raise UsageError(
                "both views have the same images: tell them apart by --pattern and --right-pattern"
            )
        if options.rate_hz is None and options.times is None:
            own_stamps = [stamps_from_names([path.name for path in side]) for side in (left, right)]
        files = pair(left, right, by_stamps=own_stamps is not None and None not in own_stamps)
    stamps = _stamps(options, files.names, None)
    views = [_file_view(files.left, stamps, options.every, limits)]
    if files.right is not None:
        names = [path.name for path in files.right]
        theirs = own_stamps[1] if own_stamps is not None else None
        if theirs is not None:
            require_rising(theirs, names, str(files.right[0].parent))
        views.append(_file_view(files.right, theirs or stamps, options.every, limits))
    return views


def _file_view(paths: Sequence[Path], stamps_ns: list[int], every: int, limits: Limits) -> View:
    def read() -> Iterator[tuple[int, Picture]]:
        for place in range(0, len(paths), every):
            yield place, _checked(read_file(paths[place], limits), paths[place].name)

    def _checked(picture: Picture, name: str) -> Picture:
        found = _size(picture, name, limits)
        if found != size_px:
            raise SourceError(
                f"{name}: {found[0]}x{found[1]} px; {paths[0].name} has {size_px[0]}x{size_px[1]} px"
            )
        return picture

    size_px = _size(read_file(paths[0], limits), paths[0].name, limits)
    return View([path.name for path in paths], stamps_ns, size_px, read)


def _size(picture: Picture, name: str, limits: Limits) -> tuple[int, int]:
    if isinstance(picture, bytes):
        try:
            return still_size(picture, limits)
        except ImageError as problem:
            raise SourceError(f"{name}: {problem}") from None
    return picture.shape[1], picture.shape[0]


def _video_views(options: ViewOptions, limits: Limits) -> list[View]:
    if options.pattern is not None or options.right_pattern is not None:
        raise UsageError(f"{options.source}: --pattern is for folders of images")
    views: list[View] = []
    stamps: list[int] = []
    for path in (options.source, options.right):
        if path is None:
            continue
        video = Video(path)
        width_px, height_px = video.size_px
        if width_px * height_px > limits.image_pixels:
            raise SourceError(f"{path}: {width_px}x{height_px} px, the limit is {limits.image_pixels} px")
        times = video.times_ns
        names = [f"image {place} of {path.name}" for place in range(len(times))]
        if views and len(times) != len(views[0].names):
            raise SourceError(f"{path}: {len(times)} images; {options.source} has {len(views[0].names)}")
        stamps = stamps or _stamps(options, names, times)
        views.append(View(names, stamps, video.size_px, _every(video, options.every)))
    return views


def _every(video: Video, every: int) -> Callable[[], Iterator[tuple[int, Picture]]]:
    return lambda: ((place, image) for place, image in video.images() if place % every == 0)


def _stamps(options: ViewOptions, names: list[str], times_ns: list[int] | None) -> list[int]:
    """The stamps of all images of the left view."""
    if options.times is not None:
        stamps = read_times(options.times, names)
        require_rising(stamps, names, str(options.times))
        return stamps
    if options.rate_hz is not None:
        return stamps_at_rate(len(names), options.rate_hz, options.start_ns)
    if times_ns is not None:
        return [options.start_ns + time_ns for time_ns in times_ns]
    found = stamps_from_names(names)
    if found is None:
        raise UsageError(
            f"the name {names[0]} tells no time (in s or ns since 1970): give --rate HZ or --times FILE"
        )
    require_rising(found, names, str(options.source))
    return found


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
