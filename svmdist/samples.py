"""What is read from a recording: samples, and observations made of them, which have no field for ground truth."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.errors import SvmdistError, UsageError, did_you_mean
from svmdist.tracks import JointTrack
from svmdist.transforms import Array

Image = NDArray[np.uint8]
"""A BGR image, shape (height, width, 3), or a mask, shape (height, width)."""
Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class ImageSample:
    """One decoded camera image: BGR, uint8, shape (height, width, 3)."""

    stamp_ns: int
    frame_id: str
    image_bgr: Image


@dataclass(frozen=True, slots=True)
class JointSample:
    """Joint positions at one instant, in rad or m by joint, shape (n,), in the order of `names`."""

    stamp_ns: int
    names: tuple[str, ...]
    positions: Array


@dataclass(frozen=True, slots=True)
class TransformSample:
    """`T_parent_child`, shape (4, 4), at one instant."""

    stamp_ns: int
    parent: str
    child: str
    T_parent_child: Array


@dataclass(frozen=True, slots=True)
class TransformsSample:
    """Transforms of one message of a tf topic."""

    stamp_ns: int
    transforms: tuple[TransformSample, ...]


@dataclass(frozen=True, slots=True)
class PoseSample:
    """The pose of something in a frame, `T_frame_pose`, shape (4, 4), at one instant."""

    stamp_ns: int
    frame_id: str
    T_frame_pose: Array


@dataclass(frozen=True, slots=True)
class CameraSample:
    """The calibration of a camera, as published at one instant."""

    stamp_ns: int
    camera: Camera


@dataclass(frozen=True, slots=True)
class DistanceSample:
    """The three true distances at one instant, in m; a negative clearance is penetration depth."""

    stamp_ns: int
    planar_m: float
    spatial_m: float
    clearance_m: float


Sample = ImageSample | JointSample | TransformsSample | PoseSample | CameraSample | DistanceSample
"""Everything a recording can carry, whatever its encoding."""


@dataclass(frozen=True, slots=True)
class RightView:
    """The right image of a stereo pair, its camera, and the camera's pose `T_left_right`, shape (4, 4)."""

    image_bgr: Image
    camera: Camera
    T_left_right: Array
    delay_s: float = 0.0  # by which its stamp is later than the left image's


@dataclass(frozen=True, slots=True)
class Observation:
    """What an estimator may see of one instant; None stands for what the log does not have near the image."""

    stamp_ns: int
    image_bgr: Image
    camera: Camera
    joints: JointSample | None = None  # interpolated to the image's stamp
    right: RightView | None = None
    T_camera_base: Array | None = None  # shape (4, 4), as the robot reports it
    joint_track: JointTrack | None = None  # joints around the image's stamp, for clocks that differ


class Status(StrEnum):
    """How a frame ended: `ok`, or why it could not be measured."""

    OK = "ok"
    CORRUPT_IMAGE = "corrupt_image"
    NO_TISSUE = "no_tissue"
    NO_INSTRUMENT = "no_instrument"
    NO_JOINTS = "no_joints"
    NO_FEATURES = "no_features"
    TOO_FEW_MATCHES = "too_few_matches"
    NO_HOMOGRAPHY = "no_homography"
    NO_OUTLINE = "no_outline"
    NOT_FINITE = "not_finite"
    NO_FIDUCIAL = "no_fiducial"
    NO_STEREO = "no_stereo"
    AMBIGUOUS_POSE = "ambiguous_pose"
    INCONSISTENT = "inconsistent"
    UNCERTAIN = "uncertain"
    NO_ESTIMATE = "no_estimate"


@dataclass(frozen=True, slots=True)
class Rejection:
    """A frame that could not be measured, with the reason and a readable detail."""

    stamp_ns: int
    status: Status
    detail: str = ""


BGR, RGB = [0, 1, 2], [2, 1, 0]
# Encodings by the names of ROS and Foxglove: how many channels, and those that are blue, green and red.
ORDERS = {"bgr8": (3, BGR), "rgb8": (3, RGB), "bgra8": (4, BGR), "rgba8": (4, RGB), "mono8": (1, [0, 0, 0])}


class WrongImageError(SvmdistError, ValueError):
    """An image of another type, layout, range or size than expected."""


def bgr_image(image: object, encoding: str, camera: Camera | None = None) -> NDArray[np.uint8]:
    """An image as svmdist's methods take it: BGR, uint8, shape (height, width, 3), in an array of its own.

    `encoding` says what `image`, shape (height, width, channels) or (height, width), holds: `bgr8`, as OpenCV reads
    files; `rgb8`, as Pillow, imageio and matplotlib do; `bgra8`, `rgba8` or `mono8`. With a camera, the image must have
    its size. Raises UsageError for an unknown encoding, WrongImageError for an array of another kind.
    """
    if encoding not in ORDERS:
        raise UsageError(f"no encoding {encoding}: {did_you_mean(encoding, ORDERS)}")
    channels, order = ORDERS[encoding]
    if channels == 1 and isinstance(image, np.ndarray) and image.ndim == 3 and image.shape[2] == 1:
        image = image[..., 0]
    pixels = _checked(image, channels, camera, f"expected an image of uint8 in {encoding}")
    return np.ascontiguousarray((pixels[..., None] if channels == 1 else pixels)[..., order])


def require_bgr(image: object) -> None:
    """Check that an image is what `bgr_image` gives; raises WrongImageError."""
    _checked(image, 3, None, "image: expected a BGR image of uint8")


def _checked(image: object, channels: int, camera: Camera | None, expected: str) -> NDArray[np.uint8]:
    size = "height, width" if camera is None else f"{camera.height_px}, {camera.width_px}"
    expected = f"{expected}, shape ({size}{f', {channels}' if channels > 1 else ''})"
    if not isinstance(image, np.ndarray):
        kind = type(image)
        hint = "" if kind.__module__ == "builtins" else ": numpy.asarray makes an array of it"
        raise WrongImageError(f"{expected}; found {kind.__name__}{hint}")
    if image.dtype != np.uint8:
        is_number = image.size > 0 and image.dtype.kind in "fiu"
        span = f", from {np.nanmin(image):g} to {np.nanmax(image):g}" if is_number else ""
        raise WrongImageError(f"{expected}; found {image.dtype}{span}: levels are from 0 to 255")
    got = f"{expected}; found {image.shape}"
    if image.ndim == 3 and image.shape[0] in (3, 4) and image.shape[2] not in (3, 4):
        raise WrongImageError(f"{got}: its channels stand first; numpy.moveaxis(image, 0, -1) puts them last")
    if image.ndim != (2 if channels == 1 else 3) or (channels > 1 and image.shape[2] != channels) or image.size == 0:
        raise WrongImageError(got)
    if camera is not None and image.shape[:2] != (camera.height_px, camera.width_px):
        is_turned = image.shape[1::-1] == (camera.height_px, camera.width_px)
        hint = ": rows and columns are exchanged" if is_turned else " of another size than its camera's"
        raise WrongImageError(f"{got}{hint}")
    return image
