"""The shaft's pose by weighted least squares over everything that an image and the wrist tell of it.

Unknown are the six of the shaft's frame and two of the wrist's bend. `first_shaft` starts the iteration; Gauss–Newton
ends it, and the inverse of its normal matrix is the covariance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.detection.distal_marker import DistalMarker
from svmdist.estimation.detection.shaft import ShaftDetection
from svmdist.estimation.filter.constants import EXACT, Deviations
from svmdist.estimation.shaft_pose.model import ShaftModel
from svmdist.estimation.shaft_pose.residuals import (
    BentTool,
    Landmarks,
    Residual,
    ShaftState,
    contour_residual,
    marker_residuals,
    prior_residual,
    rim_residual,
    tip_residual,
)
from svmdist.estimation.shaft_pose.solution import normal_equations, normalised_square, retracted
from svmdist.estimation.shaft_pose.start import first_shaft
from svmdist.least_squares import Steps, minimise
from svmdist.profile.settings import ShaftSettings
from svmdist.results import Failure, ToolPose, across_std_rad
from svmdist.transforms import Array
from svmdist.vision.sphere import apparent_radius_px

DEFAULT = ShaftSettings()
STEPS = Steps(max_steps=12, settled=1e-5)
"""A step below `settled`, in m and rad, ends the iteration: the next would be its square."""


@dataclass(frozen=True, slots=True)
class ShaftFit:
    """The tool's pose, the shaft's frame `T_camera_shaft`, and the measurements that carried them."""

    pose: ToolPose
    T_camera_shaft: Array
    used: tuple[str, ...]


def fit_shaft(
    shaft: ShaftDetection,
    marker: DistalMarker | None,
    model: ShaftModel,
    camera: Camera,
    settings: ShaftSettings = DEFAULT,
    deviations: Deviations = EXACT,
) -> ShaftFit | Failure:
    """The pose that fits most of what was seen without contradiction; or why there is none."""
    if shaft.is_stub and shaft.contours and marker is None:
        # Anything dark at the border has two short sides; nothing here would contradict them.
        return Failure("too little of the shaft is to be seen, and neither wrist nor distal marker")
    failure = None
    for trusted in _readings(Landmarks(shaft, marker)):
        fit = _fit(trusted, model, camera, settings, deviations)
        if isinstance(fit, ShaftFit):
            return _with_doubt(fit, marker, model, camera, settings, deviations)
        failure = failure or fit
    return failure or Failure("nothing of the shaft is to be seen")


def _readings(seen: Landmarks) -> Iterator[Landmarks]:
    """What may be taken for true, the whole first: a wrong landmark must not cost the frame."""
    yield seen
    shaft, marker = seen.shaft, seen.marker
    without_rim = replace(shaft, rim=None)
    if shaft.rim is not None:
        yield Landmarks(without_rim, marker)
    if shaft.contours and marker is not None:
        is_whole = marker.radius_px is not None
        # The marker's size and a long shaft's width tell a mistake of the other; a stub is easily mistaken.
        if is_whole and not shaft.is_stub:
            yield Landmarks(without_rim, replace(marker, radius_px=None))
        if is_whole:
            yield Landmarks(replace(without_rim, contours=()), marker)
        if shaft.rim is not None and not shaft.is_stub:
            yield Landmarks(shaft, None)


def _fit(
    seen: Landmarks, model: ShaftModel, camera: Camera, settings: ShaftSettings, deviations: Deviations
) -> ShaftFit | Failure:
    start = first_shaft(seen.shaft, seen.marker, model, camera)
    if isinstance(start, Failure):
        return start
    whitenings = [contour.plane.whitening for contour in seen.shaft.contours]

    def residuals(state: ShaftState) -> list[Residual]:
        found = [
            contour_residual(contour, whitening, state, model.radius_m, np.diag(camera.K)[:2], deviations)
            for contour, whitening in zip(seen.shaft.contours, whitenings, strict=True)
        ]
        if seen.shaft.rim is not None:
            found.append(rim_residual(seen.shaft.rim, state, model, camera, settings))
        if seen.marker is not None:
            found += marker_residuals(seen.marker, BentTool.of(state, model), model, camera, deviations)
        if seen.shaft.wrist is not None:
            tool = BentTool.of(state, model)
            found.append(tip_residual(seen.shaft.wrist, tool, model, camera, settings))
        return [*found, prior_residual(state, start, model)]

    least = minimise(
        ShaftState(start, np.zeros(2)), lambda state: normal_equations(residuals(state)), retracted, STEPS
    )
    if least is None:
        return Failure("the fit does not converge")
    found = residuals(least.state)
    squares = [normalised_square(residual) for residual in found]
    worst = int(np.argmax(squares))
    if squares[worst] > settings.gate_chi2:
        return Failure(f"{found[worst].name} does not fit the rest")
    tool = BentTool.of(least.state, model)
    of_state = np.asarray(np.linalg.inv(least.equations.information))
    covariance = tool.derivative @ of_state @ tool.derivative.T
    T = least.state.T
    pose = ToolPose(tool.T, covariance, T[:3, 2].copy(), across_std_rad(of_state[3:6, 3:6], T[:3, 2]))
    return ShaftFit(pose, T, tuple(residual.name for residual in found))


def _with_doubt(
    fit: ShaftFit,
    marker: DistalMarker | None,
    model: ShaftModel,
    camera: Camera,
    settings: ShaftSettings,
    deviations: Deviations,
) -> ShaftFit:
    """The fit, as uncertain in depth as the size of a whole marker contradicts it, whether it took that or not.

    A shadow beside the shaft, or blood on it, moves an edge far beyond its deviation; blood on the marker makes it
    small. Which of the two is right, one image does not tell.
    """
    if marker is None or marker.radius_px is None:
        return fit
    tool_m = fit.pose.position_m
    expected_px = float(apparent_radius_px(tool_m, model.knuckle_radius_m, camera))
    off_px = marker.radius_px - expected_px
    std_px = float(np.hypot(marker.radius_std_px, deviations.marker_radius_fraction * expected_px))
    if off_px**2 < settings.doubt_square * std_px**2:
        return fit
    covariance = fit.pose.covariance.copy()
    covariance[:3, :3] += (off_px / expected_px) ** 2 * np.outer(tool_m, tool_m)
    return replace(fit, pose=replace(fit.pose, covariance=covariance))
