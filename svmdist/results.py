"""The results of methods, grouped; `report/` alone flattens them to columns."""

from __future__ import annotations

from dataclasses import dataclass, replace
from statistics import NormalDist

import numpy as np

from svmdist.samples import JointSample, Status, Vector
from svmdist.transforms import Array

Pixel = tuple[float, float]
Z_95 = NormalDist().inv_cdf(0.975)
"""Standard deviations that a normal 95 % interval reaches to either side."""


@dataclass(frozen=True, slots=True)
class Failure:
    """Why something could not be found or computed, in readable words."""

    reason: str


@dataclass(frozen=True, slots=True)
class Hinge:
    """The wrist's hinge in the camera frame, shape (3,), and its covariance, shape (3, 3)."""

    position_m: Array
    covariance: Array


@dataclass(frozen=True, slots=True)
class ToolPose:
    """`T_camera_tool`, shape (4, 4), and the covariance of its error (δp, δθ), shape (6, 6), in the camera frame.

    p_true = p + δp in m, R_true = exp([δθ]) R in rad. The tool's x axis points along the jaws; `axis` is the shaft's
    direction, from the base to the tip, a unit vector of shape (3,) in the camera frame.
    """

    T_camera_tool: Array
    covariance: Array
    axis: Array
    axis_std_rad: float | None = None  # the worse of two directions across it; None: by the covariance
    hinge: Hinge | None = None  # where the shaft ends in the wrist; None: by the joints
    jaw_scale: float = 1.0  # the jaws' length over the profile's, where their tips are seen

    @property
    def position_m(self) -> Array:
        """The tool's origin in the camera frame, shape (3,)."""
        return np.asarray(self.T_camera_tool[:3, 3])

    @property
    def position_covariance(self) -> Array:
        """Covariance of the position, shape (3, 3), in m²."""
        return np.asarray(self.covariance[:3, :3])

    @property
    def position_std_m(self) -> float:
        """Standard deviation of the position in the direction in which it is the largest; NaN for an unknown one."""
        if not np.isfinite(self.position_covariance).all():
            return float("nan")
        return float(np.sqrt(max(np.linalg.eigvalsh(self.position_covariance)[-1], 0.0)))

    @property
    def shaft_std_rad(self) -> float:
        """Standard deviation of the shaft's direction, the worse of two across it."""
        return across_std_rad(self.covariance[3:, 3:], self.axis) if self.axis_std_rad is None else self.axis_std_rad


def across_std_rad(covariance: Array, axis: Array) -> float:
    """Standard deviation of an axis, a unit vector (3,), that turns by vectors of a covariance, (3, 3) in rad²."""
    across = np.eye(3) - np.outer(axis, axis)
    return float(np.sqrt(max(np.linalg.eigvalsh(across @ covariance @ across)[-1], 0.0)))


@dataclass(frozen=True, slots=True)
class ToolEstimate:
    """The instrument as a method in 3D found it: the tool's pose, and the joints that bend its wrist, where known."""

    pose: ToolPose
    joints: JointSample | None = None
    has_plate: bool = False  # whether the fiducial's plate is on the instrument


@dataclass(frozen=True, slots=True)
class Distance:
    """A distance in m, with its standard deviation where the method gives one.

    Where surfaces seem to overlap, `std_m` has the overlap in it, and `without_overlap_std_m` has not. In the camera
    frame, `direction`, a unit vector, points from the instrument along the separation, which begins at `start_m`.
    """

    value_m: float
    std_m: float | None = None
    direction: Vector | None = None
    start_m: Vector | None = None
    without_overlap_std_m: float | None = None

    @property
    def half_m(self) -> float | None:
        """Half of the 95 % interval, what stands behind ±; None without a standard deviation."""
        return None if self.std_m is None else Z_95 * self.std_m

    @property
    def interval_m(self) -> tuple[float, float] | None:
        """The bounds of the 95 % interval; None without a standard deviation."""
        return None if self.half_m is None else (self.value_m - self.half_m, self.value_m + self.half_m)


@dataclass(frozen=True, slots=True)
class Distances:
    """The distances of one instrument in one frame; None where the method has none.

    `planar` is the paper's distance in the camera's xy plane, `spatial` the same in 3D, `clearance` the smallest
    distance between the surfaces of instrument and tissue, `to_instrument` that to the nearest other instrument.
    """

    planar: Distance | None = None
    spatial: Distance | None = None
    clearance: Distance | None = None
    to_instrument: Distance | None = None

    @property
    def main(self) -> Distance | None:
        """The clearance where the method measures one, else the planar distance."""
        return self.clearance or self.planar


@dataclass(frozen=True, slots=True)
class ImageFindings:
    """Positions in px, areas in pixels, counts of features or measurements; None where there are none."""

    tool_px: Pixel | None = None
    tissue_px: Pixel | None = None
    tool_area_px: int | None = None
    tissue_area_px: int | None = None
    keypoint_count: int | None = None
    match_count: int | None = None
    inlier_count: int | None = None


@dataclass(frozen=True, slots=True)
class AlarmEvent:
    """Alarmed rows of one instrument, from the first to the last of them, and the smallest clearance of these.

    A row judged safe ends it, so do a few in a row without a clearance. Numbers are of images, seconds since the first.
    """

    instrument: str
    start_number: int
    start_s: float
    end_s: float
    least: Distance
    least_number: int

    @property
    def duration_s(self) -> float:
        """From the first to the last alarmed image: 0 for a single one."""
        return self.end_s - self.start_s


@dataclass(frozen=True, slots=True)
class AlarmState:
    """Of one row: whether an alarm is raised, closing speed (positive: closer), time to contact; None where unknown."""

    is_raised: bool | None = None
    closing_speed_m_s: float | None = None
    time_to_contact_s: float | None = None
    event: AlarmEvent | None = None  # so far, of an alarmed row


@dataclass(frozen=True, slots=True)
class FrameResult:
    """The outcome of one frame for one instrument: its distances, or the status that says why there are none."""

    stamp_ns: int
    status: Status
    image: ImageFindings = ImageFindings()
    tool: ToolEstimate | None = None
    distances: Distances = Distances()
    detail: str = ""
    instrument: str = ""
    consistency: float | None = None  # squared innovations over their expectation
    doubt: str = ""  # why it is not sure which instrument this is; the detail says so too
    accepted: tuple[str, ...] = ()  # detections that agree with the rest, and those that contradict it
    refused: tuple[str, ...] = ()
    number: int = 0  # of the image in its log, from 0
    seconds: float = 0.0  # since the first image of the log
    alarm: AlarmState = AlarmState()  # by the rules that were asked for

    @property
    def measured(self) -> bool:
        """Whether this frame has a distance."""
        return self.status is Status.OK

    def rejected(self, status: Status, detail: str = "") -> FrameResult:
        """The same without a distance, for a reason."""
        return replace(self, status=status, detail=detail, distances=Distances())

    def doubted(self, doubt: str) -> FrameResult:
        """The same of an instrument that may be another one: its detail says so."""
        return replace(self, doubt=doubt, detail=f"{self.detail}; {doubt}" if self.detail else doubt)

    def with_image(self, **found: object) -> FrameResult:
        """The same with more of what was found in the image."""
        return replace(self, image=replace(self.image, **found))  # type: ignore[arg-type]


def as_pixel(point_px: Array) -> Pixel:
    """Two floats from a point of shape (2,)."""
    return float(point_px[0]), float(point_px[1])


def as_vector(values: Array) -> Vector:
    """Three floats from an array of shape (3,)."""
    x, y, z = values.tolist()
    return x, y, z
