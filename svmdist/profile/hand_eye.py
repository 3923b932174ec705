"""The hand-eye file (TOML): camera-to-base transforms, how certain they are, and what they were fitted on."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import tomli_w
from pydantic import BeforeValidator, Field, ValidationInfo

from svmdist.errors import ProfileError, restated
from svmdist.files import write_atomically
from svmdist.profile.robot import KinematicError, Rotation, Vector
from svmdist.profile.toml import NonNegative, Positive, StrictModel, parse_toml
from svmdist.transforms import Array, make_transform, skew

if TYPE_CHECKING:
    from svmdist.profile import Profile

FORMAT: Literal["svmdist.hand-eye/1"] = "svmdist.hand-eye/1"
FOCAL_LENGTH, PRINCIPAL_POINT, BASELINE = "focal length", "principal point", "baseline"
SHAFT_RADIUS, TAG_SIZE, TIME_OFFSET = "shaft radius", "tag size", "time offset"
OFFSET, LENGTH = "offset of {}", "length {}"  # of a joint by its name; of the chain, counted from 1
Six = tuple[float, float, float, float, float, float]


class ConstantEffect(StrictModel):
    """What one deviation of a calibration parameter's error does to a fitted transform: (δt, δφ), in m and rad."""

    constant: str = Field(min_length=1)
    deviation: Positive  # its standard deviation at the fit
    effects: tuple[Six, ...] = Field(min_length=1)  # a parameter of several numbers has one row for each


class HandEye(StrictModel):
    """`T_camera_base` of one instrument; its error (δt, δφ) makes it t + δt in m, exp([δφ]) R, in the camera's axes."""

    instrument: str = Field(min_length=1)
    camera: str
    base: str
    rotation: Rotation
    translation_m: Vector
    covariance: tuple[Six, Six, Six, Six, Six, Six]
    method: str = ""  # that measured the tool
    reference: str = ""  # what it was compared with: kinematics of the joints, or recorded poses
    frame_count: int = Field(default=0, ge=0)
    inlier_count: int = Field(default=0, ge=0)
    residual_rms_m: NonNegative = 0.0
    constants: tuple[ConstantEffect, ...] = ()  # the error's part by calibration parameters, which estimators use too

    def _require_sound(self) -> None:
        C = np.array(self.covariance)
        if not np.allclose(C, C.T, rtol=1e-6, atol=1e-15) or np.linalg.eigvalsh(C)[0] < -1e-12:
            raise ValueError("covariance must be symmetric and have no negative eigenvalue")

    @property
    def T_camera_base(self) -> Array:
        """The transform, shape (4, 4)."""
        return make_transform(self.rotation, self.translation_m)

    def covariance_at(self, p_camera_m: Array) -> Array:
        """Covariance of (translation, rotation), shape (6, 6), carried to a point of the camera frame, (3,)."""
        J = self._carried_to(p_camera_m)
        return np.asarray(J @ np.array(self.covariance) @ J.T)

    def effects_at(self, p_camera_m: Array) -> dict[str, Array]:
        """The same of each calibration parameter's effects, shape (6, k), by its name."""
        J = self._carried_to(p_camera_m)
        return {one.constant: J @ np.array(one.effects).T for one in self.constants}

    def with_deviations(self, prior: Mapping[str, float]) -> HandEye:
        """With the calibration parameters' deviations of now; one without counts as independent of all else."""
        covariance, constants = np.array(self.covariance), []
        for one in self.constants:
            if (deviation := prior.get(one.constant)) is None:
                continue
            scale, effects = deviation / one.deviation, np.array(one.effects)
            covariance += (scale**2 - 1.0) * effects.T @ effects
            if deviation > 0.0:
                scaled = (scale * effects).tolist()
                constants.append(ConstantEffect(constant=one.constant, deviation=deviation, effects=scaled))
        update = {"covariance": covariance.tolist(), "constants": tuple(constants)}
        return HandEye.model_validate(self.model_dump() | update)

    def _carried_to(self, p_camera_m: Array) -> Array:
        J = np.eye(6)
        J[:3, 3:] = -skew(p_camera_m - np.array(self.translation_m))
        return J


class Source(StrictModel):
    """A log that was fitted on."""

    name: str
    sha256: str


class HandEyeFile(StrictModel):
    """A whole file."""

    format: Literal["svmdist.hand-eye/1"]
    sources: tuple[Source, ...] = ()
    transforms: tuple[HandEye, ...] = Field(min_length=1)

    def _require_sound(self) -> None:
        names = [one.instrument for one in self.transforms]
        if len(set(names)) < len(names):
            raise ValueError(f"an instrument with two transforms: {', '.join(names)}")

    def of(self, instrument: str) -> HandEye | None:
        """The transform of an instrument's base; None where the file has none."""
        return next((one for one in self.transforms if one.instrument == instrument), None)


class HandEyeError(KinematicError):
    """Kinematic errors with the camera-to-base transform, and its covariance, of a hand-eye file."""

    hand_eye: HandEye


def prior_deviations(profile: Profile) -> dict[str, float]:
    """Standard deviations of all calibration parameters by name: in m, rad, s, px, or fractions of themselves."""
    camera, kinematic = profile.camera_error, profile.kinematic_error
    found = {
        FOCAL_LENGTH: camera.focal_std_fraction,
        PRINCIPAL_POINT: camera.centre_std_px,
        BASELINE: camera.baseline_std_fraction,
        TIME_OFFSET: kinematic.time_offset_std_s,
    }
    if profile.instrument is not None:
        found[SHAFT_RADIUS] = profile.instrument.shaft_radius_std_fraction
    if profile.fiducial is not None:
        found[TAG_SIZE] = profile.fiducial.size_std_fraction
    for index, joint in enumerate(profile.robot.joints if profile.robot else ()):
        slides = joint.type == "prismatic"
        found[OFFSET.format(joint.name)] = kinematic.joint_std_m if slides else kinematic.joint_std_rad
        # A row has two lengths at most.
        found |= {LENGTH.format(number): kinematic.length_std_m for number in (2 * index + 1, 2 * index + 2)}
    return found


def with_hand_eye(profile: Profile) -> Profile:
    """The profile with its instrument's hand-eye covariance in place of the transform's; the same without one."""
    if (found := profile.camera_to_base) is None:
        return profile
    found = found.with_deviations(prior_deviations(profile))
    std_rad = float(np.sqrt(max(np.linalg.eigvalsh(np.array(found.covariance)[3:, 3:])[-1], 0.0)))
    values = profile.kinematic_error.model_dump() | {"camera_base_std_rad": std_rad, "hand_eye": found}
    return profile.model_copy(update={"kinematic_error": HandEyeError(**values)})


def load_hand_eye(path: Path) -> HandEyeFile:
    """Read a hand-eye file; raises ProfileError in one line."""
    return parse_toml(path, HandEyeFile, ProfileError)


def save_hand_eye(path: Path, file: HandEyeFile) -> None:
    """Write a hand-eye file atomically; raises OutputError where that fails."""
    note = "# Camera-to-base transforms, by `svmdist hand-eye`; covariance of (t, rotation vector).\n"
    write_atomically(path, [note, tomli_w.dumps(file.model_dump(mode="json"))])


def _read(value: Any, info: ValidationInfo) -> Any:
    """What a file that a profile names holds; a relative name starts from the profile's folder."""
    if not isinstance(value, str | Path):
        return value
    with restated(ProfileError, ValueError):
        return load_hand_eye(Path(info.context["folder"] if info.context else "") / value)


NamedHandEye = Annotated[HandEyeFile, BeforeValidator(_read)]
