"""Conditions change images, by a frame's number and content alone, and nothing else of an observation."""

from dataclasses import replace

import numpy as np
import pytest

from svmdist.errors import UsageError
from svmdist.samples import Observation, RightView
from svmdist.vision.degradations import Blur, Degradation
from svmdist.workflows.request import BlurCondition, Condition, ReplayCondition
from tests.synthetic import make_scene

SCENE = make_scene(320, 240)
IMAGE = SCENE.frame_at(0.3)
SEEN = Observation(
    5,
    IMAGE,
    SCENE.camera,
    None,
    RightView(np.ascontiguousarray(IMAGE[:, ::-1]), SCENE.camera, np.eye(4)),
    np.eye(4),
)
EVERY: list[ReplayCondition] = [
    *(Condition(name, 3) for name in Degradation),
    BlurCondition(Blur.GAUSSIAN, 5),
]


def same(first: Observation, second: Observation) -> bool:
    return np.array_equal(first.image_bgr, second.image_bgr) and np.array_equal(
        first.right.image_bgr, second.right.image_bgr
    )


@pytest.mark.parametrize("condition", EVERY, ids=str)
def test_a_condition_changes_both_images_and_nothing_else(condition):
    """Their shapes and types stay; the observation that came in is left as it was."""
    before = IMAGE.copy()
    changed = condition.apply(SEEN, 3)
    assert not np.array_equal(changed.image_bgr, SEEN.image_bgr)
    assert not np.array_equal(changed.right.image_bgr, SEEN.right.image_bgr)
    assert (changed.image_bgr.shape, changed.image_bgr.dtype) == (IMAGE.shape, IMAGE.dtype)
    assert replace(changed, image_bgr=SEEN.image_bgr, right=SEEN.right) == SEEN
    np.testing.assert_array_equal(before, SEEN.image_bgr)


@pytest.mark.parametrize("condition", EVERY, ids=str)
def test_a_frame_is_always_changed_alike(condition):
    """In whatever process and order; a view that is missing changes nothing of the other."""
    once = condition.apply(SEEN, 3)
    condition.apply(SEEN, 8)
    assert same(condition.apply(SEEN, 3), once)
    one_view = condition.apply(replace(SEEN, right=None), 3)
    assert one_view.right is None
    np.testing.assert_array_equal(one_view.image_bgr, once.image_bgr)


@pytest.mark.parametrize("name", [Degradation.NOISE, Degradation.SMOKE])
def test_what_is_drawn_changes_with_frame_and_log(name):
    """Another number, or another image of that number as another log has it, draws anew."""
    condition = Condition(name, 3)
    once = condition.apply(SEEN, 3)
    assert not same(condition.apply(SEEN, 4), once)
    other = IMAGE.copy()
    other[0, 0] ^= 1
    drawn = condition.apply(replace(SEEN, image_bgr=other), 3).image_bgr
    assert np.count_nonzero(drawn != once.image_bgr) > 100  # one pixel and its neighbours would be 3 to 30


@pytest.mark.parametrize("severity", [-1, 0, 6])
def test_a_severity_is_1_to_5(severity):
    with pytest.raises(UsageError, match="5"):
        Condition(Degradation.NOISE, severity)
    assert str(Condition(Degradation.NOISE, 5)) == f"{Degradation.NOISE}=5"
