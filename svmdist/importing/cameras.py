"""Cameras of images that are imported: what files and command line state, completed and held against the images."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import cast

import numpy as np

from svmdist.camera import Camera, DistortionModel, stereo_transform
from svmdist.errors import SourceError, UsageError
from svmdist.importing.calibration_files import StatedCamera, model_of, read_calibration
from svmdist.transforms import Array

PLAUSIBLE_BASELINE_M = (2e-4, 1.0)
"""An endoscope's is about 5 mm; beyond these bounds the unit is another one."""


@dataclass(frozen=True)
class CalibrationOptions:
    """Where the calibration comes from: files, or (fx, fy, cx, cy) in px; `unit_m` is the unit of lengths in files."""

    files: tuple[Path | None, Path | None] = (None, None)
    intrinsics: tuple[tuple[float, ...] | None, tuple[float, ...] | None] = (None, None)
    distortion: tuple[float, ...] = ()
    distortion_model: str = "plumb_bob"
    baseline_m: float | None = None
    unit_m: float = 1.0


def stated_cameras(options: CalibrationOptions, view_count: int) -> tuple[StatedCamera, ...]:
    """The cameras of one view or two, as stated; raises UsageError and SourceError in one line."""
    (left_file, right_file), (left_K, right_K) = options.files, options.intrinsics
    if (left_file is None) == (left_K is None):
        raise UsageError(
            "a camera needs a calibration: --calibration FILE, or --camera FX,FY,CX,CY"
            if left_file is None
            else "--calibration and --camera exclude each other: which of them is it?"
        )
    if left_file is not None:
        if options.distortion:
            raise UsageError("--distortion goes with --camera; a calibration file has its own")
        found = read_calibration(left_file, options.unit_m)
        if right_file is not None:
            found = (found[0], read_calibration(right_file, options.unit_m)[-1])
    else:
        assert left_K is not None
        if right_file is not None:
            raise UsageError(
                "--right-calibration goes with --calibration; beside --camera it is --right-camera"
            )
        rights = [right_K or left_K] if view_count == 2 else []
        found = tuple(_from_numbers(K, options) for K in (left_K, *rights))
    if view_count == 1:
        return found[:1]
    if len(found) == 1:
        if options.baseline_m is None:
            raise SourceError(
                f"{left_file}: has one camera, and there are two views: give --right-calibration, or --baseline for"
                " a rectified pair of equal cameras"
            )
        found = (found[0], found[0])
    return found if options.baseline_m is None else _parallel(found, options.baseline_m)


def complete(
    stated: Sequence[StatedCamera], sizes_px: Sequence[tuple[int, int]], frames: Sequence[str]
) -> list[Camera]:
    """Cameras of the size of their images; SourceError where the calibration is of another size, or no pair."""
    cameras = []
    for camera, (width_px, height_px), frame_id in zip(stated, sizes_px, frames, strict=True):
        if camera.size_px is not None and camera.size_px != (width_px, height_px):
            raise SourceError(
                f"the calibration is for {camera.size_px[0]}x{camera.size_px[1]} px, the images have"
                f" {width_px}x{height_px} px: calibrate at the size of the images"
            )
        if not (0 < camera.K[0, 2] < width_px and 0 < camera.K[1, 2] < height_px):
            raise SourceError(
                f"the principal point ({camera.K[0, 2]:g}, {camera.K[1, 2]:g}) is outside of the images of"
                f" {width_px}x{height_px} px"
            )
        P = np.hstack([camera.K, np.zeros((3, 1))]) if camera.P is None else camera.P
        R = np.eye(3) if camera.R is None else camera.R
        model = cast(DistortionModel, camera.model)
        cameras.append(Camera(width_px, height_px, camera.K, camera.D, R, P, frame_id, model))
    if len(cameras) == 2:
        _check_pair(stereo_transform(cameras[0], cameras[1]))
    return cameras


def _check_pair(T_left_right: Array | None) -> None:
    """SourceError where the right camera is not to the right, or further away than any pair is."""
    if T_left_right is None:
        return  # no baseline is known: the caller says so
    baseline_m = float(np.linalg.norm(T_left_right[:3, 3]))
    if not PLAUSIBLE_BASELINE_M[0] <= baseline_m <= PLAUSIBLE_BASELINE_M[1]:
        raise SourceError(
            f"the cameras are {baseline_m:g} m apart: if the calibration is in mm, say --unit mm"
        )
    if abs(T_left_right[1, 3]) > abs(T_left_right[0, 3]):
        raise SourceError("one camera stands above the other one; a pair is expected to stand side by side")
    if T_left_right[0, 3] <= 0:
        raise SourceError(
            f"the right camera stands {-T_left_right[0, 3] * 1e3:.3g} mm to the left of the left one:"
            " exchange the views and their calibrations"
        )


def _from_numbers(K: tuple[float, ...], options: CalibrationOptions) -> StatedCamera:
    fx, fy, cx, cy = K
    D = np.array(options.distortion, np.float64)
    try:
        model = model_of(options.distortion_model, D.size)
    except ValueError as problem:
        raise UsageError(f"--distortion: {problem}") from None
    return StatedCamera(np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), D, model)


def _parallel(pair: Sequence[StatedCamera], baseline_m: float) -> tuple[StatedCamera, ...]:
    """A pair of parallel cameras, the right one `baseline_m` to the right."""
    left, right = (replace(camera, R=None, P=None) for camera in pair)
    shift = np.array([[-right.K[0, 0] * baseline_m], [0.0], [0.0]])
    return left, replace(right, P=np.hstack([right.K, shift]))
