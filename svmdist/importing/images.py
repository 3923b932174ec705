"""Pictures to import: image files of one view or two, in order and paired, and videos with their times."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from svmdist.errors import SourceError, optional_package
from svmdist.files import reading
from svmdist.samples import Image

SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm", ".pgm"})
DIGITS = re.compile(r"(\d+)")
SIDE = re.compile(r"(?<![A-Za-z])(?i:left|right|l|r)(?![A-Za-z])|(?<=[a-z0-9])(?:L|R|Left|Right)(?![a-z])")
"""The part of a file's name that says of which view it is."""


def list_images(folder: Path, pattern: str | None = None) -> list[Path]:
    """The images of a folder, by a pattern such as `*_L.jpg`, in natural order: `frame2` before `frame10`."""

    def natural(path: Path) -> list[int | str]:  # in which text and numbers alternate
        return [int(part) if part.isdecimal() else part for part in DIGITS.split(path.name)]

    with reading(folder, SourceError):
        every = sorted(folder.iterdir(), key=natural)
        folders = [path.name for path in every if path.is_dir()]
        # Beside each file macOS leaves another one, `._1.png`, that is no picture.
        files = [path for path in every if not (path.is_dir() or path.name.startswith("."))]
        images = [path for path in files if path.suffix.lower() in SUFFIXES]
    if not images:
        found = f"{len(every)} other files" if every else "nothing"
        if folders:
            found = f"the folders {', '.join(folders[:8])}: give one, or one for each view"
        raise SourceError(f"{folder}: no images ({', '.join(sorted(SUFFIXES))}); found {found}")
    try:
        chosen = [path for path in images if pattern is None or path.match(pattern)]
    except ValueError:
        raise SourceError(f"expected a pattern of names, as *_L.png, found {pattern!r}") from None
    if chosen:
        return chosen
    raise SourceError(f"{folder}: none of {len(images)} images is a {pattern}; the first is {images[0].name}")


def require_one_view(images: Sequence[Path]) -> None:
    """Raise SourceError where the names are of both views: they differ in numbers, and in a left and a right.

    The last of several numbers is the view's where it is 0 or 1 in all names, or 1 or 2, as in `0007_cam1.png`. Names
    that are the same up to their last digit are an image and its mask, or one in two formats, and refused, too.
    """
    last = [DIGITS.findall(path.stem)[1:][-1:] for path in images]
    is_side = len(images) > 2 and {tuple(map(int, one)) for one in last} in ({(0,), (1,)}, {(1,), (2,)})
    found: dict[str, tuple[list[str], Path]] = {}
    by_start: dict[str, Path] = {}
    for path, number in zip(images, last, strict=True):
        sides = [side[0].lower() for side in SIDE.findall(path.stem)] + number * is_side
        before, other = found.setdefault(DIGITS.sub("#", SIDE.sub("*", path.stem)), (sides, path))
        if before != sides:
            remedy = "choose those of one by --pattern, and those of the right one by --right-pattern"
            raise SourceError(f"{path.parent}: {other.name} and {path.name} are of two views: {remedy}")
        start = re.match(r".*\d", path.stem)
        if start and (twin := by_start.setdefault(start[0], path)) is not path:
            same = f"{twin.name} and {path.name} have the same number"
            raise SourceError(f"{path.parent}: {same}: choose images of one kind by --pattern")


def matching(left: Sequence[Path], right: Sequence[Path]) -> list[Path]:
    """The right view's files in the order of the left one's, by the last numbers that differ in their names."""
    lefts, rights = dict[int | str, Path](), dict[int | str, Path]()
    for found, view in ((lefts, left), (rights, right)):
        for number, path in zip(_numbers([path.name for path in view]), view, strict=True):
            if (other := found.setdefault(number, path)) is not path:
                both = f"{path.parent}: {other.name} and {path.name}"
                raise SourceError(f"{both} have one last number, by which views are paired")
    for found, others, side in ((lefts, rights, "right"), (rights, lefts, "left")):
        if lonely := [path for number, path in found.items() if number not in others]:
            like = next(iter(others.values())).name
            raise SourceError(f"{lonely[0]}: there is no {side} image of that number, as {like} has one")
    return [rights[number] for number in lefts]


def numbers_of(names: Sequence[str]) -> dict[int, int]:
    """The place of each image by its number; empty where two have the same, or one has none."""
    places = {number: at for at, number in enumerate(_numbers(names)) if isinstance(number, int)}
    return places if len(places) == len(names) else {}


def missing_numbers(names: Sequence[str]) -> str:
    """Between which names numbers are missing that stand nearer to each other elsewhere, in words; else ""."""
    steps = [later - number for number, later in pairwise(numbers_of(names))]
    if min(steps, default=0) <= 0 or len(set(steps)) == 1:
        return ""
    at = steps.index(max(steps))
    return f"numbers are missing, as between {names[at]} and {names[at + 1]}"


def _numbers(names: Sequence[str]) -> list[int | str]:
    """The last number of each file's name that is not the same in all of them, else its name."""
    stems = [Path(name).stem for name in names]
    found = [DIGITS.findall(stem) for stem in stems]
    while len(found) > 1 and all(found) and len({numbers[-1] for numbers in found}) == 1:
        found = [numbers[:-1] for numbers in found]
    return [int(numbers[-1]) if numbers else stem for numbers, stem in zip(found, stems, strict=True)]


class Video:
    """The first video stream of a file: its size, and the time in ns of every image after the first one.

    When `images` has given all that can be read, `losses` has what cannot, by the place of the first one.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._av = optional_package("av", "video", f"{path}: a video", SourceError)
        with self._stream() as (container, stream):
            found = [packet.pts for packet in container.demux(stream) if packet.size]
            self.size_px: tuple[int, int] = (stream.width, stream.height)
            base, rate_hz, stated = stream.time_base, stream.average_rate or 0, stream.frames
        times = {pts for pts in found if pts is not None}
        if not times:
            raise SourceError(f"{path}: a video whose images have no times")
        self.losses: dict[int, str] = {}
        self._times = sorted(times)
        is_cut = round((self._times[-1] - self._times[0]) * base * rate_hz) + 1 < stated
        self._cut_count = max(0, stated - len(found)) if is_cut else 0  # else the recorder had dropped them
        self.times_ns = [round((pts - self._times[0]) * base * 10**9) for pts in self._times]

    def images(self, every: int = 1) -> Iterator[tuple[int, Image]]:
        """Give each n-th image, BGR, shape (height, width, 3), with its place among `times_ns`.

        What is damaged is left out up to the next key frame. Raises SourceError where nothing is left.
        """
        places = {pts: place for place, pts in enumerate(self._times)}
        lost = set(places.values())
        is_damaged, needs_key_frame = self._cut_count > 0, False
        with self._stream() as (container, stream):
            for packet in container.demux(stream):
                needs_key_frame = packet.is_corrupt or (needs_key_frame and not packet.is_keyframe)
                try:
                    frames = [] if needs_key_frame and packet.size else packet.decode()
                except self._av.error.FFmpegError:
                    frames, needs_key_frame = [], True
                    stream.codec_context.flush_buffers()
                is_damaged |= needs_key_frame
                for frame in frames:
                    place = places.get(frame.pts)
                    lost.discard(place)
                    if place is not None and place % every == 0:
                        yield place, np.asarray(frame.to_ndarray(format="bgr24"), np.uint8)
        if is_damaged and (count := len(lost) + self._cut_count):
            first, total = min(lost, default=len(places)), len(places) + self._cut_count
            said = f"{self._path}: damaged or cut at image {first + 1} of {total}; {count} left out"
            if len(lost) == len(places):
                raise SourceError(said)
            self.losses[first] = said

    @contextmanager
    def _stream(self) -> Iterator[tuple[Any, Any]]:
        try:
            with self._av.open(f"file:{self._path}") as container:  # whatever protocol its name looks like
                stream = next(iter(container.streams.video), None)
                if stream is None:
                    raise SourceError(f"{self._path}: has no video")
                yield container, stream
        except self._av.error.FFmpegError as problem:
            reason = "neither an image nor a video that can be read"
            detail = " ".join(str(problem.strerror or problem).split())
            raise SourceError(f"{self._path}: {reason}: {detail}") from None
