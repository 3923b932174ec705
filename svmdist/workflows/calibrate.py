"""Calibrate: where the tool is seen, against where it truly is, to the quadratics of eqs. (5) and (6)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np

from svmdist.camera import Camera
from svmdist.errors import CalibrationError, UsageError
from svmdist.estimation.methods import PLANAR_METHODS
from svmdist.estimation.plane_mapping import (
    Calibration,
    CalibrationSamples,
    PlaneMapping,
    Quadratic,
    SourceFile,
    fit_calibration,
)
from svmdist.geometry.rays import pixel_rays
from svmdist.profile import Profile
from svmdist.recording.log import Recording
from svmdist.workflows.estimate import estimate
from svmdist.workflows.parallel import Progress, Steps, image_total
from svmdist.workflows.request import Setup

PIXELS_AS_THEY_ARE = PlaneMapping("corrected", Quadratic(0.0, 1.0, 0.0), Quadratic(0.0, 1.0, 0.0))
"""The estimator needs a mapping; calibration reads its pixels only."""


def calibrate(
    recordings: Sequence[Recording],
    profile: Profile,
    method: str = "overlay",
    on_progress: Progress | None = None,
) -> Calibration:
    """Fit a calibration to recordings with ground truth of the tool's position; `on_progress` is told of images.

    Raises CalibrationError for recordings of different cameras, too few frames or too little of the image
    covered, and RecordingError where a recording has no true tool pose.
    """
    if method not in PLANAR_METHODS:
        planar = " and ".join(PLANAR_METHODS)
        raise UsageError(f"a calibration is for the planar methods {planar}; {method} measures in 3D")
    if not recordings:
        raise CalibrationError("expected at least one recording to calibrate with, found none")
    camera = recordings[0].camera
    for recording in recordings:  # before the work
        require_same_camera(camera, recording.camera, recordings[0].name, recording.name)
    steps = Steps(on_progress, image_total(recordings))
    parts = [collect_part(recording, profile, method, steps=steps) for recording in recordings]
    return fit_parts(parts, method)


def require_same_camera(one: Camera, other: Camera, name: str, other_name: str) -> None:
    """Raise CalibrationError where two recordings are of different cameras."""
    if not one.same_optics(other):
        raise CalibrationError(
            f"recordings of different cameras cannot be calibrated together: {name} and {other_name} differ"
        )


@dataclass(frozen=True)
class CalibrationPart:
    """What one recording gives to a calibration: its samples, its camera, and what it is."""

    name: str
    file_name: str
    sha256: str
    camera: Camera
    samples: CalibrationSamples


def collect_part(
    recording: Recording,
    profile: Profile,
    method: str,
    jobs: int | None = None,
    steps: Steps | None = None,
) -> CalibrationPart:
    """Measure one recording for a calibration; `steps` hears of each image."""
    samples = collect_samples(recording, profile, method, steps, jobs)
    return CalibrationPart(recording.name, recording.path.name, recording.sha256(), recording.camera, samples)


def fit_parts(parts: Sequence[CalibrationPart], method: str) -> Calibration:
    """Fit a calibration to the samples of recordings; CalibrationError as for `calibrate`."""
    camera = parts[0].camera
    for part in parts:
        require_same_camera(camera, part.camera, parts[0].name, part.name)
    return fit_calibration(
        CalibrationSamples(
            np.concatenate([part.samples.tool_px for part in parts]),
            np.concatenate([part.samples.tool_m for part in parts]),
        ),
        camera,
        method,
        created_by=f"svmdist {version('svmdist')}",
        sources=tuple(SourceFile(name=part.file_name, sha256=part.sha256) for part in parts),
    )


def collect_samples(
    recording: Recording,
    profile: Profile,
    method: str,
    steps: Steps | None = None,
    jobs: int | None = None,
) -> CalibrationSamples:
    """Pairs of tool pixel and true position in the camera's plane, of all frames that have both."""
    setup = Setup(profile, method, "corrected", None, PIXELS_AS_THEY_ARE)
    rows = (steps or Steps(None, None)).of(estimate(recording, setup, recording.instruments[:1], jobs))
    results = [result for result in rows if result.measured]
    stamps_ns = np.array([result.stamp_ns for result in results], np.int64)
    tool_px = np.array([result.image.tool_px for result in results], np.float64).reshape(-1, 2)
    if recording.camera.has_distortion and len(tool_px):
        # Planar methods measure as if the lens were ideal; results tell pixels of the recorded image.
        tool_px = recording.camera.pinhole.project(pixel_rays(recording.camera, tool_px))
    truth = recording.transform_track(profile.frames.camera, profile.frames.tool, ground_truth=True)
    T_camera_tool = truth.at(stamps_ns)
    return CalibrationSamples(tool_px[T_camera_tool.valid], T_camera_tool.values[T_camera_tool.valid, :2, 3])
