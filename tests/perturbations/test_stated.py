"""What is said of cameras, instrument, tag and plane: off by the strength, and back again."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from svmdist.camera import Camera, stereo_transform
from svmdist.errors import UsageError
from svmdist.perturbations import apply, parse_perturbations
from svmdist.perturbations.apply import perturbed_image, perturbed_right_view
from svmdist.profile import Profile
from svmdist.samples import RightView
from svmdist.transforms import rotation_angle
from tests.shipped import PROFILE
from tests.synthetic import make_scene

LEFT = Camera.from_horizontal_fov(640, 480, 1.0)


RIGHT = replace(LEFT, P=LEFT.K @ np.column_stack([np.eye(3), [-0.005, 0.0, 0.0]]))


def test_focal_length_and_principal_point_are_off_in_K_and_P_and_leave_the_pair():
    chosen = parse_perturbations("focal=1,principal_point=5")
    left = apply.nominal_camera(LEFT, chosen)
    right = apply.nominal_camera(RIGHT, chosen, right=True)
    expected = LEFT.K * [[1.01, 1.0, 1.0], [1.0, 1.01, 1.0], [1.0] * 3] + 5.0 * np.eye(3, k=2)
    expected[1, 2] += 5.0
    np.testing.assert_allclose(left.K, expected)
    np.testing.assert_allclose(left.P, np.hstack([expected, np.zeros((3, 1))]))
    np.testing.assert_allclose(right.P[:, :3], expected)
    np.testing.assert_allclose(stereo_transform(left, right), stereo_transform(LEFT, RIGHT), atol=1e-12)
    assert apply.nominal_camera(LEFT, parse_perturbations("baseline=1")) is LEFT


@pytest.mark.parametrize("zoom", [0.8, 1.1])
def test_a_zoomed_image_is_that_of_a_zoomed_camera(zoom):
    """A blob that the true camera shows at a point is in the enlarged image where the zoomed camera projects it."""
    scene = make_scene(640, 480)
    point_m = np.array([[0.01, -0.015, 0.1]])
    image = blob_image(scene.camera.project(point_m)[0])
    found = middle_px(perturbed_image(image, parse_perturbations(f"zoom={zoom}")))
    np.testing.assert_allclose(found, apply.zoomed_camera(scene.camera, zoom).project(point_m)[0], atol=0.1)
    assert perturbed_image(image, parse_perturbations("focal=1")) is image


EVERYTHING = "plane={p},plane_tilt={t},shaft_radius={s},wrist_length={w},knuckle_radius={k},tag_size={g},tag_mount={m}"


@pytest.mark.parametrize("name", ["right_yaw", "right_pitch", "right_roll"])
def test_a_turned_image_is_that_of_a_turned_camera(name):
    """A blob is where the turned camera projects its point, all three axes alike."""
    camera = make_scene(640, 480).camera
    turn = apply.right_turn(parse_perturbations(f"{name}=2"))
    point_m = np.array([[0.012, -0.015, 0.1]])
    image = blob_image(camera.project(point_m)[0])
    before = RightView(image, camera, np.eye(4))
    after = perturbed_right_view(before, parse_perturbations(f"{name}=2,zoom=1.05"))
    expected = apply.zoomed_camera(camera, 1.05).project(point_m @ turn)[0]
    assert np.linalg.norm(expected - camera.project(point_m)[0]) > 2.0
    np.testing.assert_allclose(middle_px(after.image_bgr), expected, atol=0.1)
    assert perturbed_right_view(before, parse_perturbations("focal=1")).image_bgr is image


def blob_image(at_px: np.ndarray) -> np.ndarray:
    y, x = np.mgrid[:480, :640]
    blob = 255.0 * np.exp(-((x - at_px[0]) ** 2 + (y - at_px[1]) ** 2) / 18.0)
    return np.repeat(blob[..., None], 3, axis=2).astype(np.uint8)


def middle_px(image: np.ndarray) -> np.ndarray:
    y, x = np.mgrid[:480, :640]
    weight = image[..., 0].astype(float)
    return np.array([(weight * x).sum(), (weight * y).sum()]) / weight.sum()


@given(st.tuples(*[st.floats(-3.0, 3.0)] * 7), st.integers(0, 99))
def test_what_is_said_of_what_is_built_is_the_profile(strengths, seed):
    """Build from the profile and say what is not so: the profile again. That makes both directions one thing."""
    chosen = parse_perturbations(EVERYTHING.format(**dict(zip("ptswkgm", strengths, strict=True))))
    said = apply.nominal_profile(apply.built_profile(PROFILE, chosen, seed), chosen, seed)
    np.testing.assert_allclose(numbers(said), numbers(PROFILE), atol=1e-12)


def numbers(profile: Profile) -> np.ndarray:
    """All numbers of a profile that perturbations change."""
    robot, instrument, tag, tissue = profile.robot, profile.instrument, profile.fiducial, profile.tissue
    sizes = (instrument.shaft_radius_m, instrument.knuckle_radius_m, tag.size_m, tissue.plane_distance_m)
    links = [joint.a_m for joint in robot.joints]
    return np.array([*sizes, *links, *tag.T_link_tag.ravel(), *tissue.plane_normal])


def test_each_name_changes_its_own_length():
    chosen = parse_perturbations(EVERYTHING.format(p=1, t=2, s=5, w=1, k=5, g=2, m=0.5))
    said = apply.nominal_profile(PROFILE, chosen, 7)
    assert said.instrument.shaft_radius_m == pytest.approx(0.0042)
    assert said.instrument.knuckle_radius_m == pytest.approx(0.0018375)
    assert said.fiducial.size_m == pytest.approx(0.00714)
    assert {joint.name: joint.a_m for joint in said.robot.joints}["wrist_pitch"] == pytest.approx(0.0101)
    assert said.tissue.plane_distance_m == pytest.approx(0.113)
    tilt = np.arccos(-said.tissue.plane_normal[2])
    assert np.degrees(tilt) == pytest.approx(2.0)
    assert np.degrees(rotation_angle(apply.plane_tilt(chosen, 7), np.eye(3))) == pytest.approx(2.0)
    shift_m = np.subtract(said.fiducial.position_m, PROFILE.fiducial.position_m)
    assert np.linalg.norm(shift_m) == pytest.approx(0.0005)
    turned = rotation_angle(said.fiducial.T_link_tag[:3, :3], PROFILE.fiducial.T_link_tag[:3, :3])
    assert np.degrees(turned) == pytest.approx(0.5 * apply.TURN_DEG_PER_MM)
    near = PROFILE.model_copy(update={"tissue": PROFILE.tissue.model_copy(update={"plane_distance_m": 0.01})})
    with pytest.raises(UsageError, match="10 mm behind the camera"):
        apply.nominal_profile(near, parse_perturbations("plane=-20"), 1)
    other = apply.nominal_profile(PROFILE, chosen, 8)
    assert other.fiducial.position_m != said.fiducial.position_m
    assert other.tissue.plane_normal != said.tissue.plane_normal
