"""The method shaft on pictures that the simulator never drew: any side, size, frame and background."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.frame import Arm, Frame
from svmdist.estimation.frame_methods import certain
from svmdist.estimation.instrument.factors import end, of_images
from svmdist.estimation.instrument.image_pose import ImagePose
from svmdist.estimation.instrument.model import InstrumentModel, shaft_sections
from svmdist.estimation.instrument.shaft import NO_SHAFT, ShaftSizes
from svmdist.profile import Profile, load_profile
from svmdist.profile.robot import Instrument
from svmdist.profile.segmentation import AutoSegmentation
from svmdist.results import Failure, ToolEstimate
from svmdist.samples import Image, Observation, Rejection, Status
from svmdist.transforms import make_transform
from svmdist.vision.frame_context import make_segmenter
from svmdist.vision.instruments import find_instruments
from svmdist.vision.instruments.find_instruments import SeenInstrument
from svmdist.vision.silhouette import Rim
from tests.measuring import frame_of
from tests.pictures import END_M, PALE_BGR, RED_BGR, WRIST_M, ShaftImage, entering_from

PROFILE = load_profile().model_copy(update={"fiducial": None})
BY_SHAPE = PROFILE.model_copy(update={"segmentation": AutoSegmentation(method="auto")})
SMALL = Camera.from_horizontal_fov(640, 480, np.pi / 3)
LARGE = Camera.from_horizontal_fov(1920, 1080, np.pi / 2.6)
SIDES = {
    "right": 0.1, "bottom": np.pi / 2 - 0.2, "left": np.pi + 0.15, "top": -np.pi / 2 + 0.1,
    "corner": 0.65, "other corner": np.pi + 0.65,
}  # fmt: skip
PALE, RED = {"background_bgr": PALE_BGR}, {"background_bgr": RED_BGR}


def picture(camera: Camera, side: str, **kwargs: object) -> ShaftImage:
    return ShaftImage(camera, *entering_from(SIDES[side], camera), **kwargs)


def frame_in(image_bgr: Image, camera: Camera = SMALL, profile: Profile = PROFILE) -> Frame:
    """The frame of an image, without joints and without a camera-to-base transform."""
    return frame_of(Observation(0, image_bgr, camera), Arm(profile), make_segmenter(profile.segmentation))


def measured(drawn: ShaftImage, profile: Profile = PROFILE, image_bgr: Image | None = None) -> ImagePose:
    """The tool's pose by the shaft alone, in the picture or in what was made of it."""
    fit = frame_in(drawn.draw(2) if image_bgr is None else image_bgr, drawn.camera, profile).shaft_pose
    assert isinstance(fit, ImagePose), fit
    return fit


def check(drawn: ShaftImage, fit: ImagePose, axis_rad: float, across_m: float, depth_m: float) -> None:
    """Direction, the tool across its ray and along it; and that the stated deviations cover the errors."""
    assert np.arccos(np.clip(fit.pose.axis @ drawn.direction, -1, 1)) < axis_rad
    error_m = fit.pose.position_m - drawn.tool_m
    ray = drawn.tool_m / np.linalg.norm(drawn.tool_m)
    assert abs(error_m @ ray) < depth_m
    assert np.linalg.norm(error_m - (error_m @ ray) * ray) < across_m
    assert error_m @ np.linalg.solve(fit.pose.position_covariance, error_m) < 16.3  # 99.9 % of χ² with 3 dof


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize(
    ("camera", "scene"),
    [
        (SMALL, PALE),
        (SMALL, RED),
        (LARGE, RED | {"border": "rectangle"}),
        (LARGE, RED | {"border": "circle"}),
    ],
    ids=["pale", "red", "rectangle", "circle"],
)
def test_from_any_side_over_pale_and_red_and_with_black_borders(camera, scene, side):
    drawn = picture(camera, side, **scene)
    check(drawn, measured(drawn), axis_rad=0.02, across_m=2e-4, depth_m=1e-3)


@pytest.mark.parametrize(
    "faults",
    [{"stripe": True}, {"blur_px": 2.5}, {"noise": 10.0}, {"stripe": True, "blur_px": 1.5, "noise": 6.0}],
    ids=["stripe", "blur", "noise", "all"],
)
def test_glare_blur_and_noise(faults):
    drawn = picture(SMALL, "left", **faults)
    check(drawn, measured(drawn), axis_rad=0.03, across_m=3e-4, depth_m=1.5e-3)


@pytest.mark.parametrize("side", list(SIDES)[:4])
def test_steel_tip_without_a_coloured_part(side):
    """The rim alone gives the place along the shaft; the wrist's bend is then unknown, and the answer says so."""
    drawn = picture(SMALL, side, marker=False)
    fit = measured(drawn)
    check(drawn, fit, axis_rad=0.02, across_m=1e-3, depth_m=1.5e-3)
    assert "end" in fit.used
    # It may be bent either way: towards the camera and to the side.
    across = np.eye(3) - np.outer(fit.pose.axis, fit.pose.axis)
    of_bend_m = np.sqrt(np.linalg.eigvalsh(across @ fit.pose.position_covariance @ across)[1:])
    assert of_bend_m.min() > 0.3 * WRIST_M
    # The instrument's model, too, has its shaft where it is seen, however its wrist is bent.
    assert fit.pose.hinge is not None
    shaft = shaft_sections(SMALL, InstrumentModel.of(PROFILE).posed(ToolEstimate(fit.pose)))
    along = drawn.hinge_m + np.linspace(-0.3, -END_M, 300)[:, None] * drawn.direction
    middle_px = SMALL.project(along[along[:, 2] > 0.02])
    off_px = np.linalg.norm(shaft.middles_px[:, None] - middle_px, axis=2).min(1)
    assert np.median(off_px / shaft.half_px) < 0.2


@pytest.mark.parametrize("side", list(SIDES)[:4])
@pytest.mark.parametrize("scene", [PALE, RED], ids=["pale", "red"])
def test_axis_without_colours(side, scene):
    """Told by shape: the axis to 2 degrees, and its distance to 2 %. The tip is not the profile's: it has no jaws."""
    drawn = picture(SMALL, side, **scene)
    fit = measured(drawn, BY_SHAPE)
    assert np.arccos(np.clip(fit.pose.axis @ drawn.direction, -1.0, 1.0)) < np.deg2rad(2.0)
    off_m = fit.pose.hinge.position_m - drawn.tool_m
    assert np.linalg.norm(off_m - (off_m @ drawn.direction) * drawn.direction) < 0.02 * drawn.tool_m[2]


@pytest.mark.parametrize("side", list(SIDES)[:4])
def test_blood_across_a_shaft_is_not_its_end(side):
    """Over half of a width it is red, and beyond that the shaft goes on for a width."""
    drawn = picture(SMALL, side, **RED)
    back_m = END_M + np.array([[1.6], [1.0]]) * 2.0 * PROFILE.instrument.shaft_radius_m
    from_px, to_px = SMALL.project(drawn.hinge_m - back_m * drawn.direction)
    aside = 2.0 * np.array([from_px[1] - to_px[1], to_px[0] - from_px[0]])
    band = np.array([from_px - aside, from_px + aside, to_px + aside, to_px - aside])
    whole = drawn.draw(2)
    cut = cv2.fillConvexPoly(whole.copy(), np.rint(band).astype(np.int32), RED_BGR)
    views = [frame_in(bgr).left for bgr in (whole, cut)]
    assert [view.shaft.rim is None for view in views] == [False, True]
    assert all(view.dark_bar is not None for view in views)


def test_a_dark_end_is_no_shafts_where_nothing_of_the_chain_slides():
    """Another robot's: the image shows an end, and no link of the chain carries it."""
    rows = tuple(
        row.model_copy(update={"type": "fixed"} if row.type == "prismatic" else {}) for row in PROFILE.robot.joints
    )
    robot = PROFILE.robot.model_copy(update={"joints": rows})
    image = picture(SMALL, "left").draw(2)
    own, other = (
        frame_in(image, profile=profile) for profile in (PROFILE, PROFILE.model_copy(update={"robot": robot}))
    )
    assert own.left.shaft.rim is not None
    assert [one.name for one in end(own.left, own.arm)] == ["end"]
    assert list(end(other.left, other.arm)) == []


def painted_jaws(drawn: ShaftImage, length_m: float) -> Image:
    """The picture with closed, straight jaws of a length, of steel."""
    ends_m = np.stack([drawn.hinge_m, drawn.tool_m + length_m * drawn.direction])
    base, tip = drawn.camera.project(ends_m)
    half = drawn.camera.K[0, 0] * 0.002 / drawn.tool_m[2] * np.array([(base - tip)[1], (tip - base)[0]])
    half /= np.linalg.norm(tip - base)
    image = drawn.draw(2)
    corners = np.rint([base + half, tip + 0.5 * half, tip - 0.5 * half, base - half]).astype(np.int32)
    cv2.fillPoly(image, [corners], (120, 120, 115))
    return np.asarray(cv2.GaussianBlur(image, (0, 0), 0.8), np.uint8)


@pytest.mark.parametrize("side", list(SIDES)[:2])
def test_jaws_are_as_long_as_their_tips_are_seen_and_never_shorter(side):
    """Of jaws that may be off by 4 mm. Shorter ones may be half hidden; the end, too, may explain longer ones."""
    instrument = PROFILE.instrument.model_copy(update={"body_std_m": 0.004})
    profile, drawn = BY_SHAPE.model_copy(update={"instrument": instrument}), picture(SMALL, side, **PALE)
    for share in (0.5, 1.0, 2.0):
        length_m = share * instrument.jaw_length_m
        fit = measured(drawn, profile, painted_jaws(drawn, length_m))
        assert "jaws' tip" in fit.used
        assert (fit.pose.jaw_scale > 1.1) == (share > 1.0)
        bodies = [
            InstrumentModel.of(profile).posed(ToolEstimate(one)) for one in (fit.pose, replace(fit.pose, jaw_scale=1.0))
        ]
        tips_m = [body.end_m[np.argmax(body.end_m @ drawn.direction)] for body in bodies]
        seen_px = SMALL.project(drawn.tool_m + length_m * drawn.direction)
        own_px, stated_px = np.linalg.norm(SMALL.project(np.array(tips_m)) - seen_px, axis=1)
        assert own_px < (0.8 * stated_px if share > 1.0 else stated_px + 1e-9)


@pytest.mark.parametrize("side", list(SIDES)[:2])
def test_jaws_that_end_elsewhere_are_in_doubt_without_joints(side):
    """Nothing tells whether the tip is another thing's, or the sides are: a shadow's, with the pose of another tool."""
    drawn = picture(SMALL, side, **PALE)
    image, doubts = painted_jaws(drawn, PROFILE.instrument.jaw_length_m), []
    for aside_px in (0.0, 150.0):
        frame = frame_in(image, profile=BY_SHAPE)
        shaft = frame.left.shaft
        x, y = shaft.towards_tip
        tip_px = shaft.wrist.tip_px + aside_px * np.array([-y, x])
        vars(frame.left)["shaft"] = replace(shaft, wrist=replace(shaft.wrist, tip_px=tip_px))
        doubts.append(frame.shaft_pose.contradiction)
    assert doubts[0] == ""
    assert "jaws' tip" in doubts[1]


@pytest.mark.parametrize("has_plate", [False, True])
def test_sides_may_be_those_of_a_plate_whose_tag_is_not_read(has_plate):
    """Elsewhere in the log the tag is seen: here an outline as wide as its plate is within the stated interval."""
    profile = load_profile()
    tag, sizes = profile.fiducial, profile.instrument
    share = 2.0 * sizes.shaft_radius_m / (profile.settings.tag.plate_ratio * tag.size_m)
    narrower = {
        "instrument": sizes.model_copy(update={"shaft_radius_m": share * sizes.shaft_radius_m}),
        "fiducial": tag.model_copy(update={"size_m": share * tag.size_m}),
    }
    profile = profile.model_copy(update=narrower)
    drawn = picture(SMALL, "left", marker=False)
    seen = Observation(0, drawn.draw(2), SMALL)
    fit = frame_of(seen, Arm(profile, has_plate), make_segmenter(profile.segmentation)).shaft_pose
    error_m = fit.pose.hinge.position_m - drawn.hinge_m
    square = error_m @ np.linalg.solve(fit.pose.hinge.covariance, error_m)
    assert (square < 7.8) == has_plate  # 95 % of χ² with 3 dof


def test_a_wrist_that_may_have_been_taken_for_a_shaft_leaves_the_depth_open(monkeypatch):
    """Where the network is less sure of a shaft, and no wrist is seen beyond it, it may be nearer by a third."""
    drawn, std_m = picture(SMALL, "left", **PALE), []
    for log_odds in (3.0, 0.7):
        monkeypatch.setattr(find_instruments, "part_entering", lambda *_, odds=log_odds: odds)
        fit = measured(drawn, BY_SHAPE)
        ray = drawn.hinge_m / np.linalg.norm(drawn.hinge_m)
        std_m.append(float(np.sqrt(ray @ fit.pose.hinge.covariance @ ray)))
    assert std_m[0] < 0.1 * drawn.hinge_m[2] < std_m[1]


@pytest.mark.parametrize("side", list(SIDES)[:2])
def test_a_shaft_out_of_focus_is_measured(side):
    """Blurred by 4 px its sides are still where the evidence is: the axis to 2 degrees, within the stated interval."""
    drawn = picture(SMALL, side, **PALE)
    fit = measured(drawn, BY_SHAPE, np.asarray(cv2.GaussianBlur(drawn.draw(2), (0, 0), 4.0), np.uint8))
    assert np.arccos(np.clip(fit.pose.axis @ drawn.direction, -1.0, 1.0)) < np.deg2rad(2.0)
    off_m = fit.pose.hinge.position_m - drawn.tool_m
    across_m = np.linalg.norm(off_m - (off_m @ drawn.direction) * drawn.direction)
    assert across_m < 2.0 * fit.pose.position_std_m


def test_beyond_10_cm_a_scene_of_twice_the_size_is_as_certain():
    """Without a known diameter or focal length every length is off alike, and the least certainty is a share of it."""
    frame = frame_in(picture(SMALL, "left", **PALE).draw(2))
    fit = frame.shaft_pose
    std = fit.pose.position_std_m / np.linalg.norm(fit.pose.position_m)
    for away_m in (0.15, 0.3):
        scale = away_m / np.linalg.norm(fit.pose.position_m)
        place, spread = scale * fit.pose.position_m, scale**2 * fit.pose.covariance
        scaled = replace(fit, pose=replace(fit.pose, T_camera_tool=make_transform(np.eye(3), place), covariance=spread))
        assert certain(frame, scaled, 0.101 * std) is scaled
        refused = certain(frame, scaled, 0.099 * std)
        assert isinstance(refused, Rejection)
        assert refused.status is Status.UNCERTAIN


@pytest.mark.parametrize("grey", [0, 150])
def test_an_image_without_an_instrument_says_so(grey):
    assert isinstance(frame_in(np.full((480, 640, 3), grey, np.uint8)).shaft_pose, Failure)


ENDS = ShaftSizes(Instrument(**{**dict(PROFILE.instrument), "outline_end_m": 0.004, "shaft_end_m": 0.005}), 0.009)


@pytest.mark.parametrize(
    ("other_px", "kept", "most_share"),
    [(90.0, True, 0.21), (140.0, True, 0.25), (200.0, True, 0.35), (400.0, False, 0.2)],
)
def test_two_ends_are_those_of_shaft_and_wrist_or_one_is_nothing(other_px, kept, most_share):
    """A dark part that ends 9 mm before the outline is the shaft, 14 mm before the jaws' joint, 20 before closed tips.

    One 40 mm before it is a band, blood or a label, unless another instrument ends the outline: then nothing tells.
    """
    sides = np.array([[[0.0, 0.0], [300.0, 0.0]], [[0.0, 80.0], [300.0, 80.0]]])
    end_px, small = np.array([300.0, 40.0]), np.zeros((2, 2), np.bool_)
    seen = SeenInstrument(small, (2, 2), sides, end_px, 1.0, ends_dark=True, other_px=other_px, other_share=0.5)
    likelier = ENDS.with_likelier_end(seen, 2e-4)
    assert likelier.ends_dark is kept
    assert likelier.other_share < most_share
    assert likelier.end_px[0] == pytest.approx(300.0 if kept else 300.0 + other_px)
    beside_another = ENDS.with_likelier_end(replace(seen, touches_another=True), 2e-4)
    assert beside_another.ends_dark is kept
    assert max(likelier.other_share, 0.0 if kept else 0.3) < beside_another.other_share < 0.5


def test_an_outline_beyond_which_nothing_is_seen_ends_anywhere_up_to_the_tips():
    """With a wrist seen beyond it, it is the shaft's; where another end is possible, the deviation reaches it."""

    def ahead(**known: float) -> tuple[float, float]:
        rim = Rim(np.zeros(2), np.array([1.0, 0.0]), 3.0, is_outline=True, **known)
        return ENDS.rim_ahead(replace(NO_SHAFT, rim=rim), 2e-4)

    assert ahead(narrows=1.0) == pytest.approx((0.004, ENDS.outline_end_std_m))
    mean_m, std_m = ahead(narrows=0.0)
    near_m, tip_m = 0.004, 0.017
    assert mean_m - 2.0 * std_m < near_m < tip_m < mean_m + 2.0 * std_m
    likelier_m, std_m = ahead(narrows=1.0, other_radii=-3.0, other_share=0.3)
    other_m = 3.0 * ENDS.radius_m - ENDS.end_m
    assert likelier_m == pytest.approx(near_m)
    assert std_m > np.sqrt(0.3) * abs(other_m - near_m)


def test_every_point_of_an_image_errs_for_as_long_as_the_profile_says():
    """The bias of marker, size and shaft's end fades with one setting, that of edges with another."""
    times = {"point_correlation_time_s": 7.0, "edge_correlation_time_s": 9.0}
    settings = PROFILE.settings.model_copy(update={"filter": PROFILE.settings.filter.model_copy(update=times)})
    profile = PROFILE.model_copy(update={"settings": settings})
    frame = frame_in(picture(SMALL, "right", **PALE).draw(2), profile=profile)
    found = {one.name: one.correlation_time_s for one in of_images(frame, None, both_views=False)}
    edges = {name: time_s for name, time_s in found.items() if name.startswith("edge")}
    assert len(edges) == 2
    assert set(edges.values()) == {9.0}
    points = found.keys() - edges.keys()
    assert {"end", "distal marker"} <= points
    assert {found[name] for name in points} == {7.0}
