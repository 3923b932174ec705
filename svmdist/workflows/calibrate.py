"""Calibrate: pixels of the tool and its true positions, fitted by the quadratics of eqs. (5) and (6)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np

from svmdist.camera import Camera
from svmdist.errors import CalibrationError
from svmdist.estimation.plane_mapping import (
    Calibration,
    CalibrationSamples,
    PlaneMapping,
    Quadratic,
    SourceFile,
    fit_calibration,
)
from svmdist.geometry import pixel_rays
from svmdist.profile import Profile
from svmdist.recording.log import Recording
from svmdist.workflows.estimate import estimate
from svmdist.workflows.parallel import Steps
from svmdist.workflows.request import Setup

PIXELS_AS_THEY_ARE = PlaneMapping("corrected", Quadratic(0.0, 1.0, 0.0), Quadratic(0.0, 1.0, 0.0))
"""The estimator needs a mapping; calibration reads its pixels only."""


@dataclass(frozen=True)
class CalibrationPart:
    """What one recording contributes to a calibration: its samples, its camera, and its identity."""

    name: str
    file_name: str
    sha256: str
    camera: Camera
    samples: CalibrationSamples


def collect_part(
    recording: Recording, profile: Profile, method: str, jobs: int | None = None, steps: Steps | None = None
) -> CalibrationPart:
    """Pairs of tool pixel and true position in the camera's plane; RecordingError where the log has no true pose."""
    setup = Setup(profile, method, "corrected", None, PIXELS_AS_THEY_ARE)
    rows = (steps or Steps(None, None)).of(estimate(recording, setup, recording.instruments[:1], jobs))
    results = [result for result in rows if result.measured]
    stamps_ns = np.array([result.stamp_ns for result in results], np.int64)
    tool_px = np.array([result.image.tool_px for result in results], np.float64).reshape(-1, 2)
    camera = recording.camera
    if camera.has_distortion and len(tool_px):
        # Planar methods measure as if the lens were ideal; results have pixels of the recorded image.
        tool_px = camera.pinhole.project(pixel_rays(camera, tool_px))
    truth = recording.transform_track(profile.frames.camera, profile.frames.tool, ground_truth=True)
    tool = truth.at(stamps_ns)
    samples = CalibrationSamples(tool_px[tool.valid], tool.values[tool.valid, :2, 3])
    return CalibrationPart(recording.name, recording.path.name, recording.sha256(), camera, samples)


def fit_parts(parts: Sequence[CalibrationPart], method: str) -> Calibration:
    """Fit a calibration; CalibrationError for different cameras, too few frames or too little of the image covered."""
    first = parts[0]
    for part in parts:
        if not first.camera.same_optics(part.camera):
            raise CalibrationError(
                f"recordings of different cameras cannot be calibrated together: {first.name} and {part.name} differ"
            )
    return fit_calibration(
        CalibrationSamples(
            np.concatenate([part.samples.tool_px for part in parts]),
            np.concatenate([part.samples.tool_m for part in parts]),
        ),
        first.camera,
        method,
        created_by=f"svmdist {version('svmdist')}",
        sources=tuple(SourceFile(name=part.file_name, sha256=part.sha256) for part in parts),
    )
