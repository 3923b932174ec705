"""What belongs to an image: the right image nearest to it; and how many images have nothing near enough."""

from __future__ import annotations

import math
from bisect import insort
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from operator import attrgetter
from typing import NamedTuple

import numpy as np

from svmdist.recording.messages import EncodedImage
from svmdist.recording.source import Health, Loss, LossKind
from svmdist.tracks import MAX_GAP_NS

LOOK_AHEAD_NS = 3_000_000_000
"""How long, in log time, an image waits for the right image at its stamp."""
MAX_WAITING_BYTES = 64 << 20
STAMP = attrgetter("stamp_ns")
MAX_SWAPPED_IMAGES = 4
"""As many images wait for one that is stamped before them: two chunks of a log that changed places hold no more."""


Pair = tuple[EncodedImage, EncodedImage | None, float | None]


class Pairs:
    """Puts images in the order of their stamps, and to each the right image nearest to it within the tolerance.

    Images that come twice, or too far behind later ones, are losses. Without a right topic nothing waits for right
    images.
    """

    def __init__(self, right_topic: str | None, tolerance_s: float, health: Health) -> None:
        self._right_topic, self._health = right_topic, health
        self._tolerance_ns = round(tolerance_s * 1e9)
        self._left: list[EncodedImage] = []
        self._right: list[EncodedImage] = []
        self._newest_right_ns = -1
        self._gone_right_ns = -math.inf
        self._last_ns = -1

    def of(self, images: Iterable[EncodedImage]) -> Iterator[Pair]:
        """Yield each left image with its right one, or how far the nearest is, in s; images come in file order."""
        for image in images:
            if image.topic == self._right_topic:
                insort(self._right, image, key=STAMP)
                self._newest_right_ns = max(self._newest_right_ns, image.stamp_ns)
                while len(self._right) > 1 and _size(self._right) > MAX_WAITING_BYTES:
                    del self._right[0]
            elif image.stamp_ns <= self._last_ns or image.stamp_ns in map(STAMP, self._left):
                late = "repeats a stamp, or comes too far behind later ones; it is left out"
                detail = f"an image of {image.stamp_ns} ns {late}"
                self._health.add(Loss(LossKind.MESSAGE, detail, image.offset, image.topic))
            else:
                insort(self._left, image, key=STAMP)
            while self._left and self._is_ready():
                yield self._next()
        while self._left:
            yield self._next()

    def _is_ready(self) -> bool:
        newest_ns = max(image.log_time_ns for image in self._left)
        if newest_ns - self._left[0].log_time_ns > LOOK_AHEAD_NS or _size(self._left) > MAX_WAITING_BYTES:
            return True
        is_paired = self._right_topic is None or self._newest_right_ns >= self._left[0].stamp_ns
        return is_paired and len(self._left) > MAX_SWAPPED_IMAGES

    def _next(self) -> Pair:
        left = self._left.pop(0)
        self._last_ns = left.stamp_ns
        if self._right_topic is None:
            return left, None, None
        first_ns = left.stamp_ns - self._tolerance_ns
        while self._right and self._right[0].stamp_ns < first_ns:
            self._gone_right_ns = self._right.pop(0).stamp_ns
        nearest = min(self._right, key=lambda image: abs(image.stamp_ns - left.stamp_ns), default=None)
        if nearest is None or nearest.stamp_ns > left.stamp_ns + self._tolerance_ns:
            following_ns = math.inf if nearest is None else nearest.stamp_ns
            apart_ns = min(following_ns - left.stamp_ns, left.stamp_ns - self._gone_right_ns)
            return left, None, apart_ns * 1e-9
        self._right.remove(nearest)
        self._gone_right_ns = nearest.stamp_ns
        return left, nearest, None


def _size(images: list[EncodedImage]) -> int:
    return sum(image.size_bytes for image in images)


class Partners(NamedTuple):
    """What an image lacks near it: how far the nearest right image is, in s, where one was wanted; joint states."""

    right_apart_s: float | None = None
    lacks_joints: bool = False


NONE_MISSING = Partners()


@dataclass
class MissingPartners:
    """What the images of one replay lack near them; `right_apart_s` is `inf` for a log without right images."""

    pair_tolerance_s: float
    image_count: int = 0
    without_joints: int = 0
    right_apart_s: list[float] = field(default_factory=list)

    def add(self, partners: Partners) -> None:
        """Count an image."""
        self.image_count += 1
        self.without_joints += partners.lacks_joints
        self.right_apart_s += [] if partners.right_apart_s is None else [partners.right_apart_s]

    def describe(self) -> list[str]:
        """A line for right images, and one for joint states, where any are missing."""
        apart_s = float(np.median(self.right_apart_s or [math.inf]))
        nearest = f"nearest {apart_s * 1e3:.3g} ms" if apart_s < math.inf else "there is none"
        of_left = f"{self.pair_tolerance_s * 1e3:g} ms of the left ({nearest}): measured with one camera"
        of_image = f"{MAX_GAP_NS * 1e-6:g} ms of the image"
        missing = (
            ("right image", len(self.right_apart_s), of_left),
            ("joint states", self.without_joints, of_image),
        )
        said = []
        for what, count, near in missing:
            often = f"in {count} of {self.image_count} frames no {what}"
            said += (
                [f"{f'{what} never' if count == self.image_count else often} within {near}"] if count else []
            )
        return said
