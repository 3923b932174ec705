"""The clearance between instruments: told alike from both sides, to the nearest, with an honest deviation."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.estimation.distances import between_std_m, with_clearance_between
from svmdist.estimation.instrument.model import InstrumentModel
from svmdist.geometry.distance import capsule_separation
from svmdist.results import Distance, Distances, FrameResult, ToolEstimate, ToolPose
from svmdist.samples import Status
from svmdist.transforms import Array, make_transform, rotation_of
from tests.shipped import PROFILE

BODY = InstrumentModel.of(PROFILE)
assert BODY is not None
SPATIAL = Distances(spatial=Distance(0.02, 1e-3))


def pose_at(
    x_m: float, covariance: Array | None = None, turn: tuple[float, float, float] = (0, 0, 0)
) -> ToolPose:
    """A tool beside the optical axis, whose shaft comes from the camera's side."""
    R = rotation_of(turn)
    covariance = 1e-8 * np.eye(6) if covariance is None else covariance
    return ToolPose(make_transform(R, [x_m, 0.002, 0.09]), covariance, R @ [0.0, 0.0, 1.0])


def result_at(x_m: float, covariance: Array | None = None, status: Status = Status.OK) -> FrameResult:
    tool = ToolEstimate(pose_at(x_m, covariance, (0.2 * x_m / 0.01, 0.3, 0.0)))
    return FrameResult(7, status, tool=tool, distances=SPATIAL)


def between(*results: FrameResult) -> list[Distance | None]:
    filled = with_clearance_between(results, [BODY] * len(results))
    return [result.distances.to_instrument for result in filled]


def test_both_sides_tell_the_same() -> None:
    """One value and one deviation, along opposite directions, whichever comes first in the list."""
    left, right = result_at(-0.01, np.diag([1e-8] * 3 + [1e-6] * 3)), result_at(0.012)
    first, second = between(left, right)
    assert first is not None
    assert second is not None
    assert (first.value_m, first.std_m) == (second.value_m, second.std_m)
    assert first.direction is not None
    assert second.direction is not None
    np.testing.assert_array_equal(np.array(first.direction), -np.array(second.direction))
    assert np.linalg.norm(first.direction) == pytest.approx(1.0)
    swapped = between(right, left)
    assert swapped[1] is not None
    assert swapped[1].value_m == pytest.approx(first.value_m, abs=1e-12)  # rounding of the closest points
    assert swapped[1].std_m == pytest.approx(first.std_m, rel=1e-6)
    np.testing.assert_allclose(swapped[1].direction, first.direction, atol=1e-9)


def test_the_direction_leads_to_the_other() -> None:
    """A step of 1 mm along it lessens the clearance by 1 mm, which is small against 20 mm and curved surfaces."""
    left, right = pose_at(-0.012), pose_at(0.012)
    assert BODY is not None
    gap = capsule_separation(BODY.posed(left), BODY.posed(right))
    T = left.T_camera_tool.copy()
    T[:3, 3] += 1e-3 * gap.direction
    moved = capsule_separation(BODY.posed(ToolPose(T, left.covariance, left.axis)), BODY.posed(right))
    assert gap.distance_m - moved.distance_m == pytest.approx(1e-3, abs=1e-5)


def test_everyone_is_told_the_nearest() -> None:
    """Of three in a row the outer ones are told of the middle one; the middle one of the nearer of them."""
    first, middle, last = between(result_at(-0.03), result_at(0.0), result_at(0.02))
    assert first is not None
    assert middle is not None
    assert last is not None
    assert middle.value_m == last.value_m < first.value_m
    alone = between(result_at(-0.03), result_at(0.0))
    assert alone[0] == first


def test_who_has_no_pose_or_body_is_nobodys_neighbour() -> None:
    """The others' results stay the very objects that they were."""
    there, lost = result_at(0.0), result_at(0.02, status=Status.NO_INSTRUMENT)
    blind = FrameResult(7, Status.OK)
    for results, bodies in (
        ([there, lost], [BODY, BODY]),
        ([there, blind], [BODY, BODY]),
        ([there, result_at(0.02)], [BODY, None]),
        ([there], [BODY]),
    ):
        filled = with_clearance_between(results, bodies)
        assert all(after is before for after, before in zip(filled, results, strict=True))


def test_the_other_distances_stay() -> None:
    filled = with_clearance_between([result_at(-0.01), result_at(0.01)], [BODY, BODY])
    for result in filled:
        assert result.distances.spatial == SPATIAL.spatial
        assert result.distances.to_instrument is not None
        assert result.stamp_ns == 7


def test_the_deviation_is_that_of_two_poses_that_err_alone() -> None:
    """Against 1,500 pairs of drawn poses, within 8 %.

    As many samples settle a deviation to 1.8 % (1/√(2n)); 0.2 mm and 0.5° about tools whose closest points are 20 mm
    apart leave terms of second order of some percent.
    """
    assert BODY is not None
    rng = np.random.default_rng(5)
    roots = [rng.normal(size=(6, 6)) * np.array([[1e-4] * 3 + [4e-3] * 3]).T for _ in range(2)]
    poses = [
        pose_at(x_m, root @ root.T, turn)
        for x_m, root, turn in ((-0.012, roots[0], (0.2, 0.3, 0.0)), (0.012, roots[1], (-0.1, 0.1, 0.4)))
    ]
    gap = capsule_separation(BODY.posed(poses[0]), BODY.posed(poses[1]))
    told_m = between_std_m(gap, *poses)
    found_m = []
    for _ in range(1500):
        drawn = []
        for pose, root in zip(poses, roots, strict=True):
            step = root @ rng.normal(size=6)
            turn = rotation_of(step[3:])
            T = make_transform(turn @ pose.T_camera_tool[:3, :3], pose.position_m + step[:3])
            drawn.append(ToolPose(T, pose.covariance, turn @ pose.axis))
        found_m.append(capsule_separation(BODY.posed(drawn[0]), BODY.posed(drawn[1])).distance_m)
    assert told_m == pytest.approx(float(np.std(found_m)), rel=0.08)
