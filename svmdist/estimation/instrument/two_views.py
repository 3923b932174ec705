"""What both views of a pair show of one tool, as residuals of its shaft's pose in the left camera.

The right view's are predicted there, through the pair's geometry. Errors of that geometry are constants, which all of
them share.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.detection.distal_marker import DistalMarker
from svmdist.estimation.detection.shaft import Contour, Rim
from svmdist.estimation.detection.stereo_match import StereoMatch
from svmdist.estimation.filter.constants import Deviations, SharedBias
from svmdist.estimation.shaft_pose.model import ShaftModel
from svmdist.estimation.shaft_pose.residuals import (
    BentTool,
    Landmarks,
    Residual,
    ShaftState,
    contour_residual,
    marker_residuals,
    rim_residual,
)
from svmdist.profile.hand_eye import BASELINE
from svmdist.profile.settings import ShaftSettings
from svmdist.transforms import Array, skew
from svmdist.vision.rectified import RectifiedPair

DISPARITY, SIZE, MARKER, RIM = "disparity", "size", "distal marker", "rim"
VIEWS = ("left", "right")
MOTION = "motion between the views"

Predicted = Callable[[ShaftState], Residual]
"""A measurement's residual at a state."""


@dataclass(frozen=True, slots=True)
class TwoViews:
    """What both views show of one tool, with the cameras; the right one's place is `T_right_left`, shape (4, 4).

    `match` is the marker in both views, None where only one of them has it.
    """

    left: Landmarks
    right: Landmarks
    match: StereoMatch | None
    left_camera: Camera
    right_camera: Camera
    T_right_left: Array
    pair: RectifiedPair
    motion_std_m: float = 0.0
    """How far the tool may have moved along each axis between the views' stamps."""


def measurements(
    seen: TwoViews, model: ShaftModel, deviations: Deviations, settings: ShaftSettings
) -> dict[str, Predicted]:
    """Everything that both views show, by its name, as residuals of the state in the left camera."""
    found: dict[str, Predicted] = {}
    views = (
        ("left", seen.left, seen.left_camera),
        ("right", seen.right, seen.right_camera),
    )
    for view, landmarks, camera in views:
        for contour in landmarks.shaft.contours:
            edge = _edge(contour, camera, model, deviations)
            found[f"{view} side {contour.side:+d}"] = _in_view(edge, view, seen, deviations)
    # What hides a part of rim and marker hides it in both views alike: the second view adds its disparity only.
    for view, landmarks, camera in views:
        rim, marker = landmarks.shaft.rim, landmarks.marker
        if rim is not None and RIM not in found:
            found[RIM] = _in_view(
                partial(_rim, rim=rim, camera=camera, model=model, settings=settings), view, seen, deviations
            )
        if marker is not None and MARKER not in found:
            found[MARKER] = _in_view(_marker(marker, 0, camera, model, deviations), view, seen, deviations)
        if marker is not None and marker.radius_px is not None and SIZE not in found:
            found[SIZE] = _in_view(_marker(marker, 1, camera, model, deviations), view, seen, deviations)
    if seen.match is not None:
        found[DISPARITY] = _disparity(seen, seen.match, model, deviations)
    return found


def _edge(contour: Contour, camera: Camera, model: ShaftModel, deviations: Deviations) -> Predicted:
    whitening, focal_px = contour.plane.whitening, np.diag(camera.K)[:2]
    return lambda state: contour_residual(contour, whitening, state, model.radius_m, focal_px, deviations)


def _rim(state: ShaftState, rim: Rim, camera: Camera, model: ShaftModel, settings: ShaftSettings) -> Residual:
    return rim_residual(rim, state, model, camera, settings)


def _marker(
    marker: DistalMarker, which: int, camera: Camera, model: ShaftModel, deviations: Deviations
) -> Predicted:
    """The marker's middle (`which` 0), or its size (1)."""
    return lambda state: marker_residuals(marker, BentTool.of(state, model), model, camera, deviations)[which]


def _in_view(predict: Predicted, view: str, seen: TwoViews, deviations: Deviations) -> Predicted:
    """A residual of the shaft in a view's camera, as one of the shaft in the left camera."""
    if view == "left":
        return predict
    R, t = seen.T_right_left[:3, :3], seen.T_right_left[:3, 3]

    def in_right(state: ShaftState) -> Residual:
        T = seen.T_right_left @ state.T
        local = predict(ShaftState(T, state.bend))
        by_place, by_turn = local.derivative[:, :3], local.derivative[:, 3:6]
        derivative = np.concatenate([by_place @ R, by_turn @ R, local.derivative[:, 6:]], 1)
        # The right camera is off by its place along the baseline, and turned about its own centre.
        baseline = by_place @ t[:, None] * deviations.camera.baseline_std_fraction
        turned = (by_turn - by_place @ skew(T[:3, 3])) * deviations.camera.right_rotation_std_rad
        constants = (
            *local.constants,
            SharedBias(BASELINE, baseline),
            SharedBias("right camera's rotation", turned),
            SharedBias(MOTION, seen.motion_std_m * by_place),
        )
        return Residual(f"right {local.name}", local.whitened, derivative, constants)

    return in_right


def _disparity(seen: TwoViews, match: StereoMatch, model: ShaftModel, deviations: Deviations) -> Predicted:
    """The disparity of the marker, about the tool's origin."""

    def predict(state: ShaftState) -> Residual:
        tool = BentTool.of(state, model)
        tool_m = tool.T[:3, 3]
        # d = f b / z, along rows; in the right view x changes with the point by f (1, 0, -x / z) / z.
        depth_m, along = seen.pair.depth_m(tool_m)
        disparity_px = seen.pair.disparity_at(depth_m)
        slope = -disparity_px / depth_m * along
        R = seen.T_right_left[:3, :3]
        right_m = R @ tool_m + seen.T_right_left[:3, 3]
        R_rows = np.eye(3) if seen.pair.R_rows_left is None else seen.pair.R_rows_left @ R.T
        x_m, _, z_m = R_rows @ right_m
        by_right = seen.pair.K[0, 0] / z_m * (np.array([1.0, 0.0, -x_m / z_m]) @ R_rows)
        biases = deviations.of_disparity(right_m, by_right, np.array(disparity_px), seen.T_right_left)
        moved = SharedBias(MOTION, -seen.motion_std_m * by_right[None])
        place = SharedBias("marker place", model.marker_std_m * slope[None])
        scale = 1.0 / match.disparity_std_px
        return Residual(
            DISPARITY,
            np.array([(match.disparity_px - disparity_px) * scale]),
            scale * (slope @ tool.derivative[:3])[None],
            tuple(bias.scaled(scale) for bias in (*biases, moved, place)),
        )

    return predict
