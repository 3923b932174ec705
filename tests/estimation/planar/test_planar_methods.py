"""Both estimators on drawn frames whose truth is known: a red organ, a cyan tool, textured ground."""

from __future__ import annotations

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svmdist.camera import Camera
from svmdist.errors import UsageError
from svmdist.estimation.methods import make_estimator
from svmdist.estimation.plane_mapping import PlaneMapping, Quadratic
from svmdist.estimation.scene import Arm
from svmdist.profile import load_profile
from svmdist.samples import Observation, Status
from tests.measuring import Measuring

CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)
PROFILE = load_profile()
MAPPING = PlaneMapping("corrected", Quadratic(0.0, 0.8, 0.0), Quadratic(0.0, 0.8, 0.0))
METRES_PER_PX = 0.0254 * 0.8 / 100.0
TISSUE_PX = (330.0, 250.0)
PLANAR = ("overlay", "centroid")
ESTIMATORS = {method: Measuring(method, PROFILE, MAPPING) for method in PLANAR}


def ground(seed: int = 1) -> np.ndarray:
    """A dull textured ground without the colours of tissue or instrument."""
    grey = np.random.default_rng(seed).integers(60, 130, (60, 80)).astype(np.uint8)
    smooth = cv2.resize(grey, (640, 480), interpolation=cv2.INTER_CUBIC)
    return np.asarray(cv2.merge([smooth, smooth, smooth]), np.uint8)


def frame(
    tool_px: tuple[float, float] | None, tissue: bool = True, seed: int = 1, radius_px: float = 12.0
) -> Observation:
    """A frame drawn pixel by pixel: the red ellipse about TISSUE_PX, and the cyan disc over it."""
    image = ground(seed)
    ys, xs = np.mgrid[:480, :640]
    if tissue:
        image[((xs - TISSUE_PX[0]) / 150) ** 2 + ((ys - TISSUE_PX[1]) / 110) ** 2 <= 1] = (70, 60, 200)
    if tool_px is not None:
        image[(xs - tool_px[0]) ** 2 + (ys - tool_px[1]) ** 2 <= radius_px**2] = (210, 190, 30)
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
@settings(deadline=None, max_examples=25)
@given(x=st.floats(2.0, 637.0), y=st.floats(2.0, 477.0), seed=st.integers(0, 50))
def test_places_are_found_all_over_the_image(method, x, y, seed):
    """Tool and tissue are found within 1 px of the truth wherever the tool is, and the distance within 0.3 mm.

    Near the border the disc is cut, so the truth there is the centroid of what is left to see.
    """
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
def test_a_shift_of_the_tool_is_recovered(method):
    """A tool moved by 20 px moves by 20 px within half a pixel at either end, whole pixels of the paste."""
    rows = [ESTIMATORS[method].estimate(frame((x, 100.0))) for x in (200.0, 220.0)]
    assert rows[1].tool_x_px - rows[0].tool_x_px == pytest.approx(20.0, abs=1.0)
    assert rows[1].tissue_x_px == pytest.approx(rows[0].tissue_x_px, abs=1e-9)


def test_the_marker_adds_counts_and_at_most_a_pixel():
    """overlay and centroid agree within 1 px: the marker recovers its own paste position, no depth."""
    observation = frame((150.3, 120.8))
    overlay, centroid = (ESTIMATORS[method].estimate(observation) for method in ("overlay", "centroid"))
    assert math.dist((overlay.tool_x_px, overlay.tool_y_px), (centroid.tool_x_px, centroid.tool_y_px)) < 1.0
    assert overlay.inlier_count is not None
    assert 40 <= overlay.inlier_count <= overlay.match_count <= overlay.keypoint_count
    assert (centroid.keypoint_count, centroid.match_count, centroid.inlier_count) == (None, None, None)


@pytest.mark.parametrize("method", PLANAR)
@pytest.mark.parametrize(
    ("tool_px", "tissue", "status"),
    [
        (None, True, Status.NO_INSTRUMENT),
        ((100.0, 100.0), False, Status.NO_TISSUE),
        (None, False, Status.NO_TISSUE),
    ],
)
def test_a_missing_region_is_the_reason(method, tool_px, tissue, status):
    """Without tissue or instrument the row says which, holds what was found, and has no distance."""
    row = ESTIMATORS[method].estimate(frame(tool_px, tissue))
    assert row.status is status
    check_consistent(row)
    assert (row.tissue_area_px is not None) is tissue
    assert (row.tool_area_px is not None) is (tool_px is not None)
    assert row.keypoint_count is None


@pytest.mark.parametrize(("radius_px", "status"), [(5.5, Status.NO_INSTRUMENT), (6.5, Status.OK)])
def test_the_instrument_needs_more_than_its_gate(radius_px, status):
    """A disc of 97 px is below the gate of 100 px and is no instrument; one of 137 px is."""
    assert ESTIMATORS["overlay"].estimate(frame((100.0, 100.0), radius_px=radius_px)).status is status


def with_features(**changes: float) -> object:
    """The overlay estimator with other feature rules."""
    return Measuring(
        "overlay",
        PROFILE.model_copy(update={"features": PROFILE.features.model_copy(update=changes)}),
        MAPPING,
    )


def test_too_few_matches_are_a_reason_with_counts():
    """If more matches are asked for than there are, the row says so: it has counts but no inliers."""
    row = with_features(min_match_count=5000).estimate(frame((100.0, 100.0)))  # type: ignore[attr-defined]
    assert row.status is Status.TOO_FEW_MATCHES
    check_consistent(row)
    assert row.keypoint_count > row.match_count > 40
    assert row.inlier_count is None
    assert row.tool_x_px == pytest.approx(100.0, abs=0.5)  # as far as segmentation got


def test_an_outline_that_cannot_be_seen_is_a_reason():
    """If the outline's colour is not the one searched for, the third contour fails and says so."""
    marker = PROFILE.marker.model_copy(update={"outline_bgr": (255, 0, 255)})
    estimator = Measuring("overlay", PROFILE.model_copy(update={"marker": marker}), MAPPING)
    row = estimator.estimate(frame((100.0, 100.0)))
    assert row.status is Status.NO_OUTLINE
    check_consistent(row)
    assert row.inlier_count is not None


@pytest.mark.parametrize("method", PLANAR)
def test_a_distance_that_is_no_number_rejects_the_frame(method):
    """Coefficients that overflow give not_finite, never an infinite distance in an average."""
    huge = PlaneMapping("corrected", Quadratic(1e308, 1e308, 0.0), Quadratic(0.0, 1.0, 0.0))
    with np.errstate(over="ignore", invalid="ignore"):
        row = Measuring(method, PROFILE, huge).estimate(frame((100.0, 100.0)))
    assert row.status is Status.NOT_FINITE
    check_consistent(row)


@pytest.mark.parametrize("method", PLANAR)
def test_two_runs_give_equal_rows(method):
    """An estimator keeps nothing between frames: other frames in between change no bit of a row."""
    observation = frame((222.2, 333.3), seed=4)
    first = ESTIMATORS[method].estimate(observation)
    ESTIMATORS[method].estimate(frame((30.0, 40.0), seed=5))
    ESTIMATORS[method].estimate(frame(None))
    assert ESTIMATORS[method].estimate(observation) == first
    assert Measuring(method, PROFILE, MAPPING).estimate(observation) == first


@pytest.mark.parametrize("method", PLANAR)
def test_an_estimator_leaves_the_image_alone(method):
    """Marker and outline are drawn on a copy: the observation's image can be used again."""
    observation = frame((100.0, 100.0))
    before = observation.image_bgr.copy()
    observation.image_bgr.setflags(write=False)
    ESTIMATORS[method].estimate(observation)
    np.testing.assert_array_equal(observation.image_bgr, before)


@pytest.mark.parametrize("method", PLANAR)
def test_the_stamp_is_the_observations(method):
    """The row carries the stamp of its frame as an integer, measured or not."""
    for observation in (frame((100.0, 100.0)), frame(None)):
        late = replace(observation, stamp_ns=1_700_000_000_123_456_789)
        assert ESTIMATORS[method].estimate(late).stamp_ns == 1_700_000_000_123_456_789


def test_an_unknown_method_lists_the_methods():
    """A misspelt method raises UsageError with the nearest one and all there are."""
    with pytest.raises(UsageError, match=r"no method overley: did you mean overlay.* centroid, .*overlay"):
        make_estimator("overley", Arm(PROFILE), MAPPING)
