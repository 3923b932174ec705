"""What a measurement is made with: profile, method, equations and calibration, resolved and checked once."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

from svmdist.camera import Camera
from svmdist.errors import CalibrationError, UsageError, did_you_mean
from svmdist.estimation.methods import METHODS, PLANAR_METHODS, Estimator, make_estimator
from svmdist.estimation.planar.calibration import Calibration, load_calibration
from svmdist.estimation.planar.equations import PUBLISHED_MAPPING, Equations, PlaneMapping, degeneracies
from svmdist.estimation.tissue.fix import require_tissue
from svmdist.profile import DEFAULT_PROFILE, Profile, load_profile, profile_path
from svmdist.recording.reader import Recording
from svmdist.vision.segmentation.segmenter import Segmenter, make_segmenter


@dataclass(frozen=True)
class Setup:
    """Everything that turns a recording into estimates. Make it with `prepare`."""

    profile: Profile
    method: str
    equations: Equations
    calibration: Calibration | None

    @property
    def mapping(self) -> PlaneMapping | None:
        """The mapping from pixels to the plane: printed as it stands, or the calibration's; None in 3D."""
        if self.equations == "printed":
            return PUBLISHED_MAPPING
        return self.calibration.mapping if self.calibration else None

    @cached_property
    def segmenter(self) -> Segmenter:
        """What tells tissue and instrument apart; raises ProfileError where its network cannot be used."""
        return make_segmenter(self.profile.segmentation, level=self.method not in PLANAR_METHODS)

    def estimator_for(self, recording: Recording, instrument: str | None = None) -> Estimator:
        """Make the estimator for a recording; raises CalibrationError for another camera.

        `instrument` names another one than the profile's own; all of them share the segmenter.
        """
        if self.equations == "corrected" and self.calibration is not None:
            self.calibration.require_camera(recording.camera, recording.name)
        profile = self.profile if instrument is None else self.profile.for_instrument(instrument)
        return make_estimator(self.method, profile, self.mapping, self.segmenter)

    def for_instrument(self, name: str) -> Setup:
        """The same for one of the profile's instruments."""
        return replace(self, profile=self.profile.for_instrument(name))

    def was_fitted_on(self, recording: Recording) -> bool:
        """Whether the calibration was fitted on this very recording: then its figures prove nothing."""
        if self.calibration is None or self.equations == "printed":
            return False
        return recording.sha256() in {source.sha256 for source in self.calibration.sources}

    def degeneracies(self, camera: Camera) -> list[str]:
        """Sentences about where the equations cannot be right for this camera's image."""
        return degeneracies(self.mapping, camera.width_px, camera.height_px) if self.mapping else []


def prepare(
    profile: str | Path = DEFAULT_PROFILE,
    method: str = "overlay",
    equations: Equations = "corrected",
    calibration: Path | None = None,
) -> Setup:
    """Load what a measurement needs, by names and paths.

    A planar method needs a calibration: the given one, else the one that ships beside the profile. A method
    that measures in 3D needs none, and knows no other equations. Raises ProfileError, CalibrationError or
    UsageError.
    """
    if method not in METHODS:
        raise UsageError(f"no method {method}: {did_you_mean(method, METHODS)}")
    if equations not in ("corrected", "printed"):
        raise UsageError(f"no equations {equations}: {did_you_mean(equations, ('corrected', 'printed'))}")
    loaded = load_profile(profile)
    setup = _resolve(profile, loaded, method, equations, calibration)
    # A network or a mesh that cannot be used is told before a recording is opened.
    _ = setup.segmenter
    if method not in PLANAR_METHODS:
        require_tissue(loaded)
    return setup


def _resolve(
    profile: str | Path, loaded: Profile, method: str, equations: Equations, calibration: Path | None
) -> Setup:
    if method not in PLANAR_METHODS:
        if equations == "printed" or calibration is not None:
            option = "--equations printed" if equations == "printed" else "--calibration"
            planar = " and ".join(PLANAR_METHODS)
            raise UsageError(f"{option} is for the planar methods {planar}; {method} measures in 3D")
        return Setup(loaded, method, equations, None)
    if equations == "printed":
        if calibration is not None:
            raise UsageError(
                "--equations printed takes the paper's numbers: it cannot be used with a calibration"
            )
        return Setup(loaded, method, equations, None)
    return Setup(loaded, method, equations, load_calibration(calibration or _beside(profile, loaded)))


def _beside(profile: str | Path, loaded: Profile) -> Path:
    if loaded.calibration is None:
        raise CalibrationError(
            f"profile {loaded.name} ships no calibration: make one with `svmdist calibrate` and name it with"
            " --calibration"
        )
    return profile_path(profile).parent / loaded.calibration
