"""Observations whose images are still encoded: read in one thread, decoded in any."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.recording.cameras import Cameras, RightCamera
from svmdist.recording.images import ImageError
from svmdist.recording.messages import EncodedImage
from svmdist.recording.partners import NONE_MISSING, Partners
from svmdist.recording.source import Loss, LossKind
from svmdist.samples import ImageSample, JointSample, Observation, Rejection, RightView, Status
from svmdist.tracks import JointTrack
from svmdist.transforms import Array

JOINT_TRACK_NS = 200_000_000
"""Joints so long before and after an image go with it: by as much the clocks may differ for a method that finds it."""
OUT_OF_ORDER_S = 1.0
"""Images may stand so much out of order in a file: reading goes on this long after the end of a window."""


@dataclass(frozen=True, slots=True)
class Window:
    """Images from `start_s` to `end_s` after the first one, both included, and of these every `every`-th one."""

    start_s: float = 0.0
    end_s: float = math.inf
    every: int = 1

    @property
    def is_bounded(self) -> bool:
        """Whether stamps decide which images are inside."""
        return self.start_s > 0.0 or self.end_s < math.inf

    def holds(self, at_ns: Any) -> Any:
        """Whether times since the first image, one or an array, lie between start and end."""
        # In whole nanoseconds: an image at exactly 0.1 s is inside of a window that begins at 0.1 s.
        return (at_ns >= round(self.start_s * 1e9)) & (at_ns <= self.end_s * 1e9 + 0.5)

    def of(self, images: Iterable[EncodedObservation]) -> Iterator[EncodedObservation]:
        """The images inside, each with its number among all and its time since the first one."""
        first_ns: int | None = None
        count = 0
        for number, image in enumerate(images):
            first_ns = image.stamp_ns if first_ns is None else first_ns
            at_ns = image.stamp_ns - first_ns
            if at_ns > (self.end_s + OUT_OF_ORDER_S) * 1e9:
                return
            if self.holds(at_ns):
                if count % self.every == 0:
                    yield replace(image, number=number, at_ns=at_ns)
                count += 1

    def places(self, stamps_ns: NDArray[np.int64]) -> NDArray[np.intp]:
        """Which of rising stamps, shape (n,), are inside, counted from the first one."""
        return np.flatnonzero(self.holds(stamps_ns - stamps_ns[:1]))[:: self.every]


ALL_IMAGES = Window()


@dataclass(frozen=True, slots=True)
class Needs:
    """What a method uses of a log beside the left images; what it does not use is neither read nor given."""

    joints: bool = True
    transforms: bool = True
    right: bool = True
    rest: bool = True
    """Whether the pass over the images shall read everything else, too, for those who ask for it later."""


EVERYTHING = Needs()
LEFT_IMAGES = Needs(joints=False, transforms=False, right=False)


def decode_image(
    image: EncodedImage, losses: list[Loss], camera: Camera | None = None
) -> ImageSample | Rejection:
    """An image; where it cannot be decoded, or has not the camera's size, it is a rejection and joins the losses."""
    try:
        pixels = image.decode()
        height_px, width_px = pixels.shape[:2]
        if camera is not None and (width_px, height_px) != (camera.width_px, camera.height_px):
            size = f"{camera.width_px}x{camera.height_px}"
            raise ImageError(f"{width_px}x{height_px} px; the camera has {size}")
    except ImageError as problem:
        losses.append(Loss(LossKind.IMAGE, str(problem), image.offset, image.topic))
        return Rejection(image.stamp_ns, Status.CORRUPT_IMAGE, str(problem))
    return ImageSample(image.stamp_ns, image.frame_id, pixels)


class ArmState(NamedTuple):
    """What one arm reported at an image's stamp: joints, those around it, and `T_camera_base`, shape (4, 4)."""

    joints: JointSample | None = None
    joint_track: JointTrack | None = None
    T_camera_base: Array | None = None


@dataclass(frozen=True, slots=True)
class Decoded:
    """An observation of each instrument, or why there is none; `place` orders the losses among all others."""

    found: tuple[Observation, ...] | Rejection
    losses: tuple[Loss, ...] = ()
    place: int = 0
    partners: Partners = NONE_MISSING


@dataclass(frozen=True, slots=True)
class EncodedObservation:
    """One image with what belongs to it, as it stands in the log; make it with `Recording.encoded_observations`.

    `decode` gives the same whatever the thread and whatever the order, and changes nothing: a caller decodes each
    observation once, and hands the results to `Recording.record_losses`.
    """

    left: EncodedImage
    right: EncodedImage | None
    arms: tuple[ArmState, ...]
    cameras: Cameras
    place: int
    partners: Partners = NONE_MISSING
    number: int = 0
    """Among the log's images."""
    at_ns: int = 0
    """Since the log's first image."""

    @property
    def stamp_ns(self) -> int:
        """The image's stamp."""
        return self.left.stamp_ns

    def decode(self) -> Decoded:
        """Decode the images; a Rejection stands for a left image that cannot be, or whose camera is not known."""
        losses: list[Loss] = []
        camera, right, doubt = self.cameras
        if doubt:
            return Decoded(
                Rejection(self.stamp_ns, Status.INCONSISTENT, doubt), (), self.place, self.partners
            )
        image = decode_image(self.left, losses, camera)
        if isinstance(image, Rejection):
            return Decoded(image, tuple(losses), self.place, self.partners)
        view = self._right_view(right, losses)
        seen = Observation(image.stamp_ns, image.image_bgr, camera, right=view)
        found = tuple(replace(seen, **arm._asdict()) for arm in self.arms)
        return Decoded(found, tuple(losses), self.place, self.partners)

    def _right_view(self, right: RightCamera | None, losses: list[Loss]) -> RightView | None:
        if self.right is None or right is None:
            return None
        camera, T_left_right = right
        image = decode_image(self.right, losses, camera)
        if isinstance(image, Rejection):
            return None
        return RightView(image.image_bgr, camera, T_left_right, (image.stamp_ns - self.stamp_ns) * 1e-9)


def joints_at(track: JointTrack | None, stamp_ns: int) -> tuple[JointSample | None, JointTrack | None]:
    """Joints interpolated to a stamp, and those around it; None where there are none within 0.1 s."""
    sampled = None if track is None else track.at(np.array([stamp_ns], np.int64))
    if track is None or sampled is None or not sampled.valid[0]:
        return None, None
    first, last = np.searchsorted(track.stamps_ns, [stamp_ns - JOINT_TRACK_NS, stamp_ns + JOINT_TRACK_NS + 1])
    around = JointTrack(track.stamps_ns[first:last], track.names, track.positions[first:last])
    return JointSample(stamp_ns, track.names, sampled.values[0]), around
