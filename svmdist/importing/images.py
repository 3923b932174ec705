"""Pictures to import: image files of one view or two, in order and paired, and videos with their times."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
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
    """The images of a folder, by a pattern such as `*_L.jpg`, in natural order."""
    with reading(folder, SourceError):
        every = sorted(folder.iterdir(), key=_natural_key)
        images = [path for path in every if path.suffix.lower() in SUFFIXES and path.is_file()]
        folders = [path.name for path in every if path.is_dir()]
    if not images:
        found = f"{len(every)} other files" if every else "nothing"
        if folders:
            found = f"the folders {', '.join(folders[:8])}: give one, or one for each view"
        raise SourceError(f"{folder}: no images ({', '.join(sorted(SUFFIXES))}); found {found}")
    if chosen := [path for path in images if pattern is None or path.match(pattern)]:
        return chosen
    raise SourceError(f"{folder}: none of {len(images)} images is a {pattern}; the first is {images[0].name}")


def require_one_view(images: Sequence[Path]) -> None:
    """Raise SourceError where the names are of both views: they differ in numbers, and in a left and a right."""
    found: dict[str, tuple[list[str], Path]] = {}
    for path in images:
        sides = [side[0].lower() for side in SIDE.findall(path.stem)]
        before, other = found.setdefault(DIGITS.sub("#", SIDE.sub("*", path.stem)), (sides, path))
        if before != sides:
            raise SourceError(
                f"{path.parent}: {other.name} and {path.name} are of two views: choose those of one by --pattern,"
                " and those of the right one by --right-pattern"
            )


def matching(left: Sequence[Path], right: Sequence[Path]) -> list[Path]:
    """The right view's files in the order of the left one's, by the last numbers in their names."""
    keys = {_number(path): path for path in right}
    if len(keys) < len(right):
        raise SourceError(f"{right[0].parent}: right images whose names have the same last number")
    for path in left:
        if _number(path) not in keys:
            raise SourceError(
                f"{path.name}: there is no right image of that number, as {right[0].name} has one"
            )
    matched = [keys[_number(path)] for path in left]
    if len(right) > len(left):
        lonely = min(set(right) - set(matched), key=_natural_key)
        raise SourceError(f"{lonely.name}: there is no left image of that number, as {left[0].name} has one")
    return matched


def numbers_of(names: Sequence[str]) -> dict[int, int]:
    """The place of each image by the last number of its name; empty where two have the same, or one has none."""
    places = {_number(Path(name)): place for place, name in enumerate(names)}
    numbered = {number: place for number, place in places.items() if isinstance(number, int)}
    return numbered if len(numbered) == len(names) else {}


def _number(path: Path) -> int | str:
    """The last number of a file's name, else its name."""
    numbers = DIGITS.findall(path.stem)
    return int(numbers[-1]) if numbers else path.stem


def _natural_key(path: Path) -> tuple[tuple[int, int, str], ...]:
    """Orders `frame2` before `frame10`."""
    parts = DIGITS.split(path.name)
    return tuple((0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts)


class Video:
    """The first video stream of a file: its size, and the time in ns of every image after the first one."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._av = optional_package("av", "video", f"{path}: a video", SourceError)
        with self._stream() as (container, stream):
            times = {packet.pts for packet in container.demux(stream) if packet.pts is not None}
            self.size_px: tuple[int, int] = (stream.width, stream.height)
            base = stream.time_base
        if not times:
            raise SourceError(f"{path}: a video whose images have no times")
        self._times = sorted(times)
        self.times_ns = [round((pts - self._times[0]) * base * 10**9) for pts in self._times]

    def images(self, every: int = 1) -> Iterator[tuple[int, Image]]:
        """Give each n-th image, BGR, shape (height, width, 3), with its place among `times_ns`."""
        places = {pts: place for place, pts in enumerate(self._times)}
        with self._stream() as (container, stream):
            stream.thread_type = "AUTO"
            for frame in container.decode(stream):
                place = places.get(frame.pts)
                if place is not None and place % every == 0:
                    yield place, np.asarray(frame.to_ndarray(format="bgr24"), np.uint8)

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
