"""Forms of an image: first field, undistorted, rectified, by colour."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svmdist.camera import Camera
from svmdist.estimation.instrument.shaft import detect_distal_marker
from svmdist.profile import load_profile
from svmdist.profile.segmentation import ColourRegion
from svmdist.profile.settings import DistalMarkerSettings, OutlineSettings
from svmdist.samples import Image, Observation, RightView
from svmdist.transforms import Array, make_transform, rotation_of
from svmdist.vision.colour import colour_mask
from svmdist.vision.frame_context import as_pinholes, first_field, mixes_colours
from svmdist.vision.instruments.find_instruments import auto_masks
from svmdist.vision.regions import find_region, fit_disc
from svmdist.vision.stereo import matched_place, rectified_pair


def with_disc(x_px: float, seed: int = 1) -> Image:
    """A bright disc of 30 px radius over a textured ground, with sensor noise."""
    ground = np.random.default_rng(5).uniform(60, 120, (480, 640, 3)).astype(np.float32)
    image = cv2.GaussianBlur(ground, (0, 0), 2.0)
    cv2.circle(image, (round(16 * x_px), 240 * 16), 30 * 16, (230.0, 220.0, 90.0), -1, cv2.LINE_AA, 4)
    image += np.random.default_rng(seed).normal(0.0, 2.0, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def centre_x_px(image: Image) -> float:
    inside = image[..., 0] > 180
    return float(np.mean(np.nonzero(inside)[1]))


@pytest.mark.parametrize("size", [(1, 1), (2, 2), (4, 640), (1, 640), (480, 1)])
def test_an_image_may_have_any_size(size):
    """There is nothing in it, and that is no error."""
    image = np.full((*size, 3), 90, np.uint8)
    assert first_field(image) is image
    masks = auto_masks(image)
    assert masks.seen == ()
    assert masks.picture.shape == size


@pytest.mark.parametrize("moved_px", [3.0, 8.0, 20.0])
def test_what_moves_is_where_the_first_field_shows_it(moved_px):
    """Its middle within 0.3 px; as woven it is off by half of the motion between both fields."""
    image = with_disc(300.0)
    image[1::2] = with_disc(300.0 + moved_px, seed=2)[1::2]
    assert centre_x_px(image) > 300.0 + 0.4 * moved_px
    mended = first_field(image)
    assert centre_x_px(mended) == pytest.approx(300.0, abs=0.3)
    np.testing.assert_array_equal(mended[::2], image[::2])
    np.testing.assert_array_equal(mended[:, 500:], image[:, 500:])


@pytest.mark.parametrize(
    ("kept", "mixed"),
    [
        (None, False),
        (cv2.IMWRITE_JPEG_SAMPLING_FACTOR_422, False),
        (cv2.IMWRITE_JPEG_SAMPLING_FACTOR_420, True),
    ],
)
def test_colours_of_both_fields_are_mixed_where_they_are_kept_for_two_rows(kept, mixed):
    """As recorded, and in JPEGs: 4:2:2 has colours for each row, 4:2:0 for each two."""
    image = with_disc(300.0)
    image[1::2] = with_disc(308.0, seed=2)[1::2]
    if kept is not None:
        how = [cv2.IMWRITE_JPEG_QUALITY, 92, cv2.IMWRITE_JPEG_SAMPLING_FACTOR, kept]
        image = np.asarray(cv2.imdecode(cv2.imencode(".jpg", image, how)[1], cv2.IMREAD_COLOR), np.uint8)
    assert mixes_colours(image) is mixed


MIDDLE_PX = np.array([31.3, 28.6])


def bloody_disc(angle: float, hidden: float) -> tuple[Image, Image]:
    """HSV and mask of a disc of 10 px a side up to `hidden` radii from its rim, under blood."""
    radius_px, big = 10.0, 8
    y, x = np.mgrid[: 60 * big, : 60 * big]
    off_px = np.stack([x, y], -1) / big + (0.5 / big - 0.5) - MIDDLE_PX
    is_in = np.linalg.norm(off_px, axis=-1) < radius_px
    is_blood = is_in & (off_px @ np.array([np.cos(angle), np.sin(angle)]) > (1.0 - hidden) * radius_px)
    bgr = np.where(is_in[..., None], (200, 190, 20), (110, 110, 200)).astype(np.uint8)
    bgr[is_blood] = (15, 15, 110)
    image = cv2.GaussianBlur(cv2.resize(bgr, (60, 60), interpolation=cv2.INTER_AREA), (0, 0), 1.0)
    hsv = cv2.cvtColor(image, cv2.COLOR_BGR2HSV)
    return hsv, np.asarray(cv2.inRange(hsv, (75, 90, 40), (105, 255, 255)), np.uint8)


@pytest.mark.parametrize("angle", [0.0, 2.0, 4.0])
@pytest.mark.parametrize("hidden", [0.0, 0.5])
def test_a_disc_is_where_it_is_though_blood_hides_a_side(angle, hidden):
    """18 % of its area and 30 % of its border."""
    hsv, mask = bloody_disc(angle, hidden)
    seen = np.argwhere(mask > 0)[:, ::-1].mean(0)
    disc = fit_disc(hsv, mask, seen, float(np.sqrt(np.count_nonzero(mask) / np.pi)))
    np.testing.assert_allclose(disc.centre_px, MIDDLE_PX, atol=0.3)
    assert disc.radius_px == pytest.approx(10.0, abs=0.3)
    if hidden:
        assert np.linalg.norm(seen - MIDDLE_PX) > 1.0


@pytest.mark.parametrize("angle", [0.0, 2.0, 4.0])
@pytest.mark.parametrize("hidden", [0.0, 0.3, 0.5, 0.6, 0.8])
def test_a_marker_under_blood_is_as_large_as_its_deviation_says(angle, hidden):
    """A whole one is known to a twentieth; of one whose border is mostly that of blood there is no size."""
    hsv, mask = bloody_disc(angle, hidden)
    region = find_region(mask, load_profile().segmentation.instrument, OutlineSettings())
    marker = detect_distal_marker(hsv, mask, region, DistalMarkerSettings())
    assert (marker.radius_px is None) == (hidden > 0.6)
    if marker.radius_px is not None:
        assert abs(marker.radius_px - 10.0) < 1.5 * marker.radius_std_px
        assert (marker.radius_std_px < 0.6) == (hidden < 0.4)


def lit_ball(limb: float, block_px: int = 1, size: float = 1.0) -> tuple[Image, Image]:
    """HSV and mask of a ball of 10 px, or a `size` of that, under a lamp at the camera, with so much light at the limb.

    Colours are those of blocks, as a codec leaves them.
    """
    big = 8
    y, x = np.mgrid[: 60 * big, : 60 * big]
    off_px = np.stack([x, y], -1) / big + (0.5 / big - 0.5) - MIDDLE_PX
    inside = np.sqrt(np.maximum(1.0 - (off_px**2).sum(-1) / (10.0 * size) ** 2, 0.0))[..., None]
    bgr = np.where(inside > 0.0, (limb + (1.0 - limb) * inside) * [170.0, 165.0, 8.0], [85.0, 90.0, 95.0])
    image = cv2.GaussianBlur(cv2.resize(bgr.astype(np.uint8), (60, 60), interpolation=cv2.INTER_AREA), (0, 0), size)
    luma = cv2.cvtColor(image, cv2.COLOR_BGR2YCrCb)
    blocks = cv2.resize(luma, (60 // block_px,) * 2, interpolation=cv2.INTER_AREA)
    luma[..., 1:] = cv2.resize(blocks, (60, 60), interpolation=cv2.INTER_NEAREST)[..., 1:]
    hsv = cv2.cvtColor(cv2.cvtColor(luma, cv2.COLOR_YCrCb2BGR), cv2.COLOR_BGR2HSV)
    return hsv, np.asarray(cv2.inRange(hsv, (75, 90, 40), (105, 255, 255)), np.uint8)


@pytest.mark.parametrize(("limb", "block_px"), [(1.0, 1), (0.5, 1), (0.1, 1), (1.0, 3), (0.5, 3)])
def test_a_ball_is_as_large_as_its_deviation_says_in_any_light(limb, block_px):
    """Its colour fades towards a dark limb; where it is coarse, half of it is left elsewhere than it falls off most."""
    hsv, mask = lit_ball(limb, block_px)
    region = find_region(mask, load_profile().segmentation.instrument, OutlineSettings())
    marker = detect_distal_marker(hsv, mask, region, DistalMarkerSettings())
    off_px = abs(marker.radius_px - 10.0)
    assert off_px < 1.5 * marker.radius_std_px
    assert off_px < 0.45 or block_px > 1
    assert (marker.radius_std_px > 0.55) == (block_px > 1)


def test_a_disc_of_three_pixels_is_measured_or_refused_from_any_rough_radius():
    hsv, mask = lit_ball(1.0, size=0.16)
    found = [fit_disc(hsv, mask, MIDDLE_PX, radius_px) for radius_px in (0.6, 0.8, 1.0, 1.3, 1.6)]
    assert found[-1].radius_px == pytest.approx(1.6, abs=0.1)


IDEAL = Camera.from_horizontal_fov(640, 480, np.pi / 3)
LENSES = {
    "plumb_bob": replace(IDEAL, D=np.array([-0.2, 0.05, 1e-3, -5e-4, 0.01])),
    "rational_polynomial": replace(
        IDEAL,
        D=np.array([0.3, -0.1, 1e-4, 2e-4, 0.02, 0.5, -0.05, 0.01]),
        distortion_model="rational_polynomial",
    ),
    "fisheye": replace(IDEAL, D=np.array([0.05, -0.01, 0.002, 0.0]), distortion_model="fisheye"),
}
POINTS_M = np.array(
    [[-0.03, -0.02, 0.09], [0.03, -0.02, 0.1], [0.0, 0.0, 0.08], [-0.02, 0.02, 0.1], [0.025, 0.018, 0.085]]
)


def drawn(camera: Camera, points_m: Array = POINTS_M) -> Image:
    """White discs of 6 px at points of the camera frame, to a sixteenth of a pixel."""
    image = np.zeros((480, 640, 3), np.uint8)
    for x, y in camera.project(points_m):
        cv2.circle(image, (round(x * 16), round(y * 16)), 96, (255, 255, 255), -1, cv2.LINE_AA, 4)
    return image


def centres(image: Image) -> Array:
    """Centroids of the discs, sorted along x, shape (n, 2)."""
    count, labels = cv2.connectedComponents((image[..., 0] > 20).astype(np.uint8))
    ys, xs = np.mgrid[:480, :640]
    found = []
    for label in range(1, count):
        weight = image[..., 0] * (labels == label).astype(np.float64)
        found.append([(weight * xs).sum() / weight.sum(), (weight * ys).sum() / weight.sum()])
    return np.array(sorted(found))


@pytest.mark.parametrize("lens", LENSES)
def test_points_are_where_an_ideal_camera_sees_them(lens):
    """Within 0.15 px all over the image, of which distortion moves some by more than 5 px."""
    camera = LENSES[lens]
    seen = as_pinholes(Observation(0, drawn(camera), camera))
    assert not seen.camera.has_distortion
    expected = np.array(sorted(IDEAL.project(POINTS_M).tolist()))
    assert np.abs(camera.project(POINTS_M) - IDEAL.project(POINTS_M)).max() > 5.0
    np.testing.assert_allclose(centres(seen.image_bgr), expected, atol=0.15)


def test_a_turned_and_distorted_right_camera_becomes_parallel():
    """A camera turned by degrees, with a lens and a K of its own: rows agree, and disparity is f b / z, in 0.2 px."""
    own = replace(LENSES["plumb_bob"], K=IDEAL.K * np.array([[1.02], [1.02], [1.0]]) + np.diag([1.0, -1.0, 0.0]))
    T_left_right = make_transform(rotation_of([0.02, -0.03, 0.015]), [0.005, 0.0, 0.0])
    in_right_m = (POINTS_M - T_left_right[:3, 3]) @ T_left_right[:3, :3]
    camera = LENSES["plumb_bob"]
    seen = as_pinholes(
        Observation(0, drawn(camera), camera, right=RightView(drawn(own, in_right_m), own, T_left_right))
    )
    pair = rectified_pair(seen.camera, seen.right)
    left_px, right_px = centres(seen.image_bgr), centres(seen.right.image_bgr)
    depths_m = POINTS_M[np.argsort(IDEAL.project(POINTS_M)[:, 0]), 2]
    np.testing.assert_allclose(left_px[:, 1], right_px[:, 1], atol=0.2)
    disparities_px = left_px[:, 0] - right_px[:, 0] - pair.offset_px
    np.testing.assert_allclose(disparities_px, [pair.disparity_at(z) for z in depths_m], atol=0.2)


hues = st.integers(0, 179)
bounds = st.tuples(st.integers(0, 255), st.integers(0, 255)).map(sorted).map(tuple)


@settings(max_examples=80)
@given(hues, hues, bounds, bounds, st.integers(0, 99))
def test_a_mask_equals_the_definition(first, last, saturation, value, seed):
    """Every box selects exactly the pixels that its bounds include; a hue's range may wrap."""
    region = ColourRegion(hue=(first, last), saturation=saturation, value=value, min_area_px=1)
    image_hsv = np.random.default_rng(seed).integers(0, [180, 256, 256], (24, 24, 3)).astype(np.uint8)
    h, s, v = np.moveaxis(image_hsv, -1, 0)
    inside = (h >= first) & (h <= last) if first <= last else (h >= first) | (h <= last)
    for values, (low, high) in ((s, saturation), (v, value)):
        inside &= (values >= low) & (values <= high)
    np.testing.assert_array_equal(colour_mask(image_hsv, region), np.where(inside, 255, 0))


@pytest.mark.parametrize("half_px", [4.0, 200.0])
def test_a_patch_of_any_width_is_found_in_the_other_view(half_px):
    """12 px to the left and 2 rows below; a patch of 401 px is wider than what OpenCV samples at once."""
    image = cv2.GaussianBlur(np.random.default_rng(3).integers(0, 256, (480, 640), np.uint8), (0, 0), 1.5)
    beside = np.roll(image, (2, -12), (0, 1))
    places_px = np.array([[320.0 - off, 240.0] for off in range(0, 25, 4)])
    assert matched_place((image, beside), np.array([320.0, 240.0]), half_px, places_px) == 3
