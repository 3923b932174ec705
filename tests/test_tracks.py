"""Laws of interpolation: exact at the samples, between them, never outside, never across a long gap."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation, Slerp

from svmdist.tracks import JointTrack, TransformTrack, sort_stamps
from svmdist.transforms import make_transform, rotation_z

stamp_lists = st.lists(st.integers(0, 10**12), min_size=1, max_size=30, unique=True).map(sorted)


@given(stamp_lists, st.lists(st.integers(0, 10**12), max_size=30), st.integers(0, 10**11))
def test_values_are_on_the_line_between_samples_that_are_near_and_nowhere_else(stamps, at, gap):
    numbers = dict(zip(stamps, np.random.default_rng(len(stamps)).normal(size=len(stamps)), strict=True))
    track = JointTrack(np.array(stamps), ("a",), np.array([*numbers.values()])[:, None])
    found = track.at(np.array(at + stamps, np.int64), gap)
    for stamp, valid, value in zip(at + stamps, found.valid, found.values[:, 0], strict=True):
        before = [s for s in stamps if s <= stamp]
        after = [s for s in stamps if s >= stamp]
        if before and after and after[0] - before[-1] <= gap:
            assert valid
            first, last = numbers[before[-1]], numbers[after[0]]
            fraction = (stamp - before[-1]) / max(after[0] - before[-1], 1)
            assert value == pytest.approx(first + fraction * (last - first), rel=1e-15, abs=1e-15)
        else:
            assert not valid
            assert np.isnan(value)


@pytest.mark.parametrize("start_ns", [0, 1_700_000_000_000_000_000])
def test_interpolated_transforms_equal_scipys(start_ns):
    """Between stamps, rotation follows Slerp and translation a straight line, also at stamps of today.

    Nanoseconds since 1970 need 61 bits, more than a double holds: only differences may be floats.
    """
    rng = np.random.default_rng(5)
    T = make_transform(Rotation.random(6, rng=rng).as_matrix(), rng.normal(size=(6, 3)))
    offsets_ns = np.array([0, 10, 25, 1_000_000, 1_000_033, 2_000_000], np.int64)
    at_offset_ns = np.array([0, 3, 10, 24, 25, 777_777, 1_000_010, 1_999_999, 2_000_000], np.int64)
    track = TransformTrack("a", "b", start_ns + offsets_ns, T)
    found = track.at(start_ns + np.append(at_offset_ns, 2_000_001))
    assert found.valid.tolist() == [True] * 9 + [False]
    assert np.isnan(found.values[9]).all()
    slerp = Slerp(offsets_ns.astype(float), Rotation.from_matrix(T[:, :3, :3]))
    expected = slerp(at_offset_ns.astype(float)).as_matrix()
    np.testing.assert_allclose(found.values[:9, :3, :3], expected, atol=1e-12)
    for axis in range(3):
        expected = np.interp(at_offset_ns, offsets_ns, T[:, axis, 3])
        np.testing.assert_allclose(found.values[:9, axis, 3], expected, atol=1e-14)


def test_a_static_transform_holds_always_and_a_single_sample_only_at_its_stamp():
    T = make_transform(rotation_z(0.3), [1, 2, 3])[None]
    static = TransformTrack("a", "b", np.array([5]), T, is_static=True).at(np.array([0, 10**15]))
    assert static.valid.all()
    np.testing.assert_array_equal(static.values[1], T[0])
    single = TransformTrack("a", "b", np.array([5]), T).at(np.array([4, 5, 6]))
    assert single.valid.tolist() == [False, True, False]


def test_sorting_keeps_the_first_of_equal_stamps():
    assert sort_stamps(np.array([3, 1, 3, 2, 1])).tolist() == [1, 3, 0]


def test_joints_near_a_stamp_go_on_beyond_the_ends():
    """Inside as interpolated; beyond the last sample at the rate that joints have there."""
    stamps_ns = np.arange(0, 210, 10) * 1_000_000
    t_s = stamps_ns / 1e9
    track = JointTrack(stamps_ns, ("a", "b"), np.stack([2.0 * t_s, 1.0 - 0.5 * t_s], -1))
    np.testing.assert_allclose(track.near(55_000_000), [0.11, 0.9725])
    np.testing.assert_allclose(track.near(230_000_000), [0.46, 0.885])
    np.testing.assert_allclose(track.near(-20_000_000), [-0.04, 1.01])
    np.testing.assert_allclose(track.rate_near(100_000_000), [2.0, -0.5])


def test_rates_average_noise_and_a_single_sample_has_none():
    """Of nine samples with steps of 1e-3 the slope is that of the line within 0.02 a second."""
    stamps_ns = np.arange(0, 210, 10) * 1_000_000
    noise = 1e-3 * np.random.default_rng(1).choice([-1.0, 1.0], (21, 1))
    track = JointTrack(stamps_ns, ("a",), 0.3 * stamps_ns[:, None] / 1e9 + noise)
    assert track.rate_near(100_000_000) == pytest.approx([0.3], abs=0.05)
    one = JointTrack(stamps_ns[:1], ("a",), np.ones((1, 1)))
    assert one.rate_near(0) == pytest.approx([0.0])
    assert one.near(50_000_000) == pytest.approx([1.0])
