"""What is asked of logs: how they are read, changed and measured, resolved and checked once."""

from __future__ import annotations

import copy
import logging
import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any, Literal, Protocol, get_args, runtime_checkable

import numpy as np

from svmdist.camera import Camera
from svmdist.errors import CalibrationError, UsageError, did_you_mean
from svmdist.estimation import plane_mapping
from svmdist.estimation.alarms import AlarmRules
from svmdist.estimation.frame import Frame, Needs
from svmdist.estimation.methods import METHODS, PLANAR_METHODS
from svmdist.estimation.tissue.detection import require_tissue
from svmdist.perturbations import UNPERTURBED, Perturbations, require_at_replay
from svmdist.perturbations.apply import perturbed_image, perturbed_right_view
from svmdist.profile import DEFAULT_PROFILE, Profile, load_profile, profile_path
from svmdist.recording.log import Recording, open_recording
from svmdist.recording.observations import ALL_IMAGES, Window
from svmdist.recording.topics import Role
from svmdist.remote import LogPath
from svmdist.results import FrameResult
from svmdist.samples import Image, Observation, Status
from svmdist.tracks import LagEstimate
from svmdist.vision import degradations
from svmdist.vision.frame_context import Segmenter, make_segmenter
from svmdist.workflows.scoring.references import ANY_TRUTH, TruthRules

REPLAY_SEED = 36
LEFT, RIGHT = 0, 1
BOTH_VIEWS = Needs(right_view=True)  # of a log, by an own method that does not say what it takes


@dataclass(frozen=True, slots=True)
class Condition:
    """What is done to a log before it is measured: its images are spoilt, or its world is not as log and profile say.

    Raises UsageError for a wrong name or severity, and for a world that cannot be that of a recorded log.
    """

    name: degradations.Degradation | degradations.Blur | None = None
    severity: int = 0  # of a degradation from 1 to 5; of one of the paper's blurs its kernel in px
    world: Perturbations = UNPERTURBED

    def __post_init__(self) -> None:
        if self.name is not None and not isinstance(self.name, degradations.Blur):
            degradations.require_degradation(self.name, self.severity)
        require_at_replay(self.world)

    def __str__(self) -> str:
        return str(self.world) if self.name is None else f"{self.name}={self.severity}"

    def apply(self, observation: Observation, frame: int) -> Observation:
        """Change the images of the n-th frame: the same frame of the same log always alike."""
        image_bgr, right = observation.image_bgr, observation.right
        if self.world:  # whose joints and calibration are those of `Recording.perturbed`
            right = right and perturbed_right_view(right, self.world)
            image_bgr = perturbed_image(image_bgr, self.world)
        elif self.name is not None:
            # The image itself tells logs apart, whatever their names and order. The severity plays no part: glints
            # and plumes of one are those of the next, only more of them.
            content = zlib.crc32(np.ascontiguousarray(image_bgr).data)
            right = right and replace(right, image_bgr=self._spoilt(right.image_bgr, RIGHT, frame, content))
            image_bgr = self._spoilt(image_bgr, LEFT, frame, content)
        return replace(observation, image_bgr=image_bgr, right=right)

    def _spoilt(self, image_bgr: Image, side: int, frame: int, content: int) -> Image:
        if isinstance(self.name, degradations.Blur):
            return degradations.apply_blur(image_bgr, self.name, self.severity)
        kind = degradations.Degradation(str(self.name))
        path = (REPLAY_SEED, list(degradations.Degradation).index(kind), frame, content)
        return degradations.degrade(image_bgr, kind, self.severity, degradations.image_seed(kind, side, *path))


CLEAN = Condition()
Lag = float | Literal["auto"]  # a lag in s, positive when the image stamps are late, or `auto` to estimate it

LOG = logging.getLogger("svmdist")
"""Messages beside the data: errors, then remarks (INFO), then choices and times (DEBUG)."""


@runtime_checkable
class OwnMethod(Protocol):
    """Anything with `estimate(frame)`, with a `name` for results, and with what `for_log(recording)` gives of a log."""

    def estimate(self, frame: Frame) -> FrameResult:
        """Measure one frame; one that cannot be measured is a result with a status that says why."""


class OwnEstimator:
    """An own method as the replay takes it: each instrument has a copy, and frames come in the order of the log."""

    keeps_state = True

    def __init__(self, method: OwnMethod) -> None:
        self.name = str(getattr(method, "name", type(method).__name__))
        self.needs: Needs = getattr(method, "needs", BOTH_VIEWS)
        self._method = copy.deepcopy(method)

    def estimate(self, frame: Frame) -> FrameResult:
        """Measure one frame; raises TypeError for what is no result."""
        result = self._method.estimate(frame)
        if not isinstance(result, FrameResult):
            raise TypeError(f"{self.name}.estimate(frame): expected a FrameResult, found {type(result).__name__}")
        d = result.distances
        numbers = [one.value_m for one in (d.planar, d.spatial, d.clearance, d.to_instrument) if one is not None]
        numbers += [] if result.tool is None else result.tool.pose.position_m.tolist()
        if result.measured and not (numbers and np.isfinite(numbers).all()):
            return result.rejected(Status.NOT_FINITE, f"{self.name} says ok, without a number")
        return result


@dataclass(frozen=True)
class Setup:
    """Everything that turns a recording into results. Make it with `prepare`."""

    profile: Profile
    method: str
    equations: plane_mapping.Equations = "corrected"
    calibration: plane_mapping.Calibration | None = None
    mapping: plane_mapping.PlaneMapping | None = None
    """From pixels to the paper's plane: as published, or the calibration's; None for a method in 3D."""
    own: OwnMethod | None = None  # a user's, in place of one of svmdist's

    @staticmethod
    def reading(profile: str, hand_eye: Path | None = None) -> Setup:
        """A setup by which logs are read, and nothing is measured; raises ProfileError."""
        return Setup(load_profile(profile, hand_eye), "kinematic")

    @cached_property
    def segmenter(self) -> Segmenter:
        """What segments tissue and instrument; raises ProfileError where its network cannot be used."""
        return make_segmenter(self.profile.segmentation, self.profile.settings.auto)

    @property
    def is_planar(self) -> bool:
        """Whether the method measures in the paper's plane."""
        return self.own is None and self.method in PLANAR_METHODS

    @property
    def is_given(self) -> bool:
        """Whether its rows are estimates of others, which no image refutes."""
        return bool(getattr(self.own, "is_given", False))

    @property
    def needs_right_view(self) -> bool:
        """Whether the method measures by both views."""
        own: Needs = getattr(self.own, "needs", BOTH_VIEWS)
        return self.method in ("stereo", "fused") if self.own is None else own.right_view

    def require_camera(self, recording: Recording) -> None:
        """Raise CalibrationError for a recording of another camera than the calibration's."""
        if self.calibration is not None:
            self.calibration.require_camera(recording.logged_camera, recording.name)

    def for_log(self, recording: Recording) -> Setup:
        """The same with an own method as it is for a log; raises what that raises."""
        bind: Callable[[Recording], OwnMethod] | None = getattr(self.own, "for_log", None)
        return self if bind is None else replace(self, own=bind(recording))

    def knowing(self, lag: LagEstimate | None) -> Setup:
        """The same where the offset between joints and images is known: it may be wrong by what is left of it."""
        if lag is None:
            return self
        std_s = math.hypot(self.profile.settings.filter.given_lag_std_s, lag.std_s or 0.0)
        error = self.profile.kinematic_error.model_copy(update={"time_offset_std_s": std_s})
        return replace(self, profile=self.profile.model_copy(update={"kinematic_error": error}))

    def with_stds(self, part: Literal["tissue", "camera_error"], **stds: float) -> Setup:
        """The same where numbers of a part of the profile have additional standard deviations."""
        prior = getattr(self.profile, part)
        both = {name: math.hypot(getattr(prior, name), std) for name, std in stds.items()}
        changed: dict[str, Any] = {part: prior.model_copy(update=both)}
        return replace(self, profile=self.profile.model_copy(update=changed))

    def was_fitted_on(self, recording: Recording) -> bool:
        """Whether the calibration was fitted on this very recording: then its figures prove nothing."""
        sources = self.calibration.sources if self.calibration else ()
        return bool(sources) and recording.sha256() in {source.sha256 for source in sources}

    def degeneracies(self, camera: Camera) -> list[str]:
        """Sentences about where the equations cannot be right for this camera's image."""
        return plane_mapping.degeneracies(self.mapping, camera.width_px, camera.height_px) if self.mapping else []

    def __getstate__(self) -> dict[str, Any]:
        """Another process makes its own segmenter: a network cannot be sent there."""
        return {key: value for key, value in self.__dict__.items() if key != "segmenter"}


@dataclass(frozen=True)
class Request:
    """What a command does with each log: it travels to workers, and results depend on nothing else but the log."""

    setup: Setup
    topics: Mapping[str, str] = field(default_factory=dict)
    window: Window = ALL_IMAGES
    instruments: tuple[str, ...] | None = None  # None: all
    lag: Lag | None = None  # taken off the image stamps
    alarms: AlarmRules | None = None
    rules: TruthRules = ANY_TRUTH  # what estimates are scored by
    conditions: tuple[Condition, ...] = (CLEAN,)

    def open(self, path: LogPath, name: str) -> Recording:
        """Open a log under a name; raises RecordingError, or UsageError for an unknown role."""
        recording = open_recording(path, self.setup.profile, topics=dict(self.topics))
        recording = replace(recording, alias=name, window=self.window, wanted=self.instruments)
        found = [f"{role} {topic}" for role in Role if (topic := recording.topic_of(role))]
        LOG.debug("%s: %s: %s", name, path, ", ".join(found))
        return recording


def prepare(
    profile: str | Path | Profile = DEFAULT_PROFILE,
    method: str | OwnMethod = "overlay",
    equations: plane_mapping.Equations = "corrected",
    calibration: Path | None = None,
    hand_eye: Path | None = None,
) -> Setup:
    """Load what a measurement needs, by names and paths; a `Profile`, and an own method, are taken as they are.

    A planar method takes the given calibration, else the profile's, and the paper's `equations` corrected or printed;
    `hand_eye` is a file in place of the profile's. Raises ProfileError, CalibrationError or UsageError.
    """
    if isinstance(method, str) and method not in METHODS:
        raise UsageError(f"no method {method}: {did_you_mean(method, METHODS)}")
    if equations not in (known := get_args(plane_mapping.Equations)):
        raise UsageError(f"no equations {equations}: {did_you_mean(equations, known)}")
    loaded = profile if isinstance(profile, Profile) else load_profile(profile, hand_eye)
    if not isinstance(method, str):
        if not isinstance(method, OwnMethod):
            found = type(method).__name__
            raise UsageError(f"expected a method's name, or an object with estimate(frame); found {found}")
        return Setup(loaded, OwnEstimator(method).name, equations, own=method)
    is_planar, is_printed = method in PLANAR_METHODS, equations == "printed"
    if not is_planar and (is_printed or calibration is not None):
        option = "--equations printed" if is_printed else "--calibration"
        raise UsageError(f"{option} is for the planar methods {' and '.join(PLANAR_METHODS)}; {method} measures in 3D")
    if is_printed and calibration is not None:
        raise UsageError("--equations printed takes the paper's numbers: it cannot be used with a calibration")
    setup = Setup(loaded, method, equations, mapping=plane_mapping.PUBLISHED_MAPPING if is_printed else None)
    if is_planar and not is_printed:
        if calibration is None and loaded.calibration is None:
            remedy = "make one with `svmdist calibrate` and name it with --calibration"
            raise CalibrationError(f"profile {loaded.name} ships no calibration: {remedy}")
        # A profile in hand names no folder: its calibration is a shipped one, or is given.
        named = loaded.name if isinstance(profile, Profile) else profile
        found = plane_mapping.load_calibration(calibration or profile_path(named).parent / str(loaded.calibration))
        setup = replace(setup, calibration=found, mapping=plane_mapping.PlaneMapping("corrected", found.x, found.y))
    # A network or a mesh that cannot be used is reported before a recording is opened.
    _ = setup.segmenter
    if not is_planar:
        require_tissue(loaded)
    return setup


def prepare_methods(
    profile: str | Path | Profile,
    calibration: Path | None = None,
    hand_eye: Path | None = None,
    methods: Sequence[str] = (),
) -> tuple[Setup, ...]:
    """These methods, or every one that the profile serves, with a remark on others; raises what `prepare` does."""
    setups: tuple[Setup, ...] = ()
    for method in methods or METHODS:
        try:
            of_plane = calibration if method in PLANAR_METHODS else None
            setups += (prepare(profile, method, "corrected", of_plane, hand_eye),)
        except CalibrationError as problem:
            if methods:
                raise
            LOG.info("note: without %s: %s", method, problem)
    return setups
