"""When each row of a frame is exposed: all at once, in two fields, or one after another."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from svmdist.samples import Image
from svmdist.simulation.room.settings import Room

FIELD_NS = 1e9 / 60.0
"""Between both fields of an interlaced frame (59.94 fields a second, ITU-R BT.601)."""
STEP_PX = 0.4
"""Rows that are drawn together show things that move by so much at most between the first and the last of them."""
MAX_BANDS = 48


@dataclass(frozen=True)
class Exposure:
    """Rows of a frame, each `step`-th from `first` to before `end`, and how long after the frame's stamp they are."""

    after_ns: float
    first: int
    end: int
    step: int = 1

    @property
    def rows(self) -> slice:
        """The rows as an index."""
        return slice(self.first, self.end, self.step)


def exposures(room: Room, row_count: int, motion_px: float) -> tuple[Exposure, ...]:
    """The exposures of a frame in which things move by `motion_px` at most while its rows are exposed.

    With a rolling shutter the middle row has the frame's stamp; it is drawn in bands of rows, each at the instant of
    its own middle. The first field of an interlaced frame has the frame's stamp, and the second one comes later.
    """
    fields = 2 if room.interlace else 1
    count = band_count(motion_px) if room.rolling else 1
    edges = [round(row_count * band / count) for band in range(count + 1)]
    found = []
    for field in range(fields):
        for first, end in pairwise(edges):
            middle = 0.5 * (first + end) / row_count - 0.5
            after_ns = field * room.interlace * FIELD_NS + middle * 1e6 * room.rolling
            # Bands begin at any row; the fields are the even and the odd ones.
            begin = first + (first + field) % fields
            found.append(Exposure(after_ns, begin, end, fields))
    return tuple(found)


def band_count(motion_px: float) -> int:
    """In how many bands a frame with a rolling shutter is drawn."""
    return int(np.clip(np.ceil(motion_px / STEP_PX), 1, MAX_BANDS))


def exposures_at_most(room: Room) -> int:
    """No frame has more exposures than this: their pictures are numbered by it."""
    return (2 if room.interlace else 1) * (MAX_BANDS if room.rolling else 1)


def woven(images: Sequence[Image], parts: Sequence[Exposure]) -> Image:
    """The frame of one image for each exposure, all of the whole frame."""
    if len(parts) == 1:
        return images[0]
    frame = images[0].copy()
    for image, part in zip(images[1:], parts[1:], strict=True):
        frame[part.rows] = image[part.rows]
    return frame
