"""What every encoding shares: the error of a message that cannot become a sample, and the checks of its values."""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from svmdist.camera import KNOWN_DISTORTION, MAX_COEFFICIENTS, Camera
from svmdist.perturbations.joints import later_ns
from svmdist.recording.images import ImageError
from svmdist.recording.source import MAX_NAME_BYTES, cut
from svmdist.samples import Image, JointSample, TransformSample, TransformsSample, Vector
from svmdist.transforms import Array, make_transform, rotation_from_quaternion_xyzw

MAX_STAMP_NS = (1 << 63) - 1
NS = 1_000_000_000
MAX_MAGNITUDE = 1e12
"""In m, rad or px, far beyond anything real; squares and differences of such numbers are still finite."""
MAX_JOINTS = 256
"""Of one message: two arms on their set-up joints, and their instruments, have fifty."""
MAX_TRANSFORMS = 1000
"""Of one message: several robots with all their links have a hundred."""
Quaternion = tuple[float, float, float, float]


class DecodeError(ValueError):
    """A message that does not hold what its schema promises."""


@dataclass(frozen=True, slots=True)
class EncodedImage:
    """An image message whose pixels are decoded only when asked for; `decode` raises ImageError.

    `is_ordered` says that it is a frame of a video, which refers to those before it: these are decoded in file
    order, by one thread. Any other image may be decoded by any thread.
    """

    stamp_ns: int
    frame_id: str
    decode: Callable[[], Image]
    is_ordered: bool = False


def broken_image(log_time_ns: int, reason: str) -> EncodedImage:
    """Make an image whose decoding fails, for a message that is broken before its pixels."""

    def fail() -> Image:
        raise ImageError(reason)

    return EncodedImage(min(log_time_ns, MAX_STAMP_NS), "", fail)


def checked_stamp_ns(stamp_ns: int) -> int:
    """Return a stamp that fits into 64 bits with sign and is not negative; DecodeError for any other."""
    if not 0 <= stamp_ns <= MAX_STAMP_NS:
        raise DecodeError(f"the stamp {stamp_ns} ns is out of range")
    return stamp_ns


def check_numbers(values: Sequence[float], what: str) -> None:
    """Refuse numbers that are not finite or absurdly large with DecodeError."""
    if (
        sum(map(abs, values)) <= MAX_MAGNITUDE
    ):  # false for NaN and infinity too; ten times as fast as an array
        return
    numbers = np.asarray(values, np.float64)
    bad = ~(np.abs(numbers) <= MAX_MAGNITUDE)  # true for NaN too
    if bad.any():
        raise DecodeError(f"{what}: {numbers[bad][0]} is no usable number")


def check_names(names: Sequence[str], what: str) -> None:
    """Refuse endless names with DecodeError: they would be kept."""
    if max(map(len, names), default=0) > MAX_NAME_BYTES:
        raise DecodeError(f"a {what}'s name of more than {MAX_NAME_BYTES} characters")


@dataclass(frozen=True, slots=True)
class RawTransform:
    """One transform as a message states it, checked: the matrix is computed only where it is needed.

    A log brings hundreds of transforms for each image, and an image needs the few on one path around its stamp.
    """

    stamp_ns: int
    parent: str
    child: str
    translation_m: Vector
    quaternion_xyzw: Quaternion

    @property
    def T_parent_child(self) -> Array:
        """The matrix, shape (4, 4)."""
        return make_transform(rotation_from_quaternion_xyzw(self.quaternion_xyzw), self.translation_m)

    def to_sample(self) -> TransformSample:
        """The same with its matrix."""
        return TransformSample(self.stamp_ns, self.parent, self.child, self.T_parent_child)


@dataclass(frozen=True, slots=True)
class RawTransforms:
    """The transforms of one message."""

    stamp_ns: int
    transforms: tuple[RawTransform, ...]

    def stamped_later(self, lag_ns: int) -> RawTransforms:
        """The same with stamps that are later by so much."""
        later = tuple(replace(each, stamp_ns=later_ns(each.stamp_ns, lag_ns)) for each in self.transforms)
        return RawTransforms(later_ns(self.stamp_ns, lag_ns), later)

    def to_sample(self) -> TransformsSample:
        """The same with their matrices."""
        return TransformsSample(self.stamp_ns, tuple(each.to_sample() for each in self.transforms))


def checked_transform(
    stamp_ns: int, parent: str, child: str, translation_m: Vector, quaternion_xyzw: Quaternion
) -> RawTransform:
    """Take over a transform; DecodeError for values that are not finite or name no rotation."""
    check_numbers(translation_m, "a translation")
    check_numbers(quaternion_xyzw, "a quaternion")
    if max(map(abs, quaternion_xyzw)) < 1e-8:  # far longer ones than those that are refused are asked in full
        try:
            rotation_from_quaternion_xyzw(quaternion_xyzw)
        except ValueError as problem:
            raise DecodeError(str(problem)) from None
    check_names((parent, child), "frame")
    return RawTransform(stamp_ns, parent, child, translation_m, quaternion_xyzw)


def checked_joints(stamp_ns: int, names: Sequence[str], positions: Sequence[float]) -> JointSample:
    """Build a joint sample; DecodeError for names that repeat and positions that are missing or not finite."""
    if len(names) != len(positions) or not names:
        raise DecodeError(f"{len(names)} joint names and {len(positions)} positions")
    if len(set(names)) != len(names):
        raise DecodeError("joint names repeat")
    check_names(names, "joint")
    check_numbers(positions, "joint positions")
    # Every message brings the same names: one string each serves all the samples that are kept.
    return JointSample(stamp_ns, tuple(map(sys.intern, names)), np.array(positions, np.float64))


def checked_camera(
    size_px: tuple[int, int],
    K: Sequence[float],
    D: Sequence[float],
    R: Sequence[float],
    P: Sequence[float],
    frame_id: str,
    distortion_model: str,
) -> Camera:
    """Build a camera; DecodeError for a matrix of another size, an uncalibrated camera or an unknown distortion."""
    check_names((frame_id,), "frame")
    if len(K) != 9 or len(R) not in {0, 9} or len(P) not in {0, 12} or len(D) > MAX_COEFFICIENTS:
        raise DecodeError(f"K, R, P, D have {len(K)}, {len(R)}, {len(P)}, {len(D)} elements")
    check_numbers([*K, *D, *R, *P], "a calibration")
    distortion_model = cut(distortion_model)
    if any(D) and distortion_model.lower() not in KNOWN_DISTORTION:
        choices = ", ".join(sorted(filter(None, KNOWN_DISTORTION)))
        raise DecodeError(f"distortion model {distortion_model!r} is not known; the choices are {choices}")
    try:
        return Camera(
            size_px[0],
            size_px[1],
            np.array(K, np.float64).reshape(3, 3),
            np.array(D, np.float64),
            np.array(R, np.float64).reshape(3, 3) if any(R) else None,
            np.array(P, np.float64).reshape(3, 4) if any(P) else None,
            frame_id,
            KNOWN_DISTORTION.get(distortion_model.lower(), "plumb_bob") if any(D) else "plumb_bob",
        )
    except ValueError as problem:
        raise DecodeError(str(problem)) from None
