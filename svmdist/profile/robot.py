"""The part of a profile about robots: chains and errors, instruments, what they work on, the simulation."""

from __future__ import annotations

from collections.abc import Iterable, Set
from typing import Annotated, Literal

import numpy as np
from pydantic import AfterValidator, Field, field_validator

from svmdist.profile import toml
from svmdist.profile.toml import Angle, Fraction, Length, NonNegative, Positive, SmallLength, StrictModel
from svmdist.transforms import Array, FrameName, make_transform, rotation_z

Vector = tuple[float, float, float]
EntrySide = Literal["left", "right", "above", "below"]  # of the picture, that an instrument comes in from
ARM_TOPICS = ("joints", "pose", "ground_truth_distance")  # of each instrument; the others are the whole scene's
TAGS = {"16h5": (30, 6), "25h9": (35, 7), "36h10": (2320, 8), "36h11": (587, 8)}
"""Of each AprilTag family: the number of its tags, which count from 0, and the cells of a black square's side."""


def _require_rotation(rotation: tuple[Vector, Vector, Vector]) -> tuple[Vector, Vector, Vector]:
    R = np.array(rotation)
    if not np.allclose(R @ R.T, np.eye(3), atol=1e-6) or np.linalg.det(R) < 0:
        raise ValueError("it is not a rotation: R R^T = I and det R = 1 are expected")
    return rotation


Rotation = Annotated[tuple[Vector, Vector, Vector], AfterValidator(_require_rotation)]


class Joint(StrictModel):
    """One row of a DH table, limits in its unit; the value of the joint adds to `theta_rad` or, prismatic, to `d_m`."""

    name: str
    type: Literal["revolute", "prismatic", "fixed"]
    a_m: float = 0.0
    alpha_rad: Angle = 0.0
    d_m: float = 0.0
    theta_rad: Angle = 0.0
    lower: Angle = -np.pi
    upper: Angle = np.pi
    aliases: tuple[str, ...] = ()  # other names of this joint in logs

    def _require_sound(self) -> None:
        if self.type != "fixed" and self.lower >= self.upper:
            raise ValueError(f"joint {self.name}: lower limit {self.lower} is not below upper limit {self.upper}")
        if abs(angle_rad := max(self.alpha_rad, self.theta_rad, key=abs)) > 2.0 * np.pi:
            expected = "expected alpha_rad and theta_rad in rad, within 2 pi, as 'pi/2'"
            raise ValueError(f"joint {self.name}: {expected}; found {angle_rad:g}")


class Robot(StrictModel):
    """The kinematic chain from base to tool."""

    convention: Literal["standard", "modified"] = "standard"
    joints: tuple[Joint, ...] = Field(min_length=1)
    tool_rotation: Rotation | None = None
    limit_tolerance_rad: Angle = Field(default=0.5, ge=0.0)  # beyond a joint's limits: encoders have offsets
    limit_tolerance_m: NonNegative = 0.05  # frames whose joints are farther out have the status `no_joints`

    def _require_sound(self) -> None:
        names = [name for joint in self.joints for name in (joint.name, *joint.aliases)]
        if doubles := sorted({name for name in names if names.count(name) > 1}):
            raise ValueError(f"joint names must differ; given twice: {', '.join(doubles)}")

    @property
    def joint_names(self) -> frozenset[str]:
        """The names and aliases of the moving joints."""
        moving = (joint for joint in self.joints if joint.type != "fixed")
        return frozenset(name for joint in moving for name in (joint.name, *joint.aliases))

    def missing_joints(self, names: Iterable[str]) -> list[str]:
        """The moving joints that are not among the names of a log, not by an alias either."""
        moving = (joint for joint in self.joints if joint.type != "fixed")
        return [joint.name for joint in moving if not {joint.name, *joint.aliases} & set(names)]


class KinematicError(StrictModel):
    """Standard deviations of a robot's kinematic errors, constant and changing; defaults are of cable-driven arms."""

    joint_std_rad: Angle = float(np.deg2rad(1.0))
    joint_std_m: NonNegative = 1e-3
    camera_base_std_rad: Angle = float(np.deg2rad(2.0))
    camera_base_std_m: NonNegative = 5e-3
    first_moving_joint: str | None = None  # errors of joints before it are camera-to-base's; None: every joint moves
    drift_rad_per_sqrt_s: NonNegative = 1e-4
    drift_m_per_sqrt_s: NonNegative = 1e-5
    play_std_rad: Angle = float(np.deg2rad(0.4))  # changing with the motion: backlash, friction, noise
    play_std_m: NonNegative = 1e-4
    play_time_s: Positive = 0.5  # correlation time of these errors: about that between a joint's reversals
    length_std_m: NonNegative = 5e-4  # of the chain's lengths behind the first moving joint
    time_offset_std_s: NonNegative = 0.05  # of the offset between the stamps of joints and images
    time_offset_drift_s_per_sqrt_s: NonNegative = 5e-4


class CameraError(StrictModel):
    """Standard deviations of the cameras' calibration; the defaults are of repeated ones of an endoscope."""

    focal_std_fraction: NonNegative = 4e-3  # of the focal lengths: the same error in both cameras
    centre_std_px: NonNegative = 1.5  # of the principal point along each axis
    baseline_std_fraction: NonNegative = 0.01  # of the distance between both cameras
    right_rotation_std_rad: Angle = float(np.deg2rad(0.03))  # of the right camera, about each axis


class Instrument(StrictModel):
    """The instrument's shape, in m, about the tool frame."""

    shaft_radius_m: SmallLength
    shaft_radius_std_fraction: Fraction = 0.02  # of the radius itself
    shaft_length_m: Length
    shaft_end_m: SmallLength | None = None  # from the wrist's hinge back; None: 2.2 radii of the wrist
    shaft_end_std_m: NonNegative | None = None  # None: half of a length that is not given, else 0.2 mm
    outline_end_m: float | None = Field(default=None, gt=-0.1, lt=0.1)
    """From the wrist's hinge on to where the outline is narrower than the shaft; None: anywhere that a clevis ends."""
    outline_end_std_m: NonNegative | None = None  # None: a quarter of the radius; if not given, its range
    wrist_radius_m: SmallLength
    knuckle_radius_m: SmallLength
    knuckle_radius_std_fraction: Fraction = 0.03  # of the distal marker's radius itself
    knuckle_position_m: Vector = (0.0, 0.0, 0.0)  # the distal marker's middle in the tool's frame
    knuckle_position_std_m: NonNegative = 2e-4  # along each axis
    jaw_length_m: SmallLength
    jaw_radius_m: SmallLength
    body_std_m: NonNegative = 1e-4  # between the real instrument's surface and the capsules of its model


class Fiducial(StrictModel):
    """A tag on the instrument's plate; its frame: origin in the tag's middle, x right, y up, z towards the reader."""

    family: Literal["16h5", "25h9", "36h10", "36h11"] = "36h11"
    id: int = Field(default=0, ge=0)
    size_m: SmallLength  # side of the black square, without the white margin
    size_std_fraction: Fraction = 0.005  # of that side itself, as printed
    position_std_m: NonNegative = 3e-4  # along each axis: glued by hand
    rotation_std_rad: Angle = float(np.deg2rad(1.3))  # about each axis
    link: str  # the joint whose DH frame carries the plate
    position_m: Vector
    rotation: Rotation = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

    @property
    def plate_side_m(self) -> float:
        """Side of the plate, with a white margin of one cell around the black square."""
        _, cells = TAGS[self.family]
        return self.size_m * (cells + 2) / cells

    @property
    def T_link_tag(self) -> Array:
        """The tag's pose on its link, shape (4, 4)."""
        return make_transform(self.rotation, self.position_m)


class Dome(StrictModel):
    """A dome over the image's outline of tissue: height h (1 - g^a)^b at normalised radius g; half an ellipsoid."""

    height_m: SmallLength
    height_std_m: NonNegative = 0.0
    apex_std_m: NonNegative = 0.0  # of the apex beside the outline's middle, along each of two axes
    gauge_exponent: float = Field(default=2.0, ge=1.0, le=20.0)
    height_exponent: float = Field(default=0.5, gt=0.0, le=2.0)
    gauge_exponent_std: float = Field(default=0.3, ge=0.0, le=10.0)
    height_exponent_std: Fraction = 0.1


class Tissue(StrictModel):
    """The plane that the tissue lies on, `plane_normal` · p = -`plane_distance_m` in the camera frame, and its shape.

    Without a dome or a mesh the plane itself is the surface. The tissue's frame: origin where the completed outline's
    centroid lies on the plane, z along the normal, towards the camera, x the camera's x axis projected onto the plane.
    """

    plane_normal: Vector = (0.0, 0.0, -1.0)
    plane_distance_m: Length
    plane_distance_std_m: NonNegative = 1e-3
    plane_tilt_std_rad: Angle = float(np.deg2rad(1.0))  # of the normal's direction about each of two axes
    unverified_std_m: NonNegative = 7.5e-3
    """Of all of the above where no second view shows the tissue: nothing then shows a plane that is a centimetre off,
    or an organ that is left out. 0 for what was measured and cannot have moved."""
    motion_std_m: NonNegative = 1e-3  # of the tissue's motion along the plane's normal: breath and pulse
    motion_time_s: Positive = 0.5  # correlation time of that motion: a breath of 4 s turns within as long
    dome: Dome | None = None
    mesh: toml.NeighbourFile | None = None  # a closed surface (.obj, .stl) in a dome's place; relative to the profile
    mesh_unit: Literal["m", "cm", "mm"] = "m"  # of the file's numbers; the formats do not say
    mesh_position_m: Vector = (0.0, 0.0, 0.0)  # the mesh's origin in the tissue's frame
    mesh_yaw_rad: Angle = 0.0  # about the tissue's z axis, counter-clockwise seen from the camera's side
    surface_std_m: NonNegative = 0.0  # between shape and real surface, beside a dome's own deviations

    @field_validator("plane_normal")
    @classmethod
    def _unit(cls, normal: Vector) -> Vector:
        length = float(np.linalg.norm(normal))
        if abs(length - 1.0) > 0.01:  # written with two digits
            raise ValueError(f"it must have length 1, found {length:.7g}")
        if normal[2] > 0.5 * length:  # no camera of less than 120° sees such a plane
            raise ValueError("it points away from the camera: towards it z is negative, as in [0, 0, -1]")
        x, y, z = normal
        return normal if abs(length - 1.0) <= 1e-12 else (x / length, y / length, z / length)

    def _require_sound(self) -> None:
        if self.mesh is not None and self.dome is not None:
            raise ValueError("a dome and a mesh cannot be combined; give one")
        lost = sorted(self.model_fields_set & {"mesh_unit", "mesh_position_m", "mesh_yaw_rad"})
        if self.mesh is None and lost:
            raise ValueError(f"{lost[0]} needs a mesh")

    @property
    def T_tissue_mesh(self) -> Array:
        """The mesh's pose in the tissue's frame, shape (4, 4)."""
        return make_transform(rotation_z(self.mesh_yaw_rad), self.mesh_position_m)


class FieldOfView(StrictModel):
    """What can be in an endoscope's field of view: sizes and distances beyond are taken for a mistake in a unit."""

    least_depth_m: Length = 0.01  # of anything that both views show
    depth_m: Length = 1.0  # of tool and tissue
    diameter_m: tuple[Positive, Positive] = (0.002, 0.02)  # of an instrument's shaft, least and most
    wrist_link_m: Positive = 0.05  # the longest link behind the shaft


class Placement(StrictModel):
    """The pose of a simulated arm's base in the world."""

    base_position_m: Vector
    base_yaw_rad: Angle = 0.0


class Simulation(Placement):
    """What `svmdist record` needs beside the chain: positions of things, and the encoders' errors."""

    camera_height_m: Length
    horizontal_fov_rad: Angle
    width_px: int = Field(default=640, ge=16, le=4096)
    height_px: int = Field(default=480, ge=16, le=4096)
    working_height_m: Length  # of the tool origin above the floor in the plane of the measured distances
    posture: dict[str, Angle]  # of every joint in the middle of the work space; scenarios search from here
    joint_rate_hz: float = Field(default=100.0, ge=1.0)
    encoder_std_rad: NonNegative = 0.0
    encoder_std_m: NonNegative = 0.0
    stereo_baseline_m: SmallLength = 0.005  # a da Vinci's; the right camera is so far along the left's x


class ArmTopics(StrictModel):
    """Topics of one instrument. A log without its joints and its pose does not have the instrument."""

    joints: str | None = None
    pose: str | None = None
    ground_truth_distance: str | None = None

    def _require_sound(self) -> None:
        if self.joints is None and self.pose is None:
            raise ValueError("an instrument is known by its topics: name joints or pose")


class ArmFrames(StrictModel):
    """Frames of one instrument."""

    base: FrameName
    tool: FrameName


class OtherInstrument(StrictModel):
    """An instrument beside the profile's own; what is left out is as for that one."""

    name: str = Field(min_length=1)
    topics: ArmTopics | None = None  # one without is known by images alone, by its side: every log has it
    frames: ArmFrames | None = None
    entry: EntrySide | None = None
    fiducial_id: int | None = Field(default=None, ge=0)  # of the tag it carries where the profile's own does
    robot: Robot | None = None
    instrument: Instrument | None = None
    simulation: Placement | None = None

    def _require_sound(self) -> None:
        if self.topics is not None and self.frames is None:
            raise ValueError("an instrument with topics has frames: give frames.base and frames.tool")

    @property
    def logged_topics(self) -> dict[str, str]:
        """Its topics that have a name, by role; none for an instrument known by images alone."""
        return {} if self.topics is None else self.topics.model_dump(exclude_none=True)

    def is_in(self, topics: Set[str]) -> bool:
        """Whether a log with these topics has the instrument."""
        return self.topics is None or bool(topics & {self.topics.joints, self.topics.pose})
