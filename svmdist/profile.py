"""The scene profile (TOML): what a recording shows and how to measure it, checked when it is read.

A profile names the topics and frames of a log and the limits of what it may ask, the colours of tissue and
instrument, the marker and the feature matching, and the robot's chain. Everything that depends on a scene
stands here, so that another scene needs another profile and no other code.
"""

from __future__ import annotations

import tomllib
from collections.abc import Iterator
from importlib import resources
from pathlib import Path
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, BeforeValidator, ConfigDict, Field, ValidationError, model_validator

from svmdist.errors import ProfileError, SvmdistError, did_you_mean
from svmdist.transforms import Array, make_transform

DEFAULT_PROFILE = "psm13"
Model = TypeVar("Model", bound="StrictModel")


class StrictModel(BaseModel):
    """Base of everything read from TOML: frozen, and an unknown key is an error."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


def _parse_angle(value: Any) -> Any:
    """Accept a number in rad, or a multiple of pi such as `pi`, `-pi/2`, `2*pi/3`, which has no last digit."""
    if not isinstance(value, str):
        return value
    text = value.replace(" ", "")
    sign, text = (-1.0, text[1:]) if text.startswith("-") else (1.0, text)
    factor, times, rest = text.rpartition("*")
    symbol, over, divisor = rest.partition("/")
    try:
        if symbol != "pi":
            raise ValueError
        return sign * (float(factor) if times else 1.0) * np.pi / (float(divisor) if over else 1.0)
    except (ValueError, ZeroDivisionError):
        raise ValueError(
            f"expected rad as a number or a multiple of pi such as 'pi/2', found {value!r}"
        ) from None


def _parse_size(value: Any) -> Any:
    """Accept a number of bytes, or text such as `512 MiB`."""
    if not isinstance(value, str):
        return value
    number, _, unit = value.partition(" ")
    if not number.isdecimal() or unit not in SIZE_UNITS:
        raise ValueError(f"expected bytes as a number, or as '512 MiB', found {value!r}")
    return int(number) * SIZE_UNITS[unit]


SIZE_UNITS = {"KiB": 1 << 10, "MiB": 1 << 20, "GiB": 1 << 30}
MIB = SIZE_UNITS["MiB"]
Angle = Annotated[float, BeforeValidator(_parse_angle)]
Size = Annotated[int, BeforeValidator(_parse_size), Field(ge=1 << 10, le=1 << 40)]
Length = Annotated[float, Field(gt=0.0)]
Byte = Annotated[int, Field(ge=0, le=255)]
Hue = Annotated[int, Field(ge=0, le=179)]


class Topics(StrictModel):
    """Topic names of a log; None means: the one topic whose schema fits.

    The right camera's topics and the true transforms must be named: their schemas fit others as well.
    """

    image: str | None = None
    camera_info: str | None = None
    right_image: str | None = None
    right_camera_info: str | None = None
    joints: str | None = None
    pose: str | None = None
    tf: str | None = None
    ground_truth_tf: str | None = None
    ground_truth_distance: str | None = None


class Frames(StrictModel):
    """Frame names of a log's transforms."""

    camera: str = "camera"
    base: str = "base"
    tool: str = "tool"
    tissue: str = "tissue"


class Limits(StrictModel):
    """What a log may ask of the reader, checked before memory is allocated; what asks for more is a loss."""

    record_bytes: Size = 256 * MIB
    """One record of the file; it may never reach beyond the file either."""
    chunk_bytes: Size = 256 * MIB
    """One chunk after expansion; it must have exactly the size that it declares."""
    chunk_records: int = Field(default=1_000_000, ge=1)
    """Records inside one chunk."""
    window_bytes: Size = 128 * MIB
    """Memory that a zstd frame may claim for its window, beside the expanded chunk."""
    definition_bytes: Size = 32 * MIB
    """Schemas and channels of a whole file, which stay in memory while it is read."""
    metadata_bytes: Size = 1 * MIB
    """One metadata or statistics record."""
    image_pixels: int = Field(default=16_000_000, ge=1, le=1 << 26)
    """One image, by the dimensions in its header, before it is decoded; OpenCV itself is held to 2^26."""
    image_bytes: Size = 32 * MIB
    """One compressed image."""
    message_bytes: Size = 1 * MIB
    """One message that is no image: joints, transforms and the like hold a few kilobytes."""
    json_bytes: Size = 16 * MIB
    """One JSON message; parsing can take thirty times its size in memory."""


class ColourRegion(StrictModel):
    """An HSV box in OpenCV's 8-bit units (H 0–179, S and V 0–255), bounds included, and its area gate.

    A hue range with first > last wraps around 0, as red does.
    """

    hue: tuple[Hue, Hue]
    saturation: tuple[Byte, Byte] = (0, 255)
    value: tuple[Byte, Byte] = (0, 255)
    min_area_px: int = Field(ge=1)
    components: Literal["all", "largest"] = "all"
    """`all`: every connected part above the gate belongs to the region, since an instrument that crosses
    an organ cuts its region in two. `largest`: one part only."""
    occlusion: Literal["none", "hull", "outline"] = "none"
    """Where the centroid is taken when an instrument hides a part: of the visible pixels (`none`), of their
    convex hull (`hull`), or of a smooth outline fitted to what of it is visible (`outline`)."""

    @model_validator(mode="after")
    def _ordered(self) -> ColourRegion:
        for name, (first, last) in (("saturation", self.saturation), ("value", self.value)):
            if first > last:
                raise ValueError(f"{name} = [{first}, {last}] is empty: the first bound is above the last")
        return self


class Segmentation(StrictModel):
    """How tissue and instrument are told apart from the rest of the image."""

    tissue: ColourRegion
    instrument: ColourRegion
    shaft: ColourRegion | None = None
    """The instrument's dark shaft, which comes in from the border; the method `shaft` looks for it."""


class Marker(StrictModel):
    """The static virtual marker (SVM): its size and the colour of the outline drawn around it."""

    size_px: int = Field(default=96, ge=48, le=256)
    outline: ColourRegion
    outline_bgr: tuple[Byte, Byte, Byte]
    outline_width_px: int = Field(default=3, ge=1, le=15)


class Features(StrictModel):
    """ORB, matching and homography, with the paper's values as defaults."""

    feature_count: int = Field(default=1500, ge=50, le=20000)
    ratio: float = Field(default=0.75, gt=0.0, lt=1.0)
    reprojection_px: float = Field(default=3.0, gt=0.0)
    min_match_count: int = Field(default=10, ge=4)


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


Rotation = tuple[tuple[float, float, float], tuple[float, float, float], tuple[float, float, float]]


def _require_rotation(name: str, rotation: Rotation) -> None:
    R = np.array(rotation)
    if not np.allclose(R @ R.T, np.eye(3), atol=1e-6) or np.linalg.det(R) < 0:
        raise ValueError(f"{name} is not a rotation: R R^T = I and det R = 1 are expected")


class Robot(StrictModel):
    """The kinematic chain from base to tool."""

    convention: Literal["standard", "modified"] = "standard"
    joints: tuple[Joint, ...] = Field(min_length=1)
    tool_rotation: Rotation | None = None

    @model_validator(mode="after")
    def _sound(self) -> Robot:
        names = [name for joint in self.joints for name in (joint.name, *joint.aliases)]
        doubles = sorted({name for name in names if names.count(name) > 1})
        if doubles:
            raise ValueError(f"joint names must differ; given twice: {', '.join(doubles)}")
        if self.tool_rotation is not None:
            _require_rotation("tool_rotation", self.tool_rotation)
        return self

    @property
    def T_last_tool(self) -> Array:
        """The constant transform behind the last row, shape (4, 4)."""
        T = np.eye(4)
        if self.tool_rotation is not None:
            T[:3, :3] = self.tool_rotation
        return T


class KinematicError(StrictModel):
    """How wrong the robot's kinematics may be: standard deviations of constant errors, and how they drift.

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


class Instrument(StrictModel):
    """The instrument's shape, in m, about the tool frame: what the simulation builds and clearance needs."""

    shaft_radius_m: Length
    shaft_length_m: Length
    shaft_end_m: Length | None = None
    """From the wrist's hinge back to where the dark shaft visibly ends; None: 2.2 radii of the wrist."""
    wrist_radius_m: Length
    knuckle_radius_m: Length
    jaw_length_m: Length
    jaw_radius_m: Length


class Fiducial(StrictModel):
    """A tag on a plate that a link of the instrument carries.

    The tag's frame is OpenCV's: origin in the middle of the black square, x to the right and y up as one
    reads the tag, z out of the plate towards who reads it.
    """

    family: Literal["16h5", "25h9", "36h10", "36h11"] = "36h11"
    """The AprilTag family."""
    id: int = Field(default=0, ge=0)
    size_m: Length
    """Side of the black square; the white margin around it is not in it."""
    link: str
    """The joint whose DH frame carries the plate."""
    position_m: tuple[float, float, float]
    rotation: Rotation = ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0))

    @model_validator(mode="after")
    def _sound(self) -> Fiducial:
        _require_rotation("rotation", self.rotation)
        return self

    @property
    def T_link_tag(self) -> Array:
        """Where the tag is on its link, shape (4, 4)."""
        return make_transform(self.rotation, self.position_m)


class Dome(StrictModel):
    """A dome over the tissue's outline: height h (1 - g^a)^b at gauge g, 0 in the middle and 1 on the outline.

    The defaults make half an ellipsoid. The outline itself comes from the image.
    """

    height_m: Length
    gauge_exponent: float = Field(default=2.0, ge=1.0, le=20.0)
    height_exponent: float = Field(default=0.5, gt=0.0, le=2.0)


class Tissue(StrictModel):
    """The plane that the tissue lies on, measured in the camera frame, and its shape above that plane.

    The plane holds the points with `plane_normal` · p = -`plane_distance_m`: its normal points to the camera's
    side. Without a dome the plane itself is the surface.
    """

    plane_normal: tuple[float, float, float] = (0.0, 0.0, -1.0)
    plane_distance_m: Length
    plane_distance_std_m: float = Field(default=0.0, ge=0.0)
    plane_tilt_std_rad: float = Field(default=0.0, ge=0.0)
    """Standard deviation of the normal's direction about each of two axes."""
    dome: Dome | None = None
    surface_std_m: float = Field(default=0.0, ge=0.0)
    """How far the shape stands off the real surface, as a standard deviation."""

    @model_validator(mode="after")
    def _sound(self) -> Tissue:
        if abs(float(np.linalg.norm(self.plane_normal)) - 1.0) > 1e-6:
            raise ValueError("plane_normal must have length 1")
        return self


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
    stereo_baseline_m: Length = 0.005
    """How far the right camera stands from the left one, along its x axis: that of a da Vinci's endoscope."""


class Profile(StrictModel):
    """A whole profile."""

    name: str
    description: str = ""
    calibration: str | None = None
    """File name of the calibration that ships beside this profile."""
    topics: Topics = Topics()
    frames: Frames = Frames()
    limits: Limits = Limits()
    segmentation: Segmentation
    marker: Marker
    features: Features = Features()
    robot: Robot | None = None
    kinematic_error: KinematicError = KinematicError()
    instrument: Instrument | None = None
    fiducial: Fiducial | None = None
    tissue: Tissue | None = None
    simulation: Simulation | None = None

    @model_validator(mode="after")
    def _fiducial_has_a_link(self) -> Profile:
        if self.fiducial is not None and self.robot is not None:
            links = [joint.name for joint in self.robot.joints]
            if self.fiducial.link not in links:
                choices = did_you_mean(self.fiducial.link, links)
                raise ValueError(f"fiducial.link: no joint named {self.fiducial.link}: {choices}")
        return self


def shipped_profiles() -> tuple[str, ...]:
    """Names of the profiles inside the package."""
    folder = resources.files("svmdist.profiles")
    return tuple(
        sorted(
            entry.name.removesuffix(".toml")
            for entry in folder.iterdir()
            if entry.name.endswith(".toml") and not entry.name.endswith(".calibration.toml")
        )
    )


def load_profile(name_or_path: str | Path = DEFAULT_PROFILE) -> Profile:
    """Read a profile that ships (by name) or one of the user's own (by path), and check it.

    Raises ProfileError that names the file, the key and the nearest valid key.
    """
    return parse_toml(profile_path(name_or_path), Profile, ProfileError)


def profile_path(name_or_path: str | Path) -> Path:
    """Find the file of a profile: a shipped name, else a path."""
    text = str(name_or_path)
    if text in shipped_profiles():
        return Path(str(resources.files("svmdist.profiles") / f"{text}.toml"))
    path = Path(text)
    if not path.suffix and not path.exists():
        raise ProfileError(
            f"no profile named {text}: {did_you_mean(text, shipped_profiles())}; or give a path to a .toml"
        )
    return path


def parse_toml(path: Path, model: type[Model], error: type[SvmdistError]) -> Model:
    """Read a TOML file into a model; every problem becomes one line that names the file and the key."""
    try:
        data = tomllib.loads(path.read_text("utf-8"))
    except OSError as problem:
        raise error(f"{path}: cannot read: {problem.strerror or problem}") from None
    except UnicodeDecodeError as problem:
        raise error(f"{path}: not a TOML file: byte {problem.start} is not UTF-8") from None
    except tomllib.TOMLDecodeError as problem:
        raise error(f"{path}: not a TOML file: {problem}") from None
    try:
        return model.model_validate(data)
    except ValidationError as problem:
        raise error(f"{path}: {'; '.join(_describe(problem, model))}") from None


def _describe(problem: ValidationError, model: type[BaseModel]) -> Iterator[str]:
    for item in problem.errors(include_url=False):
        location = item["loc"]
        key = ".".join(str(part) for part in location)
        if item["type"] == "extra_forbidden":
            siblings = _model_at(model, location[:-1])
            fields = siblings.model_fields if siblings else {}
            choices = [field.alias or name for name, field in fields.items()]
            yield f"unknown key {key}: {did_you_mean(str(location[-1]), choices)}"
        elif item["type"] == "missing":
            yield f"missing key {key}"
        else:
            message = item["msg"].removeprefix("Value error, ")
            yield f"{key or 'file'}: {message} (found {_short(item['input'])})" if key else message


def _short(value: Any) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


def _model_at(model: type[BaseModel], location: tuple[int | str, ...]) -> type[BaseModel] | None:
    """Find the model class that a location inside a document is checked by."""
    current: Any = model
    for part in location:
        if isinstance(part, int):
            continue
        if not (isinstance(current, type) and issubclass(current, BaseModel)):
            return None
        annotation = current.model_fields[part].annotation if part in current.model_fields else None
        current = next(_models_in(annotation), None)
    return current if isinstance(current, type) else None


def _models_in(annotation: Any) -> Iterator[type[BaseModel]]:
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    for argument in getattr(annotation, "__args__", ()):
        yield from _models_in(argument)
