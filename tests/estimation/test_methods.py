"""Every method behind the one interface: honest about what it needs and remembers; a frame is looked at once."""

from dataclasses import replace

import numpy as np
import pytest

from svmdist.errors import ProfileError
from svmdist.estimation.frame import Arm, Frame
from svmdist.estimation.methods import METHODS, PLANAR_METHODS, SPATIAL_METHODS, Estimator, make_estimator
from svmdist.estimation.plane_mapping import PUBLISHED_MAPPING
from svmdist.samples import Observation, Status
from svmdist.vision.frame_context import make_segmenter
from tests.golden import golden_frames
from tests.measuring import frame_of
from tests.shipped import PROFILE


def made(method: str) -> Estimator:
    return make_estimator(method, Arm(PROFILE), PUBLISHED_MAPPING if method in PLANAR_METHODS else None)


@pytest.fixture(scope="module")
def seen() -> list[Observation]:
    """The first frames of a rendered log with both views, joints and transforms."""
    return golden_frames("3d/contact", range(3))


def fresh(seen: Observation) -> Frame:
    """A frame of which nothing is detected yet."""
    return frame_of(seen, Arm(PROFILE), make_segmenter(PROFILE.segmentation))


@pytest.mark.parametrize("method", ["kinematic", "fused"])
def test_a_robot_that_does_not_know_the_camera_is_a_reason(method, seen):
    result = made(method).estimate(fresh(replace(seen[0], T_camera_base=None)))
    assert (result.status, result.detail) == (
        Status.NO_JOINTS,
        "no transform from the camera to the base near the image",
    )


@pytest.mark.parametrize("method", METHODS)
def test_what_is_not_needed_is_not_looked_at(method, seen):
    """A method that says so does without joints, transforms, or the right view, and gives the same."""
    estimator, blind = made(method), made(method)
    for one in seen:
        needs = estimator.needs
        less = one if needs.robot else replace(one, joints=None, T_camera_base=None, joint_track=None)
        less = less if needs.right_view else replace(less, right=None)
        whole, partial = estimator.estimate(fresh(one)), blind.estimate(fresh(less))
        assert whole.status == partial.status
        assert whole.distances == partial.distances
        assert whole.image == partial.image


@pytest.mark.parametrize("method", [method for method in METHODS if not made(method).keeps_state])
def test_a_method_without_state_forgets(method, seen):
    """A frame after others, in whatever order, gives what a fresh estimator gives, bit for bit."""
    used = made(method)
    for index in (2, 0, 1, 0):
        first, second = (each.estimate(fresh(seen[index])) for each in (used, made(method)))
        assert (first.status, first.image, first.distances) == (second.status, second.image, second.distances)
        if first.tool is not None and second.tool is not None:
            np.testing.assert_array_equal(first.tool.pose.T_camera_tool, second.tool.pose.T_camera_tool)


def test_a_profile_without_what_a_method_needs_is_refused():
    """At once, not at the first frame; the error names the part."""
    of_all = [(method, part) for method in SPATIAL_METHODS for part in ("robot", "tissue")]
    for method, part in (*of_all, ("fiducial", "fiducial"), ("shaft", "instrument")):
        with pytest.raises(ProfileError, match=part):
            make_estimator(method, Arm(PROFILE.model_copy(update={part: None})))


def test_an_observation_has_no_field_for_truth():
    """No estimator can peek."""
    assert not {name for name in Observation.__slots__ if "truth" in name or "distance" in name}
