"""ORB features, matching and the patch geometry of eqs. (9) to (16), held against OpenCV's own."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.vision.marker import (
    DESCRIPTOR_BYTES,
    EDGE_MARGIN_PX,
    Features,
    detect_orb,
    match_features,
)
from tests.vision.marker.patch import (
    HALF_PATCH_PX,
    binary_test,
    intensity_centroid,
    orientation,
    patch_moments,
)


def hamming(a: np.ndarray, b: np.ndarray) -> int:
    """Number of bits in which two descriptors, shape (32,), differ."""
    return int(np.unpackbits(a ^ b).sum())


def textured_grey(seed: int = 1) -> np.ndarray:
    """A grey image of random blotches with plenty of corners, shape (240, 320)."""
    coarse = np.random.default_rng(seed).integers(0, 256, (40, 53)).astype(np.uint8)
    return np.asarray(cv2.resize(coarse, (320, 240), interpolation=cv2.INTER_CUBIC), np.uint8)


def features_of(*descriptors: int) -> Features:
    """Features whose descriptors have that many leading one bits, at (0, 0), (1, 1) and so on."""
    bits = np.array([[1] * count + [0] * (256 - count) for count in descriptors], np.uint8)
    points_px = np.repeat(np.arange(len(descriptors), dtype=float)[:, None], 2, 1)
    return Features(points_px, np.packbits(bits.reshape(-1, 256), axis=1))


@pytest.mark.parametrize("shape", [(240, 320), (62, 62), (16, 16), (1, 1)])
def test_an_image_without_features_gives_none(shape):
    """A uniform image, however small, gives no features of the right shapes rather than an error."""
    features = detect_orb(np.full(shape, 128, np.uint8), 500)
    assert len(features) == 0
    assert features.points_px.shape == (0, 2)
    assert features.descriptors.shape == (0, DESCRIPTOR_BYTES)


def test_features_lie_inside_the_mask():
    """With a mask, every feature lies on a set pixel, and there are features."""
    mask = np.zeros((240, 320), np.uint8)
    cv2.circle(mask, (160, 120), 50, 255, -1)
    features = detect_orb(textured_grey(), 500, mask)
    assert len(features) > 20
    x, y = np.round(features.points_px).astype(int).T
    # Keypoints of coarser levels are mapped back by fractions of a pixel.
    assert np.all(cv2.dilate(mask, np.ones((7, 7), np.uint8))[y, x] == 255)


def test_descriptors_hold_256_bits():
    """n = 256 tests are 32 bytes (eqs. 13 to 16), and Hamming distance counts bits."""
    features = detect_orb(textured_grey(), 200)
    assert features.descriptors.shape == (len(features), 32)
    assert features.descriptors.dtype == np.uint8
    zeros, ones = np.zeros(32, np.uint8), np.full(32, 255, np.uint8)
    assert (
        hamming(zeros, ones),
        hamming(zeros, zeros),
        hamming(zeros, np.eye(1, 32, dtype=np.uint8)[0]),
    ) == (256, 0, 1)


def test_hamming_distance_equals_opencvs():
    """The distance written out equals that of OpenCV's matcher for every descriptor."""
    features = detect_orb(textured_grey(), 60)
    others = detect_orb(textured_grey(2), 60)
    for match in cv2.BFMatcher(cv2.NORM_HAMMING).match(features.descriptors, others.descriptors):
        assert (
            hamming(features.descriptors[match.queryIdx], others.descriptors[match.trainIdx])
            == match.distance
        )


def test_the_ratio_test_keeps_only_what_is_clearly_nearer():
    """Distances 10 against 20 pass a ratio of 0.75; 15 against 20 do not, since 15 = 0.75 * 20."""
    frame = features_of(0, 100)
    clear = match_features(features_of(10), features_of(0, 30), ratio=0.75)  # 10 against 20
    assert len(clear) == 1
    np.testing.assert_array_equal(clear.frame_px, [[0.0, 0.0]])
    assert len(match_features(features_of(15), features_of(0, 35), ratio=0.75)) == 0  # 15 against 20
    assert len(match_features(features_of(50), frame, ratio=0.75)) == 0  # 50 against 50


def test_matches_are_those_of_opencvs_matcher():
    """Of two textures of which one is part of the other: the pairs of knnMatch that pass the ratio test, sorted."""
    image = textured_grey()
    template, frame = detect_orb(image[40:200, 60:260], 300), detect_orb(image, 500)
    pairs = cv2.BFMatcher(cv2.NORM_HAMMING).knnMatch(template.descriptors, frame.descriptors, k=2)
    kept = [first for first, second in pairs if first.distance < 0.75 * second.distance]
    kept.sort(key=lambda match: (match.distance, match.queryIdx))
    assert len(kept) > 20
    matches = match_features(template, frame, ratio=0.75)
    np.testing.assert_array_equal(matches.template_px, template.points_px[[m.queryIdx for m in kept]])
    np.testing.assert_array_equal(matches.frame_px, frame.points_px[[m.trainIdx for m in kept]])


@pytest.mark.parametrize("side_px", [63, 75, 76, 110, 158, 240])
def test_levels_that_are_all_margin_hold_no_keypoint(side_px):
    """The pyramid stops where no keypoint can be: OpenCV's eight levels give the same features."""
    image = textured_grey()[:side_px, :side_px]
    orb = cv2.ORB_create(nfeatures=10_000, edgeThreshold=EDGE_MARGIN_PX, patchSize=EDGE_MARGIN_PX)
    keypoints, descriptors = orb.detectAndCompute(image, None)
    features = detect_orb(image, 10_000)
    assert len(features) == len(keypoints)
    if len(keypoints):
        np.testing.assert_array_equal(features.points_px, [keypoint.pt for keypoint in keypoints])
        np.testing.assert_array_equal(features.descriptors, descriptors)


@pytest.mark.parametrize(("template", "frame"), [((), (0, 1)), ((0, 1), ()), ((0, 50), (0,)), ((), ())])
def test_without_two_neighbours_there_is_no_match(template, frame):
    """A frame with a single feature has no second neighbour to compare with, so nothing matches."""
    matches = match_features(features_of(*template), features_of(*frame), ratio=0.75)
    assert len(matches) == 0
    assert matches.template_px.shape == matches.frame_px.shape == (0, 2)


def test_matches_come_best_first():
    """Matches are sorted by distance, and each pairs the points that belong together."""
    matches = match_features(features_of(103, 1, 202), features_of(0, 100, 200), ratio=0.75)
    np.testing.assert_array_equal(matches.template_px[:, 0], [1, 2, 0])  # distances 1, 2 and 3
    np.testing.assert_array_equal(matches.frame_px[:, 0], [0, 2, 1])


def test_the_patch_angle_equals_opencvs():
    """Eqs. (9) to (11) give the angle of OpenCV's ORB keypoints at full resolution within 0.5°.

    OpenCV's fastAtan2 is itself only good to about 0.3°. The moments are taken from the image before
    ORB blurs it for the descriptor.
    """
    image = textured_grey(3)
    orb = cv2.ORB_create(nfeatures=300, nlevels=1, edgeThreshold=31, patchSize=31)
    keypoints = orb.detect(image, None)
    assert len(keypoints) > 50
    for keypoint in keypoints:
        x, y = round(keypoint.pt[0]), round(keypoint.pt[1])
        off = np.degrees(orientation(patch_moments(image, x, y))) - keypoint.angle
        assert abs((off + 180) % 360 - 180) < 0.5


def test_the_intensity_centroid_points_to_the_bright_side():
    """For a patch that is bright on the right, C of eq. (10) lies to the right and θ of eq. (11) is 0."""
    image = np.zeros((61, 61), np.uint8)
    image[:, 31:] = 200
    moments = patch_moments(image, 30, 30)
    x, y = intensity_centroid(moments)
    assert x > 5
    assert y == pytest.approx(0.0, abs=1e-12)
    assert orientation(moments) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("turns", [1, 2, 3])
def test_the_orientation_turns_with_the_image(turns):
    """A quarter turn of the image turns θ by a quarter: atan2 keeps the quadrant that a quotient loses."""
    image = textured_grey(5)[:61, :61]
    start, turned = (orientation(patch_moments(each, 30, 30)) for each in (image, np.rot90(image, -turns)))
    assert (turned - start - turns * np.pi / 2 + np.pi) % (2 * np.pi) - np.pi == pytest.approx(0.0, abs=1e-9)


def test_a_uniform_patch_has_the_area_of_its_disc():
    """m00 of a patch of ones counts the disc's pixels, about π r², and its first moments vanish."""
    moments = patch_moments(np.ones((40, 40), np.uint8), 20, 20)
    assert moments[0] == pytest.approx(np.pi * (HALF_PATCH_PX + 0.5) ** 2, rel=0.05)
    np.testing.assert_array_equal(moments[1:], 0.0)


@pytest.mark.parametrize(("x", "y"), [(14, 30), (30, 14), (45, 30), (30, 45), (-1, 30)])
def test_a_patch_over_the_border_is_an_error(x, y):
    """A patch that leaves a 60 px image raises ValueError instead of wrapping around."""
    with pytest.raises(ValueError, match="border"):
        patch_moments(np.ones((60, 60), np.uint8), x, y)


def test_the_binary_test_follows_the_formula_not_the_prose():
    """τ of eq. (12) is 1 if the first point is darker, 0 if brighter or equal."""
    assert (binary_test(1, 2), binary_test(2, 1), binary_test(2, 2)) == (1, 0, 0)


def test_flipping_every_bit_leaves_hamming_distances_alone():
    """So the contradiction between eq. (12) and its prose changes no match."""
    a, b = np.random.default_rng(1).integers(0, 256, (2, 32)).astype(np.uint8)
    assert hamming(~a, ~b) == hamming(a, b)
