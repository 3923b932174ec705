"""The fit to both views of an exact pair: derivatives, contradictions, and the watch over the frames."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.instrument.measurement import Deviations
from svmdist.estimation.instrument.shaft_detection import Contour, DistalMarker, Rim, ShaftDetection
from svmdist.estimation.instrument.shaft_model import Landmarks, ShaftModel, ShaftState
from svmdist.estimation.instrument.stereo_fit import StereoFit, fit_two_views
from svmdist.estimation.instrument.two_views import (
    DISPARITY,
    DisparityCheck,
    DisparityWatch,
    StereoMatch,
    TwoViews,
    measurements,
)
from svmdist.estimation.stereo import nominal_orientation_pose
from svmdist.profile import CameraError
from svmdist.profile.settings import ShaftSettings
from svmdist.results import Failure, ToolPose
from svmdist.transforms import Array, inverse, make_transform, rotation_of
from svmdist.vision.edges import Disc
from svmdist.vision.lines import TangentPlane, apparent_radius_px, tangent_normal
from svmdist.vision.stereo import RectifiedPair

CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)
BASELINE_M, RADIUS_M, NECK_M, WRIST_M, KNUCKLE_M = 0.005, 0.004, 0.006, 0.0091, 0.00175
T_SHAFT_TOOL = make_transform(np.eye(3), [0.0, 0.0, WRIST_M])
MODEL = ShaftModel(T_SHAFT_TOOL, 0.02, None, np.pi, RADIUS_M, NECK_M, KNUCKLE_M)
T_RIGHT_LEFT = make_transform(np.eye(3), [-BASELINE_M, 0.0, 0.0])
PAIR = RectifiedPair(CAMERA.K, BASELINE_M, 0.0)
DEVIATIONS = Deviations(CameraError(), 0.02, 0.03)
TRUE = make_transform(rotation_of(np.array([0.5, 0.9, 0.2])), [0.004, -0.003, 0.085])
EDGE_STD = 2e-4


def shown(T_shaft: Array, hidden_marker: bool = False) -> Landmarks:
    """What a view shows of a shaft at `T_shaft`, without an error."""
    d, hinge_m = T_shaft[:3, 2], T_shaft[:3, 3]
    tool_m = hinge_m + WRIST_M * d
    contours = []
    for side in (1, -1):
        normal = tangent_normal(hinge_m, d, RADIUS_M, side)
        across = np.eye(3) - np.outer(normal, normal)
        contours.append(Contour(TangentPlane(normal, EDGE_STD**2 * across), side))
    foot = hinge_m - (d @ hinge_m) * d
    rim_m = hinge_m - NECK_M * d - RADIUS_M * foot / np.linalg.norm(foot)
    rim_px, tool_px = CAMERA.project(rim_m)[0], CAMERA.project(tool_m)[0]
    towards = (tool_px - rim_px) / np.linalg.norm(tool_px - rim_px)
    shaft = ShaftDetection(tuple(contours), Rim(rim_px, towards, 0.5), towards, rim_px, False)
    if hidden_marker:
        return Landmarks(shaft, None)
    radius_px = float(apparent_radius_px(tool_m, KNUCKLE_M, CAMERA))
    disc = Disc(tool_px, radius_px, 0.1, 0.8, 1.0)
    return Landmarks(shaft, DistalMarker(tool_px, 0.5, radius_px, 0.2, disc, np.pi * radius_px**2))


def views(hidden: tuple[bool, bool] = (False, False), off_px: float = 0.0) -> TwoViews:
    """Both views of the true shaft; the disparity is off by some pixels."""
    left, right = shown(TRUE, hidden[0]), shown(T_RIGHT_LEFT @ TRUE, hidden[1])
    match = None
    if left.marker is not None and right.marker is not None:
        disparity_px = float(left.marker.centre_px[0] - right.marker.centre_px[0])
        match = StereoMatch(left.marker.centre_px, 0.5, disparity_px + off_px, 0.15)
    return TwoViews(left, right, match, CAMERA, CAMERA, T_RIGHT_LEFT, PAIR)


def true_tool_m() -> Array:
    return np.asarray((TRUE @ T_SHAFT_TOOL)[:3, 3])


@pytest.mark.parametrize("hidden", [(False, False), (True, False), (False, True), (True, True)])
def test_exact_views_give_the_true_pose(hidden: tuple[bool, bool]) -> None:
    """Whatever of the marker is hidden; with less of it the deviation is larger."""
    found = fit_two_views(views(hidden), MODEL, DEVIATIONS)
    assert isinstance(found, StereoFit)
    assert found.refused == ()
    np.testing.assert_allclose(found.fit.pose.position_m, true_tool_m(), atol=2e-5)
    whole = fit_two_views(views(), MODEL, DEVIATIONS)
    assert isinstance(whole, StereoFit)
    assert whole.fit.pose.position_std_m <= found.fit.pose.position_std_m + 1e-9


def test_derivatives_are_those_of_the_predictions() -> None:
    """Of every measurement of both views, by small steps of the state, in a pair whose baseline is not along rows."""
    R = rotation_of(np.array([0.01, 0.02, 0.1]))
    place_m = R @ [BASELINE_M, 0.0, 0.0]
    x = place_m / BASELINE_M
    y = np.cross([0.0, 0.0, 1.0], x) / np.linalg.norm(np.cross([0.0, 0.0, 1.0], x))
    pair = RectifiedPair(CAMERA.K, BASELINE_M, 0.0, np.stack([x, y, np.cross(x, y)]))
    T_right_left = inverse(make_transform(np.eye(3), place_m))
    left, right = shown(TRUE), shown(T_right_left @ TRUE, hidden_marker=True)
    assert left.marker is not None
    match = StereoMatch(left.marker.centre_px, 0.5, pair.disparity_at(0.09), 0.15)
    seen = TwoViews(left, right, match, CAMERA, CAMERA, T_right_left, pair)
    state = ShaftState(TRUE, np.array([0.05, -0.03]))
    step = 1e-6
    for name, predict in measurements(seen, MODEL, DEVIATIONS, ShaftSettings()).items():
        at = predict(state)
        for axis, unit in enumerate(np.eye(8)):
            ahead, behind = (predict(state.retracted(sign * step * unit)).whitened for sign in (1, -1))
            slope = -(ahead - behind) / (2 * step)
            scale = max(1.0, float(np.abs(at.derivative).max()))
            np.testing.assert_allclose(at.derivative[:, axis] / scale, slope / scale, atol=2e-3, err_msg=name)


def test_a_disparity_that_two_others_contradict_is_refused() -> None:
    """Off by 5 px, against width and size; and the check says by how much."""
    found = fit_two_views(views(off_px=5.0), MODEL, DEVIATIONS)
    assert isinstance(found, StereoFit)
    assert DISPARITY in found.refused
    assert np.linalg.norm(found.fit.pose.position_m - true_tool_m()) < 5e-4
    assert found.check is not None
    assert found.check.off == pytest.approx(5.0 / PAIR.disparity_at(true_tool_m()[2]), rel=0.1)
    assert found.check.off > 3.0 * found.check.std


def test_a_wrong_end_and_a_wrong_edge_do_not_outvote_a_disc_in_both_views() -> None:
    """Something across the shaft: its end 30 px off, and an edge of the left view with it."""
    seen = views()
    rim = seen.left.shaft.rim
    assert rim is not None
    wrong = replace(rim, pixel=rim.pixel - 30.0 * rim.towards_tip)
    normal = rotation_of(np.array([0.03, -0.02, 0.0])) @ seen.left.shaft.contours[0].plane.normal
    edge = replace(
        seen.left.shaft.contours[0], plane=replace(seen.left.shaft.contours[0].plane, normal=normal)
    )
    left = replace(seen.left.shaft, rim=wrong, contours=(edge, seen.left.shaft.contours[1]))
    found = fit_two_views(replace(seen, left=Landmarks(left, seen.left.marker)), MODEL, DEVIATIONS)
    assert isinstance(found, StereoFit)
    assert "rim" in found.refused
    assert "distal marker" not in found.refused
    assert np.linalg.norm(found.fit.pose.position_m - true_tool_m()) < 5e-4


def test_one_witness_against_one_is_stated_as_uncertainty() -> None:
    """Without edges, size and disparity 15 % apart: so much of the depth may be wrong."""
    seen = views(off_px=4.5)
    no_edges = tuple(
        Landmarks(replace(view.shaft, contours=(), rim=None), view.marker) for view in (seen.left, seen.right)
    )
    nominal = replace(MODEL, R_camera_shaft=TRUE[:3, :3], rotation_std_rad=0.05)
    found = fit_two_views(replace(seen, left=no_edges[0], right=no_edges[1]), nominal, DEVIATIONS)
    if isinstance(found, Failure):
        assert "uncertain" in found.reason
    else:
        error_m = np.linalg.norm(found.fit.pose.position_m - true_tool_m())
        assert error_m < 2.0 * found.fit.pose.position_std_m
        assert found.fit.pose.position_std_m > 4e-3


def test_nothing_seen_is_a_failure() -> None:
    nothing = Landmarks(ShaftDetection((), None, None, None, True), None)
    seen = replace(views(), left=nothing, right=nothing, match=None)
    assert isinstance(fit_two_views(seen, MODEL), Failure)


def test_the_watch_doubts_what_is_off_in_most_frames(monkeypatch: pytest.MonkeyPatch) -> None:
    """Three deviations once in a while are chance, in most frames they are not; what passes is forgotten."""
    monkeypatch.setattr("svmdist.estimation.instrument.two_views.WATCH_FRAMES", 6)
    watch = DisparityWatch()
    assert watch.doubt == 0.0
    for off in (0.0, 0.15, 0.01, -0.02, 0.0):
        watch.add(DisparityCheck(off, 0.05))
    assert watch.doubt == 0.0
    for _ in range(6):
        watch.add(DisparityCheck(0.15, 0.05))
    assert watch.doubt == pytest.approx(0.15)
    for _ in range(6):
        watch.add(DisparityCheck(0.0, 0.05))
    assert watch.doubt == 0.0


def test_the_triangulated_point_takes_the_nominal_direction() -> None:
    """Place and covariance are those of pixel and disparity, the turn is that of nominal kinematics."""
    match = views().match
    assert match is not None
    nominal = ToolPose(TRUE, np.diag([1.0] * 3 + [1e-4] * 3), TRUE[:3, 2])
    pose = nominal_orientation_pose(match, PAIR, nominal)
    np.testing.assert_allclose(pose.position_m, true_tool_m(), atol=1e-9)
    np.testing.assert_array_equal(pose.T_camera_tool[:3, :3], TRUE[:3, :3])
    assert pose.position_std_m < 1e-3
    np.testing.assert_array_equal(pose.covariance[3:, 3:], nominal.covariance[3:, 3:])
