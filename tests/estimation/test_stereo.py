"""The method stereo on drawn pairs: what both views show is enough, and no more is claimed."""

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.association import Association
from svmdist.estimation.frame import Arm, Scene
from svmdist.estimation.frame_methods import ANY_ORIENTATION, triangulated_tool
from svmdist.estimation.instrument.distal_marker import Expected, pair_markers
from svmdist.estimation.instrument.factors import marked, of_images
from svmdist.estimation.methods import make_estimator
from svmdist.profile.segmentation import AutoSegmentation
from svmdist.results import FrameResult
from svmdist.samples import Image, Observation, RightView, Status
from svmdist.transforms import Array, make_transform, rotation_of
from svmdist.vision.frame_context import as_pinholes, make_segmenter
from svmdist.vision.instruments.find_instruments import auto_masks
from svmdist.vision.stereo import RowAlignment
from tests.golden import golden_frames
from tests.measuring import Measuring, frame_of
from tests.pictures import RED_BGR, ShaftImage, entering_from
from tests.shipped import PROFILE
from tests.synthetic import make_scene

CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)
BASELINE_M = 0.005
T_LEFT_RIGHT = make_transform(np.eye(3), [BASELINE_M, 0.0, 0.0])


@lru_cache(maxsize=32)
def drawn(angle_rad: float, right: bool, marker: bool = True) -> Image:
    """One view of a shaft that comes in at an angle."""
    hinge_m, direction = entering_from(angle_rad, CAMERA)
    hinge_m = hinge_m - [BASELINE_M * right, 0.0, 0.0]
    image = ShaftImage(CAMERA, hinge_m, direction, RED_BGR, marker=marker)
    return image.draw(parts=2, seed=int(right))


def tool_m(angle_rad: float) -> Array:
    """The tool's true place in the left camera."""
    return ShaftImage(CAMERA, *entering_from(angle_rad, CAMERA)).tool_m


def pair(left: Image, right: Image, T_left_right: Array = T_LEFT_RIGHT) -> Observation:
    return Observation(1, left, CAMERA, None, RightView(right, CAMERA, T_left_right))


def measured(observation: Observation) -> FrameResult:
    return Measuring("stereo", PROFILE).result(observation)


def deviations(result: FrameResult, angle_rad: float) -> float:
    """The error over what is stated of it, as one number of three degrees of freedom, rooted."""
    pose = result.tool.pose
    error_m = pose.position_m - tool_m(angle_rad)
    return float(np.sqrt(error_m @ np.linalg.solve(pose.position_covariance, error_m)))


ANGLES = (0.7, 2.4, 4.0, 5.6)
"""From where shafts come in: across rows, as edges must be for a disparity, but not along them."""


@pytest.mark.parametrize("angle_rad", ANGLES)
def test_plain_tissue_costs_no_row(angle_rad):
    """Without any texture to match, the tool is right to a millimetre and the surface is the profile's."""
    found = measured(pair(drawn(angle_rad, False), drawn(angle_rad, True)))
    assert found.status is Status.OK
    assert "surface" in found.detail
    assert np.linalg.norm(found.tool.pose.position_m - tool_m(angle_rad)) < 1e-3
    assert deviations(found, angle_rad) < 2.8


@pytest.mark.parametrize("level", [0, 128, 255])
def test_a_right_view_that_shows_nothing_is_no_stereo(level):
    """Black or plain, it matches textured tissue everywhere and nowhere; one view's pose is not passed for two's."""
    left = drawn(2.4, False).astype(np.int16) + np.random.default_rng(0).integers(-9, 9, (480, 640, 1))
    textured = np.asarray(np.clip(left, 0, 255), np.uint8)
    found = measured(pair(textured, np.full_like(textured, level)))
    assert found.status is Status.NO_STEREO
    assert "the right view shows neither" in found.detail


@pytest.mark.parametrize("hidden_left", [False, True])
def test_a_marker_in_one_view_is_enough(hidden_left):
    """Edges of the shaft in both views tell the depth that its disparity would."""
    found = measured(pair(*(drawn(2.4, view, marker=view == hidden_left) for view in (False, True))))
    assert found.status is Status.OK
    assert deviations(found, 2.4) < 2.8
    both = measured(pair(drawn(2.4, False), drawn(2.4, True)))
    assert both.tool.pose.position_std_m < found.tool.pose.position_std_m


@pytest.mark.parametrize(("size", "is_marker"), [(1.0, True), (0.55, False), (2.0, False)])
def test_what_is_coloured_and_of_another_size_is_somewhere_about_the_origin(size, is_marker):
    """Point and disparity share the offset, three radii of the marker that the profile states; its size is not used."""
    radius_m = size * PROFILE.instrument.knuckle_radius_m
    instrument = PROFILE.instrument.model_copy(update={"knuckle_radius_m": radius_m})
    profile = PROFILE.model_copy(update={"instrument": instrument, "fiducial": None})
    seen = pair(drawn(2.4, False), drawn(2.4, True))
    frame = frame_of(seen, Arm(profile), make_segmenter(profile.segmentation))
    markers = pair_markers(frame, frame.scene.stereo_pair)
    factors = {one.name: one for one in of_images(frame, markers.expected, markers, both_views=True)}
    assert ("size" in factors) is is_marker
    T = make_transform(np.eye(3), tool_m(2.4))
    for name, px_per_m in (("distal marker", 6000.0), ("disparity", 300.0)):
        one = factors[name]
        bias = one.linearise(T).biases[0]
        assert bias.name == ("distal marker" if is_marker else "other part")
        B = bias.jacobian
        std_px = float(np.sqrt((one.covariance + B @ B.T)[0, 0]))
        assert (std_px > px_per_m * radius_m * 2.0) is not is_marker, (name, std_px)
    placed = triangulated_tool(frame, ANY_ORIENTATION)
    assert (placed.position_std_m > 2.0 * radius_m) is not is_marker
    result = Measuring("stereo", profile).result(seen)
    if result.status is Status.OK:
        assert deviations(result, 2.4) < 2.8


def test_grey_steel_is_no_marker():
    """A region of bare steel, which the profile's box takes in, says nothing of where the tool's origin is."""
    image = np.full((480, 640, 3), (60, 60, 160), np.uint8)
    cv2.circle(image, (320, 240), 30, (120, 120, 120), -1)
    box = PROFILE.segmentation.instrument.model_copy(
        update={"hue": (0, 179), "saturation": (0, 20), "value": (60, 200)}
    )
    segmentation = PROFILE.segmentation.model_copy(update={"instrument": box})
    profile = PROFILE.model_copy(update={"segmentation": segmentation})
    frame = frame_of(Observation(1, image, CAMERA), Arm(profile), make_segmenter(segmentation))
    assert frame.left.region is not None
    assert not list(marked(frame.left, Arm(profile), Expected(0.09, 0.3)))


def test_what_ends_the_shaft_in_both_views_is_not_its_end():
    """Where nothing of the distal part is seen in either view there is no row."""
    found = measured(pair(*(drawn(2.4, right, marker=False) for right in (False, True))))
    assert found.status is Status.NO_INSTRUMENT
    assert "hidden" in found.detail


@pytest.mark.parametrize("rows_px", [-2.0, 1.5, 3.0])
def test_an_offset_between_the_rows_is_removed(rows_px):
    """Known, it costs nothing; unknown, edges that cross the rows put the shaft elsewhere."""
    left, right = drawn(2.4, False), drawn(2.4, True)
    shift = np.array([[1.0, 0.0, 0.0], [0.0, 1.0, rows_px]])
    lower = np.asarray(cv2.warpAffine(right, shift, (640, 480), None, cv2.INTER_CUBIC), np.uint8)
    found = measured(as_pinholes(pair(left, lower), RowAlignment(rows_px)))
    assert found.status is Status.OK
    assert deviations(found, 2.4) < 2.8


def test_a_right_camera_that_is_turned_does_not_go_unsaid():
    """Turned by 0.3 degrees disparities are 3 px off: the known sizes contradict them, in frame after frame."""
    turned = make_transform(rotation_of(np.array([0.0, np.deg2rad(0.3), 0.0])), [BASELINE_M, 0.0, 0.0])
    method = Measuring("stereo", PROFILE)
    for angle_rad in ANGLES:
        found = method.result(pair(drawn(angle_rad, False), drawn(angle_rad, True), turned))
        if found.status is Status.OK:
            assert deviations(found, angle_rad) < 2.8
        else:
            assert found.status in (Status.UNCERTAIN, Status.INCONSISTENT)


@pytest.mark.parametrize(
    ("right_m", "said"),
    [([BASELINE_M, 0.01, 0.0], "beside"), ([-BASELINE_M, 0.0, 0.0], "swapped"), (None, "")],
)
def test_a_pair_that_is_not_rectified_is_refused(right_m, said):
    """A right camera far above the left one, swapped views, or none: a rejection that says so."""
    left = make_scene().frame_at(0.3)
    seen = pair(left, left) if right_m is None else pair(left, left, make_transform(np.eye(3), right_m))
    row = Measuring("stereo", PROFILE).estimate(seen if right_m else replace(seen, right=None))
    assert row.status is Status.NO_STEREO
    assert said in row.detail
    assert row.spatial_m is None
    assert row.tissue_x_px is not None or right_m is not None


def test_tissue_that_both_views_show_far_away_only_is_the_profiles():
    """What continues smoothly from there is uncertain: by much more than the profile is of its plane and dome."""
    (seen,) = golden_frames("3d/contact", range(3, 4))
    arm = Arm(PROFILE)
    frame = frame_of(seen, arm, make_segmenter(PROFILE.segmentation))
    found = make_estimator("stereo", arm).estimate(frame)
    assert not found.detail
    surface = frame.scene.stereo_surface
    vars(frame.scene)["stereo_surface"] = replace(surface, grid_std_m=5e-3 + surface.grid_std_m)
    other = make_estimator("stereo", arm).estimate(frame)
    assert "the profile's is used" in other.detail
    seen, known = found.distances.clearance, other.distances.clearance
    assert known.std_m < 5e-3
    assert abs(known.value_m - seen.value_m) < 2.0 * np.hypot(known.std_m, seen.std_m)


def test_without_joints_an_instrument_is_measured_by_the_only_view_that_shows_it():
    """Both instruments are painted over in one view: the other one has each by its own name, and as sure as it is."""
    rules = AutoSegmentation(method="auto")
    segmenter = make_segmenter(rules)
    sides = {"PSM1": "right", "PSM2": "left"}
    arms = [
        Arm(PROFILE.model_copy(update={"segmentation": rules, "instrument_name": name, "entry": side}))
        for name, side in sides.items()
    ]
    (seen,) = golden_frames("3d/duo", range(3, 4))
    seen = replace(seen, joints=None, T_camera_base=None, joint_track=None)

    def painted(image: Image) -> Image:
        masks = np.bitwise_or.reduce([one.mask for one in auto_masks(image).seen])
        return cv2.inpaint(image, cv2.dilate(masks, np.ones((15, 15), np.uint8)), 3.0, cv2.INPAINT_TELEA)

    def places(observation: Observation) -> tuple[np.ndarray, np.ndarray]:
        frames = Association(arms).frames(Scene(observation, arms[0].profile, segmenter), (observation,) * 2)
        each = zip(arms, frames, strict=True)
        tools = [make_estimator("stereo", arm).estimate(frame).tool.pose for arm, frame in each]
        return np.array([one.position_m for one in tools]), np.array([one.position_std_m for one in tools])

    by_both_m, std_m = places(seen)
    assert np.linalg.norm(by_both_m[0] - by_both_m[1]) > 0.02
    for one_view in (
        replace(seen, image_bgr=painted(seen.image_bgr)),
        replace(seen, right=replace(seen.right, image_bgr=painted(seen.right.image_bgr))),
    ):
        found_m, found_std_m = places(one_view)
        assert (np.linalg.norm(found_m - by_both_m, axis=1) < found_std_m).all()
        assert (found_std_m >= 0.98 * std_m).all()
