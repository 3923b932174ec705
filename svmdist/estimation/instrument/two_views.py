"""What both views of a pair show of one tool: the distal marker's disparity, and residuals of the shaft's pose."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.instrument import shaft_model
from svmdist.estimation.instrument.measurement import Deviations, SharedBias
from svmdist.estimation.instrument.shaft_detection import DistalMarker
from svmdist.estimation.instrument.shaft_model import Landmarks, Residual, ShaftModel, ShaftState
from svmdist.least_squares import median
from svmdist.profile.hand_eye import BASELINE
from svmdist.profile.settings import ShaftSettings, StereoSettings
from svmdist.results import Failure
from svmdist.transforms import Array, skew
from svmdist.vision.lines import apparent_radius_px
from svmdist.vision.stereo import RectifiedPair

ROW_TOLERANCE_PX = 3.0  # rectified points lie on one row; the marker is cut differently in each view
MARKER_DISPARITY_STD = 0.012  # over the radius, in one frame: from 3° aside jaws hide other parts of it
MARKER_DISPARITY_NOISE_PX = 0.05  # of the marker's disparity: that of two centroids of some hundred pixels
SIZE_TOLERANCE = 0.2  # of the size by depth; a smaller marker is partly hidden, in both views alike
HIDDEN_DISPARITY_STD = 0.15  # over radius and hidden part: the centroid moves by a quarter more or less
PART_DISPARITY_STD = 0.04  # over a disc's radius: from 3° aside another part of the region shows
WATCH_FRAMES = 20  # frames over which disparities are held against the instrument's sizes
WATCH_BOUND_STDS = 2.5  # in the median; beyond, it widens the depth: one log in eighty by chance

ASIDE_RAD = 0.056  # angle between the views for which disparities' deviations are stated: 5 mm at 90 mm


@dataclass(frozen=True, slots=True)
class StereoMatch:
    """The marker in both views: centre in the left one, (2,), disparity, and their standard deviations, in px."""

    left_px: Array
    std_px: float
    disparity_px: float
    disparity_std_px: float
    is_other_part: bool = (
        False  # of another size than the profile states: part of the marker, or something else
    )


def match_distal_marker(
    left: DistalMarker | None,
    right: DistalMarker | None,
    pair: RectifiedPair,
    radius_m: float | None,
    camera: Camera,
    settings: StereoSettings,
    radius_std_fraction: float,
) -> StereoMatch | Failure:
    """Pair the markers of both views; or why they cannot be paired."""
    if left is None or right is None:
        return Failure("the instrument is seen in one view only")
    left_at, right_at = pair.to_rows(left.centre_px), pair.to_rows(right.centre_px, right=True)
    if abs(left_at[1] - right_at[1]) > ROW_TOLERANCE_PX + left.std_px + right.std_px:
        return Failure("the views do not agree on the instrument")
    disparity_px = pair.disparity_px(float(left_at[0]), float(right_at[0]))
    if disparity_px <= pair.disparity_at(settings.far_m):
        return Failure(
            f"the instrument's disparity, {disparity_px:.1f} px, is that of a point beyond {settings.far_m} m"
        )
    p_camera_m, _ = pair.point(left.centre_px, disparity_px)
    # From further aside other parts of it are hidden.
    aside = max(1.0, pair.baseline_m / float(p_camera_m[2]) / ASIDE_RAD)
    radii_px = [marker.radius_px for marker in (left, right) if marker.radius_px is not None]
    if len(radii_px) < 2 or radius_m is None:
        # A coloured part of any shape. What one view shows more of moves its centroid by up to half of it:
        # that is taken for two deviations.
        whole_px = float(np.sqrt(max(left.area_px, right.area_px) / np.pi))
        uneven = abs(left.area_px - right.area_px) / max(left.area_px, right.area_px, 1.0)
        part = 0.25 * uneven + PART_DISPARITY_STD * aside
        std_px = float(np.hypot(MARKER_DISPARITY_NOISE_PX, part * whole_px))
        return StereoMatch(left.centre_px, max(left.std_px, 0.5 * whole_px), disparity_px, std_px)
    whole_px = float(apparent_radius_px(p_camera_m, radius_m, camera))
    disparity_std_px = float(np.hypot(MARKER_DISPARITY_NOISE_PX, MARKER_DISPARITY_STD * aside * whole_px))
    std_px = left.std_px
    hidden = max(abs(radius_px / whole_px - 1.0) for radius_px in radii_px)
    is_other_part = hidden > max(SIZE_TOLERANCE, 2.0 * radius_std_fraction)
    if is_other_part:
        # Both views show a part, and nearly the same one where it is as large in both.
        uneven = abs(radii_px[0] - radii_px[1]) / whole_px
        std_px = max(std_px, 0.5 * whole_px)
        part_px = whole_px * (0.5 * uneven + HIDDEN_DISPARITY_STD * aside * hidden)
        disparity_std_px = float(np.hypot(disparity_std_px, part_px))
    return StereoMatch(left.centre_px, std_px, disparity_px, disparity_std_px, is_other_part)


@dataclass(frozen=True, slots=True)
class DisparityCheck:
    """A disparity less the one at the depth by the sizes, over itself, and its standard deviation."""

    off: float
    std: float


class DisparityWatch:
    """The last checks of one instrument's disparities."""

    def __init__(self) -> None:
        self._checks: deque[DisparityCheck] = deque(maxlen=WATCH_FRAMES)

    def add(self, check: DisparityCheck) -> None:
        """Take up a frame's check."""
        self._checks.append(check)

    @property
    def doubt(self) -> float:
        """By how much disparities contradict the sizes, where that is more than their deviations allow; else 0."""
        if not self._checks:
            return 0.0
        stds = median(np.array([check.off / check.std for check in self._checks]))
        if abs(stds) <= WATCH_BOUND_STDS:
            return 0.0
        return abs(median(np.array([check.off for check in self._checks])))


DISPARITY, SIZE, MARKER, RIM = "disparity", "size", "distal marker", "rim"
VIEWS = ("left", "right")
MOTION = "motion between the views"

Predicted = Callable[[ShaftState], Residual]  # A measurement's residual at a state


@dataclass(frozen=True, slots=True)
class TwoViews:
    """What both views show of one tool, with the cameras; the right one's place is `T_right_left`, shape (4, 4)."""

    left: Landmarks
    right: Landmarks
    match: StereoMatch | None
    left_camera: Camera
    right_camera: Camera
    T_right_left: Array
    pair: RectifiedPair
    motion_std_m: float = 0.0  # how far the tool may have moved along each axis between the views' stamps


def measurements(
    seen: TwoViews, model: ShaftModel, deviations: Deviations, settings: ShaftSettings
) -> dict[str, Predicted]:
    """Everything that both views show, by its name, as residuals of the state in the left camera."""
    found: dict[str, Predicted] = {}
    views = (("left", seen.left, seen.left_camera), ("right", seen.right, seen.right_camera))
    for view, landmarks, camera in views:
        edge = partial(shaft_model.contour_residual, model=model, camera=camera, deviations=deviations)
        for contour in landmarks.shaft.contours:
            plane = partial(edge, contour, contour.plane.whitening)
            found[f"{view} side {contour.side:+d}"] = _in_view(plane, view, seen, deviations)
    # What hides a part of rim and marker hides it in both views alike: the second view adds its disparity only.
    for view, landmarks, camera in views:
        rim, marker = landmarks.shaft.rim, landmarks.marker
        known: dict[str, Predicted] = {}
        if rim is not None:
            known[RIM] = partial(shaft_model.rim_residual, rim, model=model, camera=camera, settings=settings)
        for name, residual in ((MARKER, shaft_model.marker_residual), (SIZE, shaft_model.size_residual)):
            if marker is not None and (name == MARKER or marker.radius_px is not None):
                known[name] = partial(residual, marker, model=model, camera=camera, deviations=deviations)
        for name, predict in known.items():
            if name not in found:
                found[name] = _in_view(predict, view, seen, deviations)
    if seen.match is not None:
        found[DISPARITY] = _disparity(seen, seen.match, model, deviations)
    return found


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
    def predict(state: ShaftState) -> Residual:
        T, by_state = shaft_model.bent_tool(state, model)
        tool_m = T[:3, 3]
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
            scale * (slope @ by_state[:3])[None],
            tuple(bias.scaled(scale) for bias in (*biases, moved, place)),
        )

    return predict
