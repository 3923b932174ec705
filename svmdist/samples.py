"""What flows through svmdist: samples read from a recording, observations, and estimates.

An `Observation` holds what a real robot would give. It has no field for ground truth, so that no
estimator can peek; truth travels on its own, as `DistanceSample` and `TransformSample`.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
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
    """Transforms that were published together, as one message of a tf topic."""

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
    """The right image of a stereo pair, its camera, and where that stands: `T_left_right`, shape (4, 4).

    `foreign` is as in `Observation`.
    """

    image_bgr: Image
    camera: Camera
    T_left_right: Array
    foreign: Image | None = None


@dataclass(frozen=True, slots=True)
class Observation:
    """What an estimator may see of one instant: the image, its camera, and what the robot reports.

    `joints` are interpolated to the image's stamp; `T_camera_base`, shape (4, 4), is what the robot
    believes. Each of them, and the right view, is None where the log has none near the image.
    `foreign`, shape (h, w), marks the pixels that have an instrument's colours and belong to another one, or
    to nobody knows whom; None where there is one instrument only.
    """

    stamp_ns: int
    image_bgr: Image
    camera: Camera
    joints: JointSample | None = None
    right: RightView | None = None
    T_camera_base: Array | None = None
    foreign: Image | None = None


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


@dataclass(frozen=True, slots=True)
class Rejection:
    """A frame that could not be measured, with the reason and a detail for a person."""

    stamp_ns: int
    status: Status
    detail: str = ""


@dataclass(frozen=True, slots=True)
class ToolState:
    """The instrument as a 3D method found it: `T_camera_tool`, (4, 4), with a covariance of (δp, δθ), (6, 6).

    `axis` is the shaft's direction, shape (3,); `joints` bend the wrist, None where they are not known. `has_plate`
    says that a fiducial's plate was seen on it.
    """

    T_camera_tool: Array
    covariance: Array
    axis: Array
    joints: JointSample | None
    has_plate: bool = False


@dataclass(frozen=True, slots=True)
class Estimate:
    """The outcome of one frame: a distance, or the reason why there is none.

    `distance_m` is the planar distance, `spatial_m` the same in 3D, `clearance_m` the smallest distance
    between the surfaces; each has a standard deviation where the method can tell one. The tool's position
    in m, its axis and the direction of the shortest separation, from instrument to tissue (unit vectors),
    are in the camera frame. Positions in the image are in px, areas are pixel counts. A field is None
    where the method did not get that far.

    `instrument` names what was measured. `instrument_clearance_m` is the smallest distance to the surface of another
    instrument, with its deviation and its direction, towards the other one; `tool_state` is what it is computed from.
    """

    stamp_ns: int
    status: Status
    distance_m: float | None = None
    tool_x_px: float | None = None
    tool_y_px: float | None = None
    tissue_x_px: float | None = None
    tissue_y_px: float | None = None
    tool_area_px: int | None = None
    tissue_area_px: int | None = None
    keypoint_count: int | None = None
    match_count: int | None = None
    inlier_count: int | None = None
    detail: str = ""
    spatial_m: float | None = None
    clearance_m: float | None = None
    distance_std_m: float | None = None
    spatial_std_m: float | None = None
    clearance_std_m: float | None = None
    tool_position_m: Vector | None = None
    tool_axis: Vector | None = None
    clearance_direction: Vector | None = None
    instrument: str = ""
    instrument_clearance_m: float | None = None
    instrument_clearance_std_m: float | None = None
    instrument_clearance_direction: Vector | None = None
    tool_state: ToolState | None = field(default=None, repr=False, compare=False)

    @property
    def measured(self) -> bool:
        """Whether this frame has a distance."""
        return self.status is Status.OK
