"""Import: images or video, a calibration, and tables of poses and joints, written as a log."""

from __future__ import annotations

import heapq
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from importlib.metadata import version
from itertools import groupby, islice
from operator import itemgetter
from pathlib import Path

import numpy as np

from svmdist.camera import Camera, stereo_transform
from svmdist.errors import RecordingError, SourceError, SvmdistError, UsageError
from svmdist.files import nearest_file, open_regular, reading
from svmdist.importing import tables as table_files
from svmdist.importing.calibration import CalibrationOptions, Crop, complete, exchanged_names, given_cameras
from svmdist.importing.images import Video, list_images, matching, missing_numbers, require_one_view
from svmdist.profile import Limits, load_profile
from svmdist.recording.images import ImageError, decode_still, read_file
from svmdist.recording.topics import open_source
from svmdist.recording.writer import EncodedSample, RecordingWriter, encode_still
from svmdist.samples import CameraSample, Image, ImageSample, JointSample, Observation, PoseSample, RightView, Sample
from svmdist.transforms import Array
from svmdist.workflows.check import LOOKED_AT, compare_views
from svmdist.workflows.parallel import Progress, unwatched

LIMITS = Limits()
SIDES = ("left", "right")
FRAMES = ("camera", "camera_right")
Picture = bytes | Image
"""A PNG or JPEG, which is stored as it is; else pixels, BGR: of other formats, of a video, of a part of a picture."""
Message = tuple[int, str, "Sample | EncodedSample"]  # stamp in ns, topic, and what is written


@dataclass(frozen=True)
class ImportOptions:
    """All that is read; times by `rate_hz`, `times`, or else names and videos; tables by the instrument's name."""

    source: Path
    calibration: CalibrationOptions
    right: Path | None = None
    pattern: str | None = None
    right_pattern: str | None = None
    side_by_side: bool = False
    rate_hz: float | None = None
    start_ns: int = 0
    times: Path | None = None
    every: int = 1
    crop: Crop = None
    poses: Mapping[str, Path] = field(default_factory=dict)
    joints: Mapping[str, Path] = field(default_factory=dict)
    joint_names: tuple[str, ...] | None = None
    jpeg_quality: int | None = None

    @property
    def has_right_source(self) -> bool:
        """Whether the right view has files of its own."""
        return self.right is not None or self.right_pattern is not None

    @property
    def takes_parts(self) -> bool:
        """Whether the log has parts of the pictures, which have to be decoded for it."""
        return self.side_by_side or self.crop is not None


@dataclass(frozen=True)
class ImportResult:
    """What was written: numbers of messages by topic, whether a pair has a known baseline, and what was left out."""

    path: Path
    counts: dict[str, int]
    size_bytes: int
    has_baseline: bool | None
    losses: list[str]
    warnings: list[str]  # what of names and both views contradicts the calibrations


@dataclass(frozen=True)
class View:
    """One stream of pictures of one size."""

    names: list[str]
    stamps_ns: list[int]
    size_px: tuple[int, int]
    read: Callable[[], Iterator[tuple[int, Picture]]]  # place and picture of every `ImportOptions.every`-th, in order
    losses: dict[int, str]  # what could not be read, and was left out, by the place


def import_log(
    options: ImportOptions, output: Path, *, force: bool = False, on_progress: Progress = unwatched
) -> ImportResult:
    """Write a log of files. Raises UsageError, SourceError or OutputError, and leaves no file then."""
    with suppress(RecordingError):
        open_source(options.source, LIMITS)
        raise UsageError(f"{options.source}: is a log already, which needs no import: svmdist info")
    halved = 2 if options.side_by_side else 1
    count = 2 if options.has_right_source else halved
    given = given_cameras(options.calibration, count)
    views = _open_views(options)
    sizes = [(view.size_px[0] // halved, view.size_px[1]) for view in views] * halved
    calibrated_px, unit_m = options.calibration.size_px, options.calibration.unit_m
    cameras = complete(given, sizes, FRAMES[:count], calibrated_px, options.crop, unit_m)
    tables, late = _table_messages(options, dict(zip(views[0].names, views[0].stamps_ns, strict=True)))
    images = [_image_messages(views, at, cameras, options) for at in range(len(views))]
    total = sum(len(range(0, len(view.names), options.every)) for view in views)
    sources = (options.source, options.right, *options.poses.values(), *options.joints.values())
    metadata = {
        "imported_from": ", ".join(path.name for path in sources if path is not None),
        "side_by_side": "yes" if options.side_by_side else "no",
        "version_svmdist": version("svmdist"),
    }
    T_left_right = stereo_transform(*cameras) if count == 2 else None
    said = [exchanged_names(given), *late]
    if options.rate_hz is not None and (missing := missing_numbers(views[0].names)):
        said.append(f"{missing}: by --rate these follow each other as all images do; --times FILE says otherwise")
    if T_left_right is not None:
        compared = compare_views(islice(_pairs(views, cameras, T_left_right, options), LOOKED_AT), load_profile())
        if compared.refusal:
            raise SourceError(f"no log is written: {compared.refusal}")
        said.append(compared.warning)
    writer = RecordingWriter(output, metadata, force=force, jpeg_quality=options.jpeg_quality)
    try:
        with writer:
            for _, topic, sample in heapq.merge(*images, *tables, key=lambda message: message[0]):
                writer.write(topic, sample)
                if topic.endswith("/image"):
                    on_progress(sum(writer.counts[f"/ECM/{side}/image"] for side in SIDES) // halved, total)
    except SvmdistError as problem:
        writer.discard()
        vars(problem).pop("__notes__", None)  # which say where the discarded file is
        raise
    has_baseline = None if count == 1 else T_left_right is not None
    losses = [loss for view in views for loss in view.losses.values()]
    warnings = [one for one in said if one]
    return ImportResult(output, dict(writer.counts), output.stat().st_size, has_baseline, losses, warnings)


def _image_messages(
    views: Sequence[View], at: int, cameras: Sequence[Camera], options: ImportOptions
) -> Iterator[Message]:
    for place, parts in _pictures(views[at], options):
        stamp_ns = views[at].stamps_ns[place]
        for side, part in enumerate(parts, at):
            if isinstance(part, bytes):
                message: Sample | EncodedSample = encode_still(stamp_ns, FRAMES[side], part, LIMITS)
            else:
                message = ImageSample(stamp_ns, FRAMES[side], part)
            yield stamp_ns, f"/ECM/{SIDES[side]}/camera_info", CameraSample(stamp_ns, cameras[side])
            yield stamp_ns, f"/ECM/{SIDES[side]}/image", message


def _pictures(view: View, options: ImportOptions) -> Iterator[tuple[int, Sequence[Picture]]]:
    """The places of a stream, each with its picture, cropped, or with both that stand side by side."""
    for place, picture in view.read():
        parts: Sequence[Picture] = [picture]
        if options.takes_parts:
            assert not isinstance(picture, bytes)  # decoded where it is read
            halves = np.split(picture, 2, axis=1) if options.side_by_side else [picture]
            x, y, width, height = options.crop or (0, 0, *halves[0].shape[1::-1])
            parts = [np.ascontiguousarray(half[y : y + height, x : x + width]) for half in halves]
        yield place, parts


def _pairs(
    views: Sequence[View], cameras: Sequence[Camera], T_left_right: Array, options: ImportOptions
) -> Iterator[Observation]:
    """Both views at each time, in order; from two streams those that stand at one place and can be decoded."""
    by_place = itemgetter(0)
    pictures = heapq.merge(*(_pictures(view, options) for view in views), key=by_place)
    for place, each in groupby(pictures, by_place):
        with suppress(ImageError):  # a file is stored as it is
            found = (part for _, parts in each for part in parts)
            images = [decode_still(one, LIMITS) if isinstance(one, bytes) else one for one in found]
            if len(images) == 2:
                right = RightView(images[1], cameras[1], T_left_right)
                yield Observation(views[0].stamps_ns[place], images[0], cameras[0], right=right)


def _table_messages(options: ImportOptions, images_ns: Mapping[str, int]) -> tuple[list[list[Message]], list[str]]:
    """The messages of each table, and in words which have rows near few images."""
    found: list[list[Message]] = []
    said: list[str] = []
    taken_ns = list(images_ns.values())[:: options.every]
    for name, path in options.poses.items():
        poses = table_files.read_poses(path, images_ns, options.calibration.unit_m, f"{name}_base")
        said.append(table_files.require_common_time(path, poses.stamps_ns, taken_ns))
        rows = zip(poses.stamps_ns.tolist(), poses.T_parent_child, strict=True)
        found.append([(ns, f"/{name}/measured_cp", PoseSample(ns, poses.parent, T)) for ns, T in rows])
    for name, path in options.joints.items():
        joints = table_files.read_joints(path, images_ns, options.joint_names)
        said.append(table_files.require_common_time(path, joints.stamps_ns, taken_ns))
        rows = zip(joints.stamps_ns.tolist(), joints.positions, strict=True)
        found.append([(ns, f"/{name}/measured_js", JointSample(ns, joints.names, q)) for ns, q in rows])
    return found, said


def _open_views(options: ImportOptions) -> list[View]:
    """One view, or the left and the right one; a single view that is side by side has both."""
    if options.side_by_side and options.has_right_source:
        raise UsageError("--side-by-side has both views in one picture: it takes no second source")
    if options.rate_hz is not None and options.times is not None:
        raise UsageError("--rate and --times cannot be combined; give one")
    sources = [source for source in (options.source, options.right) if source is not None]
    for source in sources:
        if not source.exists():
            near = ": give the folder, and --pattern" if "*" in source.name else nearest_file(source)
            raise SourceError(f"{source}: no such folder or video{near}")
        if not source.is_dir():
            with reading(source, SourceError):
                open_regular(source).close()  # a pipe or a device would be waited for
        if source.is_dir() != options.source.is_dir():
            form, other = ("is", "a video") if source.is_dir() else ("is no", "is one")
            raise UsageError(f"{source}: {form} folder, and {options.source} {other}: both views come in one form")
    views = _file_views(options) if options.source.is_dir() else _video_views(options, sources)
    width_px = views[0].size_px[0]
    if options.side_by_side and width_px % 2:
        raise SourceError(f"{views[0].names[0]}: {width_px} px wide: two views side by side have one width")
    return views


def _file_views(options: ImportOptions) -> list[View]:
    left = list_images(options.source, options.pattern)
    names = [path.name for path in left]
    if not options.has_right_source:
        require_one_view(left)
        return [_file_view(left, _stamps(options, names), options)]
    folder = options.right or options.source
    right = list_images(folder, options.right_pattern or (options.pattern if options.right else None))
    if set(right) & set(left):
        raise UsageError("both views have the same images: tell them apart by --pattern and --right-pattern")
    require_one_view(left)
    require_one_view(right)
    right_names = [path.name for path in right]
    stamps = right_stamps = _stamps(options, names)
    if options.rate_hz is None and options.times is None and (own := table_files.stamps_from_names(right_names)):
        table_files.require_rising(own, right_names, str(folder))  # the names of both views have times
        right_stamps = own
    else:
        right = matching(left, right)
    return [_file_view(left, stamps, options), _file_view(right, right_stamps, options)]


def _file_view(paths: Sequence[Path], stamps_ns: list[int], options: ImportOptions) -> View:
    losses: dict[int, str] = {}
    sizes_px: dict[str, tuple[int, int]] = {}  # the first one is that of all

    def read() -> Iterator[tuple[int, Picture]]:
        for place in range(0, len(paths), options.every):
            try:
                picture, found_px = read_file(paths[place], LIMITS, decode=options.takes_parts)
            except SourceError as problem:
                losses[place] = str(problem)
                continue
            sizes_px[paths[place].name] = found_px
            first, size_px = next(iter(sizes_px.items()))
            if found_px != size_px:
                raise SourceError("{}: {}x{} px; {} has {}x{} px".format(paths[place], *found_px, first, *size_px))
            yield place, picture

    if next(read(), None) is None:
        raise SourceError(losses[0])
    return View([path.name for path in paths], stamps_ns, next(iter(sizes_px.values())), read, losses)


def _video_views(options: ImportOptions, sources: Sequence[Path]) -> list[View]:
    if options.pattern is not None or options.right_pattern is not None:
        raise UsageError(f"{options.source}: --pattern is for folders of images")
    videos = [Video(path) for path in sources]
    for path, video in zip(sources, videos, strict=True):
        width_px, height_px = video.size_px
        if width_px * height_px > LIMITS.image_pixels:
            raise SourceError(f"{path}: {width_px}x{height_px} px, the limit is {LIMITS.image_pixels} px")
        if len(video.times_ns) != (count := len(videos[0].times_ns)):
            raise SourceError(f"{path}: {len(video.times_ns)} images; {sources[0]} has {count}")
    names = [f"image {place} of {sources[0].name}" for place in range(len(videos[0].times_ns))]
    stamps = _stamps(options, names, videos[0].times_ns)
    return [View(names, stamps, video.size_px, partial(video.images, options.every), video.losses) for video in videos]


def _stamps(options: ImportOptions, names: list[str], times_ns: Sequence[int] | None = None) -> list[int]:
    if options.rate_hz is not None:
        return [options.start_ns + round(number * 1e9 / options.rate_hz) for number in range(len(names))]
    if options.times is None and times_ns is not None:
        return [options.start_ns + time_ns for time_ns in times_ns]
    stamps = table_files.read_times(options.times, names) if options.times else table_files.stamps_from_names(names)
    if stamps is None:
        raise UsageError(f"the name {names[0]} has no time (in s or ns since 1970): give --rate HZ or --times FILE")
    if options.start_ns:
        raise UsageError(f"--start goes with --rate or a video; times are those of {options.times or 'the names'}")
    table_files.require_rising(stamps, names, str(options.times or options.source))
    return stamps
