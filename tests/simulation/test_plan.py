"""The plan of a recording: its blocks cover all stamps once, and it can be sent to another process."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

from svmdist.profile import Profile
from svmdist.simulation.scenarios import Scenario
from svmdist.simulation.plan import between_topic, make_plan, topic_names


@pytest.mark.parametrize("rate_hz", [0.5, 7.0, 60.0])
def test_each_block_is_an_image_and_all_up_to_the_next(profile: Profile, rate_hz: float) -> None:
    scenario = Scenario("sweep", 1, 4.0, rate_hz)
    plan = make_plan(scenario, profile)
    stamps = [index for block in plan.blocks for index in range(block.begin, block.end)]
    assert stamps == list(range(len(plan.stamps_ns)))
    assert [block.frame for block in plan.blocks] == list(range(scenario.frame_count))
    assert all(plan.with_image[block.begin : block.end].sum() == 1 for block in plan.blocks)
    assert all(plan.with_image[block.begin] for block in plan.blocks)


def test_the_calibration_comes_once_a_second(profile: Profile) -> None:
    plan = make_plan(Scenario("sweep", 1, 4.0, 10.0), profile)
    at_s = (plan.stamps_ns[plan.with_camera_info] - plan.stamps_ns[0]) / 1e9
    np.testing.assert_array_equal(at_s, [0.0, 1.0, 2.0, 3.0, 4.0])


def test_a_plan_can_be_sent(profile: Profile) -> None:
    """Pickled and back, it is the same plan, to the last bit of its joints."""
    plan = make_plan(Scenario("occlusion", 1, 1.0, 5.0), profile)
    copy = pickle.loads(pickle.dumps(plan))
    np.testing.assert_array_equal(copy.arms[0].q, plan.arms[0].q)
    assert plan.T_world_retractor is not None
    np.testing.assert_array_equal(copy.T_world_retractor, plan.T_world_retractor)
    assert copy.blocks == plan.blocks


def test_open_topics_have_the_names_of_a_dvrk(profile: Profile) -> None:
    topics = profile.topics.model_copy(update={"image": "/camera", "tf": None})
    names = topic_names(profile.model_copy(update={"topics": topics}))
    assert (names.image, names.tf) == ("/camera", "/tf")
    assert between_topic("PSM1", "PSM2") == "/ground_truth/PSM1/PSM2/distance"
