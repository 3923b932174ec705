"""The paper's methods: its equations in both readings, and both estimators on frames whose truth is known."""

import math

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svmdist.camera import Camera
from svmdist.estimation.plane_mapping import (
    PUBLISHED_X,
    PUBLISHED_Y,
    PlaneMapping,
    Quadratic,
    displacement_cm_as_published,
    displacement_cm_corrected,
    planar_distance,
    screen_cm_as_published,
    screen_cm_corrected,
)
from svmdist.kinematics import DHChain, forward_kinematics
from svmdist.samples import Observation, Status
from tests.measuring import Measuring
from tests.shipped import CHAIN, PROFILE


@pytest.mark.parametrize(
    ("pixel", "published_cm", "corrected_cm"),
    [(0, 0.01, 0.0), (1, -0.0154, 0.0254), (100, -2.53, 2.54), (640, -16.246, 16.256)],
)
def test_eqs_3_4_as_published_run_backwards(pixel, published_cm, corrected_cm):
    """(1 - T * 2.54) / 100 is +0.01 at pixel 0 and -16.2 at pixel 640; corrected, a hundred pixels are an inch."""
    assert float(screen_cm_as_published(pixel)) == pytest.approx(published_cm, abs=1e-12)
    assert float(screen_cm_corrected(pixel)) == pytest.approx(corrected_cm, abs=1e-12)


def test_eqs_5_6_are_the_published_quadratics_and_25_to_27_the_euclidean_distance():
    """Term by term; 3 mm and 4 mm apart is 5 mm, and the quadratics' constants cancel in the difference."""
    for screen_cm in (-16.2, 0.0, 0.01, 2.9, 16.2):
        x = -0.0036 * screen_cm**2 + 0.7938 * screen_cm - 0.0403
        y = -0.0068 * screen_cm**2 + 0.0395 * screen_cm - 0.4439
        assert PUBLISHED_X(screen_cm) == pytest.approx(x, abs=1e-14)
        assert PUBLISHED_Y(screen_cm) == pytest.approx(y, abs=1e-14)
    assert planar_distance(np.array([0.003, 0.0]) - np.array([0.0, -0.004])) == pytest.approx(0.005)
    published = PlaneMapping("corrected", PUBLISHED_X, PUBLISHED_Y)
    shifted = PlaneMapping(
        "corrected",
        Quadratic(quadratic_per_cm=-0.0036, linear=0.7938, constant_cm=7.0),
        Quadratic(quadratic_per_cm=-0.0068, linear=0.0395, constant_cm=-9.0),
    )
    a_px, b_px = np.array([10.0, 20.0]), np.array([300.0, 400.0])
    one_m, other_m = (
        planar_distance(mapping.to_plane_m(a_px) - mapping.to_plane_m(b_px)) for mapping in (published, shifted)
    )
    assert one_m == pytest.approx(other_m, rel=1e-12)


def test_the_shipped_chain_begins_with_eq_29_and_ends_with_eq_30_corrected():
    """Joint 1 slides with α = θ = 0, joint 13 turns with α = π/2 and a = d = 0 (Table II); bit for bit."""
    first, *_, last = CHAIN.rows
    T = np.eye(4)
    T[0, 3], T[2, 3] = first.a_m, first.d_m + 0.17
    np.testing.assert_array_equal(forward_kinematics(DHChain((first,)), [0.17]), T)
    # As published the third column of the rotation has the other sign: a reflection.
    for theta_rad in (0.0, 0.3, np.pi / 2, -2.0, np.pi):
        c, s = np.cos(theta_rad), np.sin(theta_rad)
        T = [[c, 0.0, s, 0.0], [s, 0.0, -c, 0.0], [0.0, 1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]]
        np.testing.assert_array_equal(forward_kinematics(DHChain((last,)), [theta_rad]), T)


def test_eqs_33_34_as_published_divide_metres_by_a_hundred():
    """(0.099 - x) / 100 and (0.043 - y) / 100: with the tissue there, 10^4 less than corrected."""
    found = displacement_cm_as_published(np.array([0.059, 0.013, 0.5]))
    np.testing.assert_allclose(found, [0.0004, 0.0003], rtol=1e-12)
    p_m = np.random.default_rng(1).normal(size=(20, 3))
    corrected = displacement_cm_corrected(p_m, np.array([0.099, 0.043, 0.7]))
    np.testing.assert_allclose(corrected, 1e4 * displacement_cm_as_published(p_m), rtol=1e-12)


def test_eqs_33_to_35_corrected_give_centimetres():
    """A tool 3 cm and 4 cm beside the tissue is 5 cm away, whatever their depths."""
    p_m = np.array([[0.01, 0.02, 0.1], [0.01, 0.02, 9.0]])
    tissue_m = np.array([[0.04, 0.06, 0.0], [-0.02, -0.02, 1.0]])
    np.testing.assert_allclose(planar_distance(displacement_cm_corrected(p_m, tissue_m)), 5.0, rtol=1e-12)


CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)
MAPPING = PlaneMapping(
    "corrected",
    Quadratic(quadratic_per_cm=0.0, linear=0.8, constant_cm=0.0),
    Quadratic(quadratic_per_cm=0.0, linear=0.8, constant_cm=0.0),
)
METRES_PER_PX = 0.0254 * 0.8 / 100.0
TISSUE_PX = (330.0, 250.0)
PLANAR = ("overlay", "centroid")
ESTIMATORS = {method: Measuring(method, PROFILE, MAPPING) for method in PLANAR}


def frame(tool_px: tuple[float, float] | None, tissue: bool = True, seed: int = 1) -> Observation:
    """Pixel by pixel on a dull textured ground: the red ellipse about TISSUE_PX, and the cyan disc over it."""
    grey = np.random.default_rng(seed).integers(60, 130, (60, 80)).astype(np.uint8)
    image = cv2.merge([cv2.resize(grey, (640, 480), interpolation=cv2.INTER_CUBIC)] * 3)
    ys, xs = np.mgrid[:480, :640]
    if tissue:
        image[((xs - TISSUE_PX[0]) / 150) ** 2 + ((ys - TISSUE_PX[1]) / 110) ** 2 <= 1] = (70, 60, 200)
    if tool_px is not None:
        image[(xs - tool_px[0]) ** 2 + (ys - tool_px[1]) ** 2 <= 12.0**2] = (210, 190, 30)
    return Observation(1_000, image, CAMERA)


def check_consistent(row) -> None:
    """What holds for every outcome: a distance exactly when measured, never a number that is not finite."""
    assert row.measured is (row.distance_m is not None)
    for name, value in vars(row).items():
        assert not isinstance(value, float) or math.isfinite(value), name
    assert (row.tool_x_px is None) is (row.tool_y_px is None) is (row.tool_area_px is None)
    assert (row.tissue_x_px is None) is (row.tissue_y_px is None) is (row.tissue_area_px is None)
    # Counts are nested: matches need keypoints, inliers need matches.
    counts = [row.keypoint_count, row.match_count, row.inlier_count]
    known = [count for count in counts if count is not None]
    assert counts[: len(known)] == known


@pytest.mark.parametrize("method", PLANAR)
@settings(max_examples=25)
@given(x=st.floats(2.0, 637.0), y=st.floats(2.0, 477.0), seed=st.integers(0, 50))
def test_places_are_found_all_over_the_image(method, x, y, seed):
    """Tool and tissue to 1 px of the centroid of what is left to see, wherever the tool is; the distance to 0.3 mm."""
    observation = frame((x, y), seed=seed)
    ys, xs = np.mgrid[:480, :640]
    inside = (xs - x) ** 2 + (ys - y) ** 2 <= 12.0**2
    truth_px = np.array([xs[inside].mean(), ys[inside].mean()])
    row = ESTIMATORS[method].estimate(observation)
    assert row.status is Status.OK
    check_consistent(row)
    assert math.dist((row.tool_x_px, row.tool_y_px), truth_px) < 1.0
    assert math.dist((row.tissue_x_px, row.tissue_y_px), TISSUE_PX) < 1.0
    assert row.tool_area_px == np.count_nonzero(inside)
    assert row.distance_m == pytest.approx(math.dist(truth_px, TISSUE_PX) * METRES_PER_PX, abs=3e-4)


@pytest.mark.parametrize("method", PLANAR)
@pytest.mark.parametrize(("tool_px", "tissue"), [(None, True), ((100.0, 100.0), False), (None, False)])
def test_a_missing_region_is_the_reason(method, tool_px, tissue):
    """Without tissue or instrument the row says which, holds what was found, and has no distance."""
    row = ESTIMATORS[method].estimate(frame(tool_px, tissue))
    assert row.status is (Status.NO_INSTRUMENT if tissue else Status.NO_TISSUE)
    check_consistent(row)
    assert (row.tissue_area_px is not None) is tissue
    assert (row.tool_area_px is not None) is (tool_px is not None)
    assert row.keypoint_count is None
