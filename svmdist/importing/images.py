"""Image files of one view or two: which they are, in which order, and which belong together."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from svmdist.errors import SourceError, optional_package
from svmdist.samples import Image

SUFFIXES = frozenset({".png", ".jpg", ".jpeg", ".bmp", ".tif", ".tiff", ".webp", ".ppm", ".pgm"})
DIGITS = re.compile(r"(\d+)")


@dataclass(frozen=True)
class ImageFiles:
    """Files of the left view, or of both views side by side, and of the right view if that has its own."""

    left: tuple[Path, ...]
    right: tuple[Path, ...] | None = None

    @property
    def names(self) -> list[str]:
        """The names of the left files."""
        return [path.name for path in self.left]


def natural_key(path: Path) -> tuple[tuple[int, int, str], ...]:
    """Orders `frame2` before `frame10`."""
    parts = DIGITS.split(path.name)
    return tuple((0, int(part), "") if part.isdecimal() else (1, 0, part) for part in parts)


def list_images(folder: Path, pattern: str | None = None) -> tuple[Path, ...]:
    """The images of a folder, by a pattern such as `*_L.jpg`, in natural order; SourceError where there is none."""
    try:
        every = sorted((path for path in folder.iterdir() if path.is_file()), key=natural_key)
    except OSError as problem:
        raise SourceError(f"{folder}: cannot read: {problem.strerror or problem}") from None
    images = [path for path in every if path.suffix.lower() in SUFFIXES]
    if pattern is not None:
        chosen = [path for path in images if path.match(pattern)]
        if images and not chosen:
            raise SourceError(
                f"{folder}: none of {len(images)} images is a {pattern}; the first is {images[0].name}"
            )
        images = chosen
    if not images:
        found = f"{len(every)} other files" if every else "nothing"
        raise SourceError(f"{folder}: no images ({', '.join(sorted(SUFFIXES))}); found {found}")
    return tuple(images)


def pair(left: Sequence[Path], right: Sequence[Path], *, by_stamps: bool) -> ImageFiles:
    """Both views' files, those that belong together at the same place; SourceError names the first without another.

    Views belong together by the numbers in their names; with `by_stamps` each file keeps a stamp of its own.
    """
    if by_stamps:
        return ImageFiles(tuple(left), tuple(right))
    keys = {_number(path): path for path in right}
    if len(keys) < len(right):
        raise SourceError(f"{right[0].parent}: right images whose names have the same last number")
    matched = []
    for path in left:
        other = keys.get(_number(path))
        if other is None:
            raise SourceError(
                f"{path.name}: there is no right image of that number, as {right[0].name} has one"
            )
        matched.append(other)
    if len(right) > len(left):
        lonely = sorted(set(right) - set(matched), key=natural_key)[0]
        raise SourceError(f"{lonely.name}: there is no left image of that number, as {left[0].name} has one")
    return ImageFiles(tuple(left), tuple(matched))


def _number(path: Path) -> int | str:
    """The last number of a file's name, else its name."""
    numbers = DIGITS.findall(path.stem)
    return int(numbers[-1]) if numbers else path.stem


def numbers_of(names: Sequence[str]) -> dict[int, int]:
    """The place of each image by the last number of its name; empty where two have the same, or one has none."""
    places: dict[int, int] = {}
    for place, name in enumerate(names):
        number = _number(Path(name))
        if not isinstance(number, int) or number in places:
            return {}
        places[number] = place
    return places


class Video:
    """The first video stream of a file; SourceError in one line where there is none that can be read."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._av = optional_package("av", "video", f"{path}: a video", SourceError)
        with self._stream() as (container, stream):
            times = [packet.pts for packet in container.demux(stream) if packet.pts is not None]
            self.size_px: tuple[int, int] = (stream.width, stream.height)
            self._base: Fraction = stream.time_base
        if not times:
            raise SourceError(f"{path}: a video whose images have no times")
        self._times: list[int] = sorted(set(times))

    @property
    def times_ns(self) -> list[int]:
        """The time of every image after the first one."""
        return [self._time_ns(pts) for pts in self._times]

    def images(self) -> Iterator[tuple[int, Image]]:
        """Decode every image, BGR, shape (height, width, 3), with its place among `times_ns`."""
        places = {pts: place for place, pts in enumerate(self._times)}
        with self._stream() as (container, stream):
            stream.thread_type = "AUTO"
            for frame in container.decode(stream):
                if frame.pts in places:
                    yield places[frame.pts], np.asarray(frame.to_ndarray(format="bgr24"), np.uint8)

    def _time_ns(self, pts: int) -> int:
        return round((pts - self._times[0]) * self._base * 10**9)

    @contextmanager
    def _stream(self) -> Iterator[tuple[Any, Any]]:
        try:
            with self._av.open(
                f"file:{self.path}"
            ) as container:  # a file, whatever protocol its name looks like
                stream = next(iter(container.streams.video), None)
                if stream is None:
                    raise SourceError(f"{self.path}: has no video")
                yield container, stream
        except self._av.error.FFmpegError as problem:
            reason = " ".join(str(problem.strerror or problem).split())
            raise SourceError(
                f"{self.path}: neither an image nor a video that can be read: {reason}"
            ) from None
