"""The scene profile (TOML), with everything that depends on a scene: another scene needs no other code."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Any

from pydantic import Field, model_validator

from svmdist.errors import ProfileError, UsageError, did_you_mean, restated
from svmdist.files import nearest_file
from svmdist.profile import robot as parts
from svmdist.profile.hand_eye import HandEye, HandEyeFile, NamedHandEye, load_hand_eye, with_hand_eye
from svmdist.profile.segmentation import AnySegmentation, AutoSegmentation, ColourRegion
from svmdist.profile.settings import Settings, StereoSettings, without_former_keys
from svmdist.profile.toml import Byte, Positive, Share, Size, StrictModel, parse_toml
from svmdist.transforms import FrameName

DEFAULT_PROFILE = "psm13"
SHIPPED = Path(__file__).parent.with_name("profiles")
GUESSED_RADIUS, GUESSED_PLANE_M = 0.1, 0.02  # deviations from which on they are guesses
BEHIND_PLANE = 1.5  # the range of stereo over the distance of the plane that the tissue lies on


class Topics(StrictModel):
    """Topic names of a log; None means: the one topic whose schema fits."""

    image: str | None = None
    camera_info: str | None = None
    right_image: str | None = None  # must be named, as its camera's and the true transforms: their schemas fit others
    right_camera_info: str | None = None
    joints: str | None = None
    pose: str | None = None
    tf: str | None = None
    ground_truth_tf: str | None = None
    ground_truth_distance: str | None = None


class Frames(StrictModel):
    """Frame names of a log's transforms."""

    camera: FrameName = "camera"
    base: FrameName = "base"
    tool: FrameName = "tool"
    tissue: FrameName = "tissue"


class Limits(StrictModel):
    """What a log may ask of the reader, checked before memory is allocated; what asks for more is a loss."""

    record_bytes: Size = 256 << 20  # one record of the file; it may never reach beyond the file either
    chunk_bytes: Size = 256 << 20  # one chunk after expansion; it must have exactly the size that it declares
    window_bytes: Size = 128 << 20  # that a zstd frame may claim for its window, beside the expanded chunk
    image_pixels: int = Field(default=16_000_000, ge=1, le=1 << 26)  # by the header, before decoding; OpenCV takes 2^26
    image_bytes: Size = 32 << 20  # one compressed image
    message_bytes: Size = 1 << 20  # one message that is no image: joints and the like hold a few kilobytes
    pair_tolerance_s: float = Field(default=5e-4, ge=0.0, le=0.5)
    """How far the stamps of the left and the right image of a pair may be apart. Cameras that are triggered together
    differ by less than half a millisecond, which is less than any exposure; others by up to half a frame."""


class Marker(StrictModel):
    """The static virtual marker (SVM): its size and the colour of the outline drawn around it (pure green)."""

    size_px: int = Field(default=96, ge=48, le=256)
    outline: ColourRegion = ColourRegion(
        hue=(58, 62), saturation=(250, 255), value=(250, 255), min_area_px=100, components="largest"
    )
    outline_bgr: tuple[Byte, Byte, Byte] = (0, 255, 0)
    outline_width_px: int = Field(default=3, ge=1, le=15)

    def _require_sound(self) -> None:
        if len(self.model_fields_set & {"outline", "outline_bgr"}) == 1:
            found = "outline_bgr is drawn and outline finds it again"
            raise ValueError(f"{found}: give both of them, or neither for pure green")


class Features(StrictModel):
    """ORB, matching and homography, with the paper's values as defaults."""

    feature_count: int = Field(default=1500, ge=50, le=20000)
    ratio: Share = 0.75
    reprojection_px: Positive = 3.0
    min_match_count: int = Field(default=10, ge=4)


class Profile(StrictModel):
    """A whole profile."""

    name: str
    description: str = ""
    calibration: str | None = None  # file name of the calibration that ships beside this profile
    hand_eye: NamedHandEye | None = None  # a file of `svmdist hand-eye`: camera-to-base transforms in the log's place
    topics: Topics = Topics()
    frames: Frames = Frames()
    limits: Limits = Limits()
    segmentation: AnySegmentation
    marker: Marker = Marker()
    features: Features = Features()
    robot: parts.Robot | None = None
    kinematic_error: parts.KinematicError = parts.KinematicError()
    camera_error: parts.CameraError = parts.CameraError()
    instrument: parts.Instrument | None = None
    fiducial: parts.Fiducial | None = None
    tissue: parts.Tissue | None = None
    field: parts.FieldOfView = parts.FieldOfView()
    simulation: parts.Simulation | None = None
    settings: Settings = Settings()  # what detectors and estimators may assume; the defaults serve most logs
    instrument_name: str = Field(default="PSM1", min_length=1)  # of what everything above is about
    entry: parts.EntrySide | None = None  # the side that it comes in from, needed without joints
    other_instruments: tuple[parts.OtherInstrument, ...] = ()

    @model_validator(mode="before")
    @classmethod
    def _without_former_keys(cls, data: Any) -> Any:
        return without_former_keys(data) if isinstance(data, dict) else data

    @property
    def stereo_in_range(self) -> StereoSettings:
        """The settings of stereo, their range as far as the profile's plane asks for it."""
        settings = self.settings.stereo
        far_m = 0.0 if self.tissue is None else BEHIND_PLANE * self.tissue.plane_distance_m
        return settings.model_copy(update={"far_m": max(settings.far_m, far_m)})

    @property
    def guesses(self) -> str:
        """What was guessed, so that distances are as uncertain, with its deviation; empty without any."""
        found: list[str] = []
        if self.instrument and self.instrument.shaft_radius_std_fraction > GUESSED_RADIUS:
            found.append(f"shaft_radius_m to {self.instrument.shaft_radius_std_fraction:.0%}")
        if self.tissue and self.tissue.plane_distance_std_m > GUESSED_PLANE_M:
            found.append(f"plane_distance_m to {self.tissue.plane_distance_std_m * 1e3:.0f} mm")
        return ", ".join(found)

    @property
    def instrument_names(self) -> tuple[str, ...]:
        """The instrument and the others, in the order of the profile."""
        return self.instrument_name, *(other.name for other in self.other_instruments)

    def for_instrument(self, name: str) -> Profile:
        """The profile as one of its instruments sees it, without the others; raises UsageError that lists the names."""
        update: dict[str, object] = {"other_instruments": ()}
        if name != self.instrument_name:
            other = next((other for other in self.other_instruments if other.name == name), None)
            if other is None:
                known = did_you_mean(name, self.instrument_names)
                raise UsageError(f"profile {self.name} has no instrument {name}: {known}")
            topics = {role: other.logged_topics.get(role) for role in parts.ARM_TOPICS}
            frames = other.frames or parts.ArmFrames(base=f"{name}_base", tool=name)
            update |= {
                "topics": self.topics.model_copy(update=topics),
                "frames": self.frames.model_copy(update=frames.model_dump()),
                "instrument_name": name,
                "entry": other.entry,
                "robot": other.robot or self.robot,
                "instrument": other.instrument or self.instrument,
            }
            if self.fiducial is not None:
                tag = None if other.fiducial_id is None else {"id": other.fiducial_id}
                update["fiducial"] = tag and self.fiducial.model_copy(update=tag)
            if other.simulation is not None and self.simulation is not None:
                update["simulation"] = self.simulation.model_copy(update=other.simulation.model_dump())
        return with_hand_eye(self.model_copy(update=update))

    @property
    def camera_to_base(self) -> HandEye | None:
        """The camera-to-base transform of this profile's own instrument; None where no hand-eye file has it."""
        return None if self.hand_eye is None else self.hand_eye.of(self.instrument_name)

    def _require_sound(self) -> None:
        if self.hand_eye is not None:
            self.check_hand_eye(self.hand_eye)
        self._require_instruments_that_differ()
        link = self.fiducial.link if self.fiducial else None
        first = self.kinematic_error.first_moving_joint
        for robot in (self.robot, *(other.robot for other in self.other_instruments)):
            joints = robot.joints if robot else ()
            moving = [joint.name for joint in joints if joint.type != "fixed"]
            links = ("fiducial.link", link, [joint.name for joint in joints])
            for key, name, known in (links, ("kinematic_error.first_moving_joint", first, moving)):
                if robot and name is not None and name not in known:
                    raise ValueError(f"{key}: no joint named {name}: {did_you_mean(name, known)}")

    def check_hand_eye(self, file: HandEyeFile) -> None:
        """Raise ValueError where the hand-eye file is of other frames, or of none of the instruments."""
        if not any(file.of(name) for name in self.instrument_names):
            theirs, ours = ", ".join(one.instrument for one in file.transforms), self.instrument_names
            raise ValueError(f"hand_eye: it is for {theirs}; the profile has {', '.join(ours)}: fit it anew")
        for name in dict.fromkeys(self.instrument_names):
            frames, found = self.for_instrument(name).frames, file.of(name)
            for what in ("camera", "base") if found is not None else ():
                fitted, own = getattr(found, what), getattr(frames, what)
                if fitted != own:
                    said = f"hand_eye: it is for {what} {fitted} of {name}"
                    raise ValueError(f"{said}; [frames] {what} is {own}: fit it anew")

    def _require_instruments_that_differ(self) -> None:
        views = [self.for_instrument(name) for name in dict.fromkeys(self.instrument_names)]
        tags = [view.fiducial for view in views if view.fiducial is not None]
        for tag in tags:
            last = parts.TAGS[tag.family][0] - 1
            if tag.id > last:
                raise ValueError(f"fiducial: family {tag.family} has the tags 0 to {last}, found {tag.id}")
        unknown = [other.name for other in self.other_instruments if other.topics is None]
        if unknown and not isinstance(self.segmentation, AutoSegmentation):
            needed = "which needs [segmentation] method = 'auto'"
            raise ValueError(f"other_instruments: {unknown[0]} has no topics, {needed}")
        distinct = {
            "name": list(self.instrument_names),
            "topic": [getattr(view.topics, role) for view in views for role in parts.ARM_TOPICS],
            "frame": [frame for view in views for frame in (view.frames.base, view.frames.tool)],
            "fiducial_id": [str(tag.id) for tag in tags],
        }
        for what, values in distinct.items() if self.other_instruments else ():
            doubles = ", ".join(sorted({one for one in values if one is not None and values.count(one) > 1}))
            if doubles:
                needed = f"every instrument needs a {what} of its own"
                raise ValueError(f"other_instruments: {needed}; given twice: {doubles}")


def shipped_profiles() -> tuple[str, ...]:
    """Names of the profiles inside the package."""
    return tuple(sorted(path.stem for path in SHIPPED.glob("*.toml") if "." not in path.stem))


def load_profile(name_or_path: str | Path = DEFAULT_PROFILE, hand_eye: Path | None = None) -> Profile:
    """Read a profile that ships (by name) or another (by path), with this hand-eye file; ProfileError names the key."""
    profile = parse_toml(profile_path(name_or_path), Profile, ProfileError)
    return profile if hand_eye is None else taking_hand_eye(profile, hand_eye)


def taking_hand_eye(profile: Profile, hand_eye: Path) -> Profile:
    """The profile with a hand-eye file in place of its own; ProfileError where it is not one of this profile."""
    file = load_hand_eye(hand_eye)
    with restated(ValueError, ProfileError, f"{hand_eye}: "):
        profile.check_hand_eye(file)
    return profile.model_copy(update={"hand_eye": file})


def profile_path(name_or_path: str | Path) -> Path:
    """Find the file of a profile: a shipped name, else a path."""
    path, text = Path(name_or_path), str(name_or_path)
    if text in shipped_profiles():
        return SHIPPED / f"{text}.toml"
    if not path.suffix and not os.path.exists(path):
        known = did_you_mean(text, shipped_profiles())
        raise ProfileError(f"no profile named {text}: {known}; or give a path to a .toml")
    if not os.path.lexists(path):
        is_toml = path.suffix.lower() == ".toml"
        made = f"; `svmdist profile new LOG -o {path}` writes one" if is_toml else "; a profile is a .toml"
        raise ProfileError(f"{path}: no such file{nearest_file(path) or made}")
    return path
