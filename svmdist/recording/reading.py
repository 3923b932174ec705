"""How a recording is read: under which name, and which of its images."""

from __future__ import annotations

import math
import os
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol, TypeVar

import numpy as np
from numpy.typing import NDArray

from svmdist.input_file import LogPath
from svmdist.remote_file import RemoteFile


class HasStamp(Protocol):
    """An image, in whatever form."""

    @property
    def stamp_ns(self) -> int:
        """Its stamp."""


Stamped = TypeVar("Stamped", bound=HasStamp)
OUT_OF_ORDER_S = 1.0
"""Images may stand so much out of order in a file: reading goes on this long after the end of a window."""


@dataclass(frozen=True, slots=True)
class Window:
    """Images from `start_s` to `end_s` after the first one, both included, and of these every `every`-th one."""

    start_s: float = 0.0
    end_s: float = math.inf
    every: int = 1

    def of(self, images: Iterable[Stamped]) -> Iterator[Stamped]:
        """The images inside."""
        first_ns: int | None = None
        count = 0
        for image in images:
            first_ns = image.stamp_ns if first_ns is None else first_ns
            # In whole nanoseconds: an image at exactly 0.1 s is inside of a window that begins at 0.1 s.
            at_ns = image.stamp_ns - first_ns
            if at_ns > (self.end_s + OUT_OF_ORDER_S) * 1e9:
                return
            if not round(self.start_s * 1e9) <= at_ns <= self.end_s * 1e9 + 0.5:
                continue
            if count % self.every == 0:
                yield image
            count += 1

    def count_of(self, image_count: int) -> int | None:
        """How many of so many images are inside; None where that depends on their stamps."""
        if self.start_s > 0.0 or self.end_s < math.inf:
            return None
        return -(-image_count // self.every)

    def places(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.intp]:
        """Which of rising stamps, shape (n,), are inside, counted from the first one."""
        if len(stamps_ns) == 0:
            return np.zeros(0, np.intp)
        at_ns = stamps_ns - stamps_ns[0]
        inside = (at_ns >= round(self.start_s * 1e9)) & (at_ns <= self.end_s * 1e9 + 0.5)
        return np.flatnonzero(inside)[:: self.every]


@dataclass(frozen=True, slots=True)
class Reading:
    """The name that a recording goes by, None for its file's, and its window, None for all images."""

    name: str | None = None
    window: Window | None = None


def unique_names(paths: Sequence[LogPath]) -> list[str]:
    """A name for each recording: the file's without its ending, with as many folders before it as tell it from others.

    >>> unique_names([Path("logs/a/contact.mcap"), Path("logs/b/contact.mcap"), Path("sweep.mcap")])
    ['a/contact', 'b/contact', 'sweep']
    """
    parts = [(*_folders(path), path.stem) for path in paths]
    depths = dict.fromkeys(parts, 1)
    while True:
        sharing: dict[str, list[tuple[str, ...]]] = {}
        for part, depth in depths.items():
            sharing.setdefault("/".join(part[-depth:]), []).append(part)
        clashing = [part for of in sharing.values() if len(of) > 1 for part in of if depths[part] < len(part)]
        if not clashing:
            return ["/".join(part[-depths[part] :]) for part in parts]
        for part in clashing:
            depths[part] += 1


def _folders(path: LogPath) -> tuple[str, ...]:
    if isinstance(path, RemoteFile):
        return path.folders
    return Path(os.path.abspath(path)).parent.parts[1:]
