"""A pose beside the instrument in the image is never `ok`; occlusion and wide intervals cost no row."""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from svmdist.estimation.instrument.model import capsules_about, shaft_sections, wrist_in_tool
from svmdist.kinematics import forward_kinematics
from svmdist.profile import Profile
from svmdist.samples import Image, Observation, Status
from svmdist.simulation.scene import make_scene
from svmdist.transforms import inverse, transform_points
from tests.golden import IN_3D, REAL, golden_frames
from tests.measuring import Measuring, shifted
from tests.shipped import PROFILE

PLAIN_LOGS = ("sweep", "random", "approach")
"""Their nominal kinematics are right but for the encoders; the last one shows short stubs of the shaft."""
SURE = {
    "camera_base_std_m": 1e-3,
    "camera_base_std_rad": 1e-3,
    "joint_std_rad": 1e-3,
    "joint_std_m": 2e-4,
    "play_std_rad": 1e-3,
    "time_offset_std_s": 5e-3,
}
SURE_PROFILE = PROFILE.model_copy(update={"kinematic_error": PROFILE.kinematic_error.model_copy(update=SURE)})
"""Kinematics that take themselves to be right within 3 mm at the tool."""
MIN_SHAFT_PX = 4000  # a stub of less is mostly the rounded end, which sections leave out
GREY_BGR, TISSUE_BGR = (150, 150, 150), (90, 80, 200)


IN_VIEW = range(20, 60, 8)
"""Some frames of these logs, with the instrument in view."""


@pytest.fixture(scope="module", params=PLAIN_LOGS)
def seen(request) -> list[Observation]:
    return golden_frames(request.param, IN_VIEW)


def results(profile: Profile, seen: list[Observation], change: Callable[[Observation], Observation]):
    measuring = Measuring("kinematic", profile)
    return [measuring.result(change(one)) for one in seen]


def moved(*offset_m: float) -> Callable[[Observation], Observation]:
    """What makes the camera-to-base transform of an observation wrong."""
    return lambda one: shifted(one, *offset_m)


def painted(paint: Callable[[Image], None], after: Callable[[Observation], Observation]):
    """The same of an observation in whose image something is painted first."""

    def change(one: Observation) -> Observation:
        image = one.image_bgr.copy()
        paint(image)
        return after(replace(one, image_bgr=image))

    return change


def marker_in_grey(image: Image) -> None:
    """Steel in place of the coloured marker."""
    blue, _, red = cv2.split(image.astype(np.int16))
    image[cv2.dilate((blue - red > 40).astype(np.uint8), np.ones((5, 5))) > 0] = GREY_BGR


@pytest.mark.parametrize("offset_m", [(0.03, 0, 0), (0, 0.03, 0), (0, -0.03, 0), (-0.02, 0.02, 0.01)])
def test_a_wrong_transform_under_a_narrow_prior_gives_no_distance(seen, offset_m):
    for result in results(SURE_PROFILE, seen, moved(*offset_m)):
        assert result.status is Status.INCONSISTENT
        assert "distal marker is seen" in result.detail
        assert result.distances.spatial is None


def test_a_right_transform_keeps_every_row(seen):
    assert {one.status for one in results(SURE_PROFILE, seen, moved(0.0, 0.0, 0.0))} == {Status.OK}


def test_a_wide_interval_that_covers_the_error_is_honest(seen):
    """The shipped prior, 6 cm at the tool: the same wrong transform is within it."""
    assert {one.status for one in results(PROFILE, seen, moved(0.03, 0.0, 0.0))} == {Status.OK}


@pytest.mark.parametrize("profile", [PROFILE, SURE_PROFILE])
def test_a_tool_behind_the_camera_is_never_ok(seen, profile):
    for result in results(profile, seen, moved(0.0, 0.0, -0.2)):
        assert (result.status, result.detail) == (Status.INCONSISTENT, "the tool is behind the camera")


@pytest.mark.parametrize("log", PLAIN_LOGS[:2])
def test_a_shaft_beside_the_one_in_the_image_is_refuted_without_a_marker(log):
    seen = golden_frames(log, IN_VIEW)
    sure = SURE_PROFILE.kinematic_error.model_copy(
        update={"camera_base_std_m": 3e-4, "camera_base_std_rad": 1e-4, "joint_std_rad": 1e-4}
    )
    profile = SURE_PROFILE.model_copy(update={"kinematic_error": sure})
    right = results(profile, seen, painted(marker_in_grey, moved(0.0, 0.0, 0.0)))
    assert {one.status for one in right} == {Status.OK}
    wrong = results(profile, seen, painted(marker_in_grey, moved(0.0, 0.008, 0.0)))
    said = [one.detail for one in wrong if one.status is Status.INCONSISTENT]
    assert len(said) >= len(seen) - 1  # a stub shows too little
    assert all("the projected shaft lies beside the instrument in the image" in one for one in said)


def test_an_image_that_shows_no_instrument_refutes_nothing(seen):
    """All of it is behind tissue; the tissue's place is kept from an image before."""

    def hide(image: Image) -> None:
        image[:] = TISSUE_BGR

    measuring = Measuring("kinematic", SURE_PROFILE)
    measuring.result(seen[0])
    for one in seen[1:]:
        assert measuring.result(painted(hide, moved(0.0, 0.03, 0.0))(one)).status is Status.OK


@pytest.mark.parametrize("log", [*IN_3D, *REAL])
def test_rows_of_golden_logs_are_kept(log, golden_rows):
    assert Status.INCONSISTENT not in {row.status for row in golden_rows(log, "fused").rows}


def test_the_projected_shaft_covers_the_one_that_is_drawn():
    """The silhouette of the mesh that the simulation draws, in postures all over the picture: IoU above 0.9."""
    scene, rng, shares = make_scene(PROFILE, 3), np.random.default_rng(2), []
    camera, T_camera_world = scene.camera, inverse(scene.T_world_camera)
    at = [one.name for one in scene.parts].index("shaft")
    for _ in range(60):
        q = scene.posture.copy()
        q[6:9] += rng.uniform(-1.0, 1.0, 3) * [0.08, 0.08, 0.015]
        q[9:] += rng.uniform(-0.5, 0.5, 4)
        T_camera_tool = T_camera_world @ scene.T_world_base @ forward_kinematics(scene.chain, q)
        body = capsules_about(PROFILE.instrument, wrist_in_tool(scene.chain, q)).transformed(T_camera_tool)
        found = shaft_sections(camera, body)
        points_m = transform_points(T_camera_world @ scene.part_poses(q)[at], scene.parts[at].mesh.vertices_m)
        drawn, projected = (np.zeros((camera.height_px, camera.width_px), np.uint8) for _ in range(2))
        hull_px = cv2.convexHull(camera.project(points_m[points_m[:, 2] > 0.01]).astype(np.float32))
        cv2.fillConvexPoly(drawn, np.rint(hull_px).astype(np.int32), 1)
        if np.count_nonzero(drawn) < MIN_SHAFT_PX:
            continue
        cv2.fillConvexPoly(projected, np.rint(found.outline_px).astype(np.int32), 1)
        shares.append(np.count_nonzero(drawn & projected) / np.count_nonzero(drawn | projected))
    assert len(shares) > 30
    assert min(shares) > 0.9, sorted(shares)[:12]
