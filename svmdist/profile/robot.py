"""The part of a profile about robots: chains and errors, instruments, what they work on, the simulation."""

from __future__ import annotations

from collections.abc import Set
from typing import Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from svmdist.profile.toml import Angle, Length, NeighbourFile, SmallLength, StrictModel
from svmdist.transforms import Array, make_transform, rotation_z


class Joint(StrictModel):
    """One DH row; see `svmdist.kinematics.dh.DHRow`."""

    name: str
    type: Literal["revolute", "prismatic", "fixed"]
    a_m: float = 0.0
    alpha_rad: Angle = 0.0
    d_m: float = 0.0
    theta_rad: Angle = 0.0
    lower: Angle = -np.pi
    upper: Angle = np.pi
    aliases: tuple[str, ...] = ()
    """Other names under which logs carry this joint."""

    @model_validator(mode="after")
    def _ordered(self) -> Joint:
        if self.type != "fixed" and self.lower >= self.upper:
            raise ValueError(
                f"joint {self.name}: lower limit {self.lower} is not below upper limit {self.upper}"
            )
        return self


AWAY = 0.5
"""z of a plane's normal from which on no camera of less than 120° sees the plane."""
ROUNDED = 0.01
"""How far a normal's length may be from 1: numbers that were written with two digits. It is normalised."""
TAG_COUNTS = {"16h5": 30, "25h9": 35, "36h10": 2320, "36h11": 587}
"""How many tags an AprilTag family has; they are numbered from 0."""

Rotation = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]


def require_rotation(name: str, rotation: Rotation) -> None:
    """Raise ValueError where a matrix is no rotation."""
    R = np.array(rotation)
    if not np.allclose(R @ R.T, np.eye(3), atol=1e-6) or np.linalg.det(R) < 0:
        raise ValueError(f"{name} is not a rotation: R R^T = I and det R = 1 are expected")


class Robot(StrictModel):
    """The kinematic chain from base to tool."""

    convention: Literal["standard", "modified"] = "standard"
    joints: tuple[Joint, ...] = Field(min_length=1)
    tool_rotation: Rotation | None = None
    limit_tolerance_rad: Angle = Field(default=0.5, ge=0.0)
    """How far beyond its limits a joint that turns may be reported: encoders have offsets, and limits are rounded."""
    limit_tolerance_m: float = Field(default=0.05, ge=0.0)
    """The same of a joint that slides. Joints that are farther out are no joints: `no_joints`."""

    @model_validator(mode="after")
    def _sound(self) -> Robot:
        names = [name for joint in self.joints for name in (joint.name, *joint.aliases)]
        doubles = sorted({name for name in names if names.count(name) > 1})
        if doubles:
            raise ValueError(f"joint names must differ; given twice: {', '.join(doubles)}")
        if self.tool_rotation is not None:
            require_rotation("tool_rotation", self.tool_rotation)
        return self

    @property
    def T_last_tool(self) -> Array:
        """The constant transform behind the last row, shape (4, 4)."""
        T = np.eye(4)
        if self.tool_rotation is not None:
            T[:3, :3] = self.tool_rotation
        return T


class KinematicError(StrictModel):
    """How wrong the robot's kinematics may be: standard deviations of constant and of changing errors, and drift.

    The defaults are what cable-driven arms show: a degree and a millimetre at each joint, and a
    camera-to-base transform whose rotation is off by two degrees about each axis and whose translation by
    five millimetres along each.
    """

    joint_std_rad: Angle = float(np.deg2rad(1.0))
    joint_std_m: float = Field(default=1e-3, ge=0.0)
    camera_base_std_rad: Angle = float(np.deg2rad(2.0))
    camera_base_std_m: float = Field(default=5e-3, ge=0.0)
    first_moving_joint: str | None = None
    """The joints before this one hold still while the instrument works: their errors are one with the
    camera-to-base transform's. None: every joint moves."""
    drift_rad_per_sqrt_s: float = Field(default=1e-4, ge=0.0)
    drift_m_per_sqrt_s: float = Field(default=1e-5, ge=0.0)
    play_std_rad: Angle = float(np.deg2rad(0.4))
    """Joint errors that change with the motion: backlash, cables that stretch, friction, encoder noise."""
    play_std_m: float = Field(default=1e-4, ge=0.0)
    play_time_s: float = Field(default=0.5, gt=0.0)
    """Correlation time of these errors: about the time between two reversals of a joint."""
    length_std_m: float = Field(default=5e-4, ge=0.0)
    """Of the chain's lengths behind the first moving joint."""
    time_offset_std_s: float = Field(default=0.05, ge=0.0)
    """How late the joints' stamps may be against those of the images, or early."""
    time_offset_drift_s_per_sqrt_s: float = Field(default=5e-4, ge=0.0)


class CameraError(StrictModel):
    """How wrong the calibration of the cameras may be, as standard deviations; the defaults are a careful user's.

    Repeated calibrations of an endoscope with a chessboard scatter by as much, and its focus moves between them.
    """

    focal_std_fraction: float = Field(default=4e-3, ge=0.0)
    """Of the focal lengths, over themselves; those of a pair are off alike."""
    centre_std_px: float = Field(default=1.5, ge=0.0)
    """Of the principal point along each axis."""
    baseline_std_fraction: float = Field(default=0.01, ge=0.0)
    """Of the distance between both cameras, over itself."""
    right_rotation_std_rad: Angle = float(np.deg2rad(0.03))
    """Of the right camera's rotation against the left one, about each axis."""


class Instrument(StrictModel):
    """The instrument's shape, in m, about the tool frame: what the simulation builds and clearance needs."""

    shaft_radius_m: SmallLength
    shaft_radius_std_fraction: float = Field(default=0.02, ge=0.0, le=1.0)
    """Standard deviation of the shaft's radius over itself."""
    shaft_length_m: Length
    shaft_end_m: SmallLength | None = None
    """From the wrist's hinge back to where the dark shaft visibly ends; None: 2.2 radii of the wrist."""
    outline_end_m: float | None = Field(default=None, gt=-0.1, lt=0.1)
    """From the wrist's hinge on to where the outline stops being as wide as the shaft, negative behind it; None: 0.9
    radii of the shaft, and less certain."""
    wrist_radius_m: SmallLength
    knuckle_radius_m: SmallLength
    knuckle_radius_std_fraction: float = Field(default=0.03, ge=0.0, le=1.0)
    """Standard deviation of the distal marker's radius over itself."""
    knuckle_position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where the distal marker's middle is in the tool's frame."""
    knuckle_position_std_m: float = Field(default=2e-4, ge=0.0)
    """How far it may be from there, as a standard deviation along each axis."""
    jaw_length_m: SmallLength
    jaw_radius_m: SmallLength
    body_std_m: float = Field(default=1e-4, ge=0.0)
    """How far the real instrument's surface may stand off the capsules that stand in for it."""


def require_tag(family: str, tag_id: int) -> None:
    """Raise ValueError where the family has no tag of that number."""
    if tag_id >= TAG_COUNTS[family]:
        raise ValueError(f"family {family} has the tags 0 to {TAG_COUNTS[family] - 1}, found {tag_id}")


class Fiducial(StrictModel):
    """A tag on a plate that a link of the instrument carries.

    The tag's frame is OpenCV's: origin in the middle of the black square, x to the right and y up as one
    reads the tag, z out of the plate towards the reader.
    """

    family: Literal["16h5", "25h9", "36h10", "36h11"] = "36h11"
    """The AprilTag family."""
    id: int = Field(default=0, ge=0)
    size_m: SmallLength
    """Side of the black square; the white margin around it is not in it."""
    size_std_fraction: float = Field(default=0.005, ge=0.0, le=1.0)
    """Standard deviation of that side over itself, as printed."""
    position_std_m: float = Field(default=3e-4, ge=0.0)
    """How far the tag may be from its stated place, as a standard deviation along each axis: glued by hand."""
    rotation_std_rad: Angle = float(np.deg2rad(1.3))
    """How far it may be turned, about each axis."""
    link: str
    """The joint whose DH frame carries the plate."""
    position_m: tuple[float, float, float]
    rotation: Rotation = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

    @model_validator(mode="after")
    def _sound(self) -> Fiducial:
        require_tag(self.family, self.id)
        require_rotation("rotation", self.rotation)
        return self

    @property
    def plate_side_m(self) -> float:
        """Side of the plate, with a white margin of one cell around the black square."""
        cells = {"16h5": 6, "25h9": 7, "36h10": 8, "36h11": 8}[self.family]
        return self.size_m * (cells + 2) / cells

    @property
    def T_link_tag(self) -> Array:
        """Where the tag is on its link, shape (4, 4)."""
        return make_transform(self.rotation, self.position_m)


class Dome(StrictModel):
    """A dome over the tissue's outline: height h (1 - g^a)^b at normalised radius g, 0 at the apex, 1 on the outline.

    The defaults make half an ellipsoid. The outline itself comes from the image, the apex stands over its middle.
    What the standard deviations leave open, `fused` finds where it has both cameras.
    """

    height_m: SmallLength
    height_std_m: float = Field(default=0.0, ge=0.0)
    apex_std_m: float = Field(default=0.0, ge=0.0)
    """How far the apex stands beside the outline's middle, as a standard deviation along each of two axes."""
    gauge_exponent: float = Field(default=2.0, ge=1.0, le=20.0)
    height_exponent: float = Field(default=0.5, gt=0.0, le=2.0)
    gauge_exponent_std: float = Field(default=0.3, ge=0.0, le=10.0)
    height_exponent_std: float = Field(default=0.1, ge=0.0, le=1.0)
    """Standard deviations of the exponents: organs are no ellipsoids, and no two of them are alike."""


class Tissue(StrictModel):
    """The plane that the tissue lies on, measured in the camera frame, and its shape above that plane.

    The plane holds the points with `plane_normal` · p = -`plane_distance_m`: its normal points to the camera's
    side. Without a dome or a mesh the plane itself is the surface.

    The tissue's frame: origin where the completed outline's centroid lies on the plane, z along the plane's normal,
    x the camera's x axis laid onto the plane, y to the left of x as the camera sees it: upwards in the image.
    """

    plane_normal: tuple[float, float, float] = (0.0, 0.0, -1.0)
    plane_distance_m: Length
    plane_distance_std_m: float = Field(default=1e-3, ge=0.0)
    plane_tilt_std_rad: Angle = float(np.deg2rad(1.0))
    """Standard deviation of the normal's direction about each of two axes."""
    motion_std_m: float = Field(default=1e-3, ge=0.0)
    """How far the tissue moves along the plane's normal, as a standard deviation: breath and pulse."""
    motion_time_s: float = Field(default=0.5, gt=0.0)
    """Correlation time of that motion: a breath of 4 s turns within as long."""
    dome: Dome | None = None
    mesh: NeighbourFile | None = None
    """A closed surface in a file .obj or .stl, in place of a dome; a relative path starts from the profile's folder."""
    mesh_unit: Literal["m", "cm", "mm"] = "m"
    """What the file's numbers are; the formats do not say."""
    mesh_position_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Where the mesh's origin stands in the tissue's frame."""
    mesh_yaw_rad: Angle = 0.0
    """How far the mesh is turned about the tissue's z axis, counter-clockwise seen from the camera's side."""
    surface_std_m: float = Field(default=0.0, ge=0.0)
    """How far the shape stands off the real surface, as a standard deviation; beside what a dome says of itself."""

    @field_validator("plane_normal")
    @classmethod
    def _unit(cls, normal: tuple[float, float, float]) -> tuple[float, float, float]:
        """Normalise what was rounded."""
        length = float(np.linalg.norm(normal))
        if not 1e-12 < abs(length - 1.0) <= ROUNDED:
            return normal
        x, y, z = normal
        return x / length, y / length, z / length

    @model_validator(mode="after")
    def _sound(self) -> Tissue:
        length = float(np.linalg.norm(self.plane_normal))
        if abs(length - 1.0) > 1e-6:
            raise ValueError(f"plane_normal must have length 1, found {length:.7g}")
        if self.plane_normal[2] > AWAY:
            raise ValueError(
                "plane_normal points away from the camera: towards it z is negative, as in [0, 0, -1]"
            )
        if self.mesh is not None and self.dome is not None:
            raise ValueError("a dome and a mesh exclude each other: which of them is the tissue's shape?")
        lost = sorted(self.model_fields_set & {"mesh_unit", "mesh_position_m", "mesh_yaw_rad"})
        if self.mesh is None and lost:
            raise ValueError(f"{lost[0]} needs a mesh")
        return self

    @property
    def T_tissue_mesh(self) -> Array:
        """Where the mesh stands in the tissue's frame, shape (4, 4)."""
        return make_transform(rotation_z(self.mesh_yaw_rad), self.mesh_position_m)


class Simulation(StrictModel):
    """What `svmdist record` needs beside the chain: where things stand, and what the encoders get wrong."""

    camera_height_m: Length
    horizontal_fov_rad: Angle
    width_px: int = Field(default=640, ge=16, le=4096)
    height_px: int = Field(default=480, ge=16, le=4096)
    working_height_m: Length
    """Height of the tool origin above the floor in the plane in which distances are measured."""
    base_position_m: tuple[float, float, float]
    base_yaw_rad: Angle = 0.0
    posture: dict[str, Angle]
    """Value of every joint in the middle of the work space; the scenarios start their search here."""
    joint_rate_hz: float = Field(default=100.0, ge=1.0)
    encoder_std_rad: float = Field(default=0.0, ge=0.0)
    encoder_std_m: float = Field(default=0.0, ge=0.0)
    stereo_baseline_m: SmallLength = 0.005
    """How far the right camera stands from the left one, along its x axis: that of a da Vinci's endoscope."""


EntrySide = Literal["left", "right", "above", "below"]
"""The side of the picture that an instrument comes in from."""
ARM_TOPICS = ("joints", "pose", "ground_truth_distance")
"""The topics that every instrument has of its own; the others are the whole scene's."""


class ArmTopics(StrictModel):
    """Topics of one instrument. A log without its joints and without its pose has not got the instrument."""

    joints: str | None = None
    pose: str | None = None
    ground_truth_distance: str | None = None

    @model_validator(mode="after")
    def _tells_of_the_instrument(self) -> ArmTopics:
        if self.joints is None and self.pose is None:
            raise ValueError("an instrument is known by its topics: name joints or pose")
        return self

    def are_in(self, topics: Set[str]) -> bool:
        """Whether a log with these topics has the instrument."""
        return bool(topics & {self.joints, self.pose})

    @property
    def named(self) -> dict[str, str]:
        """The topics that have a name, by role."""
        topics = {role: getattr(self, role) for role in ARM_TOPICS}
        return {role: topic for role, topic in topics.items() if topic is not None}


class ArmFrames(StrictModel):
    """Frames of one instrument."""

    base: str
    tool: str


class Placement(StrictModel):
    """Where a simulated arm's base stands in the world."""

    base_position_m: tuple[float, float, float]
    base_yaw_rad: Angle = 0.0


class OtherInstrument(StrictModel):
    """An instrument beside the profile's own; what is left out is as for that one.

    Without topics nothing but images tells of it: every log has it, and it is told by its side of the picture.
    """

    name: str = Field(min_length=1)
    topics: ArmTopics | None = None
    frames: ArmFrames | None = None
    entry: EntrySide | None = None
    """The side that it comes in from, where no joints tell it from the others."""
    fiducial_id: int | None = Field(default=None, ge=0)
    """The number of the tag that this instrument carries where the profile's own does."""
    robot: Robot | None = None
    instrument: Instrument | None = None
    simulation: Placement | None = None

    @model_validator(mode="after")
    def _frames_of_what_moves(self) -> OtherInstrument:
        if self.topics is not None and self.frames is None:
            raise ValueError("an instrument with topics has frames: give frames.base and frames.tool")
        return self

    @property
    def logged_topics(self) -> dict[str, str]:
        """Its topics that have a name, by role; none of an instrument that only images tell of."""
        return {} if self.topics is None else self.topics.named

    def is_in(self, topics: Set[str]) -> bool:
        """Whether a log with these topics has the instrument."""
        return self.topics is None or self.topics.are_in(topics)
