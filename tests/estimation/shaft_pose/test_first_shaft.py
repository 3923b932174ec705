"""Where the fit of a shaft starts: the closed form gives a known cylinder back, and says what it lacks."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.instrument.shaft_detection import NO_SHAFT, Contour, DistalMarker, Rim, ShaftDetection
from svmdist.estimation.instrument.shaft_fit import first_shaft, fit_shaft
from svmdist.estimation.instrument.shaft_model import ShaftModel
from svmdist.results import Failure
from svmdist.transforms import Array, make_transform, rotation_of
from svmdist.vision.lines import TangentPlane, apparent_radius_px, tangent_normal

CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)
RADIUS_M, NECK_M, KNUCKLE_M = 0.004, 0.006, 0.00175
STRAIGHT = make_transform(np.eye(3), [0.0, 0.0, 0.009])
TURNS = [(0.3, 0.9, -0.2), (-0.8, 0.4, 1.0), (0.1, -1.2, 0.0), (2.0, 0.5, 0.3)]


def shaft_at(turn: tuple[float, float, float]) -> Array:
    return make_transform(rotation_of(turn), [0.004, -0.003, 0.09])


def model_of(R_camera_shaft: Array | None = None) -> ShaftModel:
    return ShaftModel(STRAIGHT, 0.02, R_camera_shaft, 0.05, RADIUS_M, NECK_M, KNUCKLE_M)


def seen_of(T: Array) -> tuple[ShaftDetection, DistalMarker]:
    """What an ideal image shows of a shaft: both contours, the rim on the axis, and the marker."""
    hinge_m, d = T[:3, 3], T[:3, 2]
    contours = []
    for side in (1, -1):
        normal = tangent_normal(hinge_m, d, RADIUS_M, side)
        contours.append(Contour(TangentPlane(normal, 1e-8 * (np.eye(3) - np.outer(normal, normal))), side))
    points_m = hinge_m + np.array([-0.03, -NECK_M, STRAIGHT[2, 3]])[:, None] * d
    middle_px, rim_px, tool_px = CAMERA.project(points_m)
    towards = (tool_px - middle_px) / np.linalg.norm(tool_px - middle_px)
    radius_px = float(apparent_radius_px(points_m[2], KNUCKLE_M, CAMERA))
    rim, marker = Rim(rim_px, towards, 0.3), DistalMarker(tool_px, 0.3, radius_px, 0.2)
    return ShaftDetection(tuple(contours), rim, towards, middle_px, False), marker


def found(shaft: ShaftDetection, marker: DistalMarker | None, model: ShaftModel) -> Array:
    T = first_shaft(shaft, marker, model, CAMERA)
    assert not isinstance(T, Failure), T
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
    return T


@pytest.mark.parametrize("turn", TURNS)
@pytest.mark.parametrize("landmark", ["rim", "marker"])
def test_the_closed_form_gives_the_cylinder_back(turn: tuple[float, float, float], landmark: str) -> None:
    """By the rim, or by the marker of a straight wrist: hinge and direction to rounding, 1e-9."""
    T = shaft_at(turn)
    shaft, marker = seen_of(T)
    seen = (shaft, None) if landmark == "rim" else (replace(shaft, rim=None), marker)
    start = found(*seen, model_of())
    np.testing.assert_allclose(start[:3, 3], T[:3, 3], atol=1e-9)
    np.testing.assert_allclose(start[:3, 2], T[:3, 2], atol=1e-9)


@pytest.mark.parametrize("turn", TURNS)
def test_the_nominal_roll_is_kept(turn: tuple[float, float, float]) -> None:
    """Contours do not show how the shaft is turned about itself: with a nominal rotation that is right, all is."""
    T = shaft_at(turn)
    start = found(*seen_of(T), model_of(T[:3, :3]))
    np.testing.assert_allclose(start, T, atol=1e-9)


@pytest.mark.parametrize("turn", TURNS)
def test_order_of_the_contours_plays_no_part(turn: tuple[float, float, float]) -> None:
    shaft, marker = seen_of(shaft_at(turn))
    swapped = replace(shaft, contours=shaft.contours[::-1])
    np.testing.assert_allclose(
        found(shaft, marker, model_of())[:3, 2:], found(swapped, marker, model_of())[:3, 2:], atol=1e-12
    )


@pytest.mark.parametrize("turn", TURNS)
def test_a_nominal_rotation_tells_tip_from_base(turn: tuple[float, float, float]) -> None:
    """Where the image does not; with neither there is no start."""
    T = shaft_at(turn)
    shaft, marker = seen_of(T)
    blind = replace(shaft, towards_tip=None, middle_px=None)
    np.testing.assert_allclose(found(blind, marker, model_of(T[:3, :3])), T, atol=1e-9)
    assert first_shaft(blind, marker, model_of(), CAMERA) == Failure(
        "nothing tells the shaft's tip from its base"
    )


@pytest.mark.parametrize("turn", TURNS)
def test_without_both_contours_the_marker_s_size_gives_the_depth(turn: tuple[float, float, float]) -> None:
    """With the nominal rotation: the tool where the marker's ray and radius put it, to 1e-6 of its depth."""
    T = shaft_at(turn)
    shaft, marker = seen_of(T)
    for seen in (replace(shaft, contours=shaft.contours[:1]), NO_SHAFT):
        np.testing.assert_allclose(found(seen, marker, model_of(T[:3, :3])), T, atol=1e-7)


def test_what_is_missing_is_said() -> None:
    shaft, marker = seen_of(shaft_at(TURNS[0]))
    nominal = model_of(np.eye(3))
    cut = replace(marker, radius_px=None)
    no_end = replace(shaft, rim=None)
    one_plane = replace(shaft, contours=(shaft.contours[0],) * 2)
    cases = [
        (NO_SHAFT, None, model_of(), "a side of the shaft"),
        (NO_SHAFT, None, nominal, "whole distal marker"),
        (NO_SHAFT, cut, nominal, "whole distal marker"),
        (no_end, None, model_of(), "end is not to be seen"),
        (one_plane, marker, model_of(), "too close together"),
    ]
    for seen, disc, model, words in cases:
        failure = first_shaft(seen, disc, model, CAMERA)
        assert isinstance(failure, Failure)
        assert words in failure.reason


@pytest.mark.parametrize("turn", TURNS)
def test_the_fit_stays_at_a_start_without_contradiction(turn: tuple[float, float, float]) -> None:
    """Of ideal detections the start is the solution: 1 µm and 1e-5 rad, where the iteration's steps end."""
    T = shaft_at(turn)
    fit = fit_shaft(*seen_of(T), model_of(T[:3, :3]), CAMERA)
    assert not isinstance(fit, Failure), fit
    np.testing.assert_allclose(fit.T_camera_shaft[:3, 3], T[:3, 3], atol=1e-6)
    np.testing.assert_allclose(fit.T_camera_shaft[:3, 2], T[:3, 2], atol=1e-5)
    np.testing.assert_allclose(fit.pose.position_m, (T @ STRAIGHT)[:3, 3], atol=1e-6)


@pytest.mark.parametrize("turn", TURNS)
def test_a_marker_whose_size_contradicts_the_edges_is_stated_as_doubt(
    turn: tuple[float, float, float],
) -> None:
    """A fifth smaller than the shaft's width makes it: the depth is as uncertain as a fifth of it, whoever is right."""
    T = shaft_at(turn)
    shaft, marker = seen_of(T)
    assert marker.radius_px is not None
    sure = fit_shaft(shaft, marker, model_of(T[:3, :3]), CAMERA)
    doubted = fit_shaft(shaft, replace(marker, radius_px=0.8 * marker.radius_px), model_of(T[:3, :3]), CAMERA)
    assert not isinstance(sure, Failure)
    assert not isinstance(doubted, Failure)
    depth_m = float(np.linalg.norm(doubted.pose.position_m))
    assert sure.pose.position_std_m < 0.05 * depth_m
    assert doubted.pose.position_std_m > 0.1 * depth_m
