"""What a robot reports of its joints: hysteresis within its dead band, drift, noise, steps, and a late clock."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from svmdist.perturbations import Perturbations, parse_perturbations
from svmdist.perturbations.apply import (
    METRES_PER_DEG,
    JointUnits,
    ReplayedWorld,
    late_stamps_ns,
    reported_joints,
    reported_late,
)
from svmdist.transforms import Array
from tests.shipped import CHAIN, PROFILE

UNITS = JointUnits.of(PROFILE)
NAMES = CHAIN.joint_names
WRIST = NAMES.index("wrist_pitch")
STEP_NS = 10_000_000
PATHS = arrays(np.float64, st.tuples(st.integers(1, 40), st.just(3)), elements=st.floats(-2.0, 2.0))


def leads(path: Array, half_width: float) -> Array:
    units = JointUnits({}, np.ones(3), np.ones(3))
    backlash = Perturbations((("backlash", half_width),))
    return reported_joints(path, np.zeros(len(path), np.int64), units, backlash, 1) - path


@given(PATHS, st.floats(0.0, 1.0))
def test_a_lead_stays_in_its_dead_band(path, half_width):
    assert np.abs(leads(path, half_width)).max() <= half_width + 1e-12


@given(PATHS, st.floats(0.01, 0.5))
def test_a_lead_has_the_sign_of_the_last_long_travel(path, half_width):
    """After a travel of twice the half-width in one direction the band is pushed to its end, whatever came before."""
    up = path[-1] + 2.0 * half_width + 1e-9
    further = np.vstack([path, up, up + 1.0, up + 0.5])
    found = leads(further, half_width)
    np.testing.assert_allclose(found[-3:-1], half_width, atol=1e-9)
    np.testing.assert_allclose(found[-1], half_width - min(0.5, 2.0 * half_width), atol=1e-9)


@given(PATHS, st.floats(0.0, 1.0), st.integers(2, 5))
def test_a_lead_knows_no_speed(path, half_width, repeats):
    """Rest and intermediate samples change nothing: hysteresis is independent of rate."""
    slow = np.array([path[0], *(a + (b - a) * k / repeats for a, b in pairwise(path) for k in range(1, repeats + 1))])
    np.testing.assert_allclose(leads(slow, half_width)[::repeats], leads(path, half_width), atol=1e-12)


def perturb(text: str, q: Array, seed: int = 1, arm: int = 0) -> Array:
    return reported_joints(q, STEP_NS * np.arange(len(q)), UNITS, parse_perturbations(text), seed, arm)


def still(count: int) -> Array:
    return np.full((count, len(NAMES)), 0.3)


def test_units_are_those_of_each_joint():
    """Set-up joints are braked; the wrist has all backlash, others half of it; a slide has 0.1 mm a degree."""
    rising = np.arange(400)[:, None] * np.where(UNITS.per_deg > 0.0, UNITS.per_deg, 0.01) * 0.01
    error = (perturb("backlash=1", rising) - rising)[-1]
    moving = NAMES.index("yaw")
    assert not error[:moving].any()
    expected = {"yaw": 0.5, "pitch": 0.5, "roll": 0.5, "wrist_pitch": 1.0, "wrist_yaw": 1.0, "jaw": 1.0}
    for name, degrees in expected.items():
        assert error[NAMES.index(name)] == pytest.approx(np.radians(degrees))
    assert error[NAMES.index("insertion")] == pytest.approx(0.5 * METRES_PER_DEG)


def test_noise_and_steps_have_their_size():
    noise = (perturb("joint_noise=0.05", still(4000)) - still(4000))[:, WRIST]
    assert noise.std() == pytest.approx(np.radians(0.05), rel=0.05)
    assert abs(np.corrcoef(noise[1:], noise[:-1])[0, 1]) < 0.06
    q = np.linspace(0.0, 0.1, 1000)[:, None] + np.zeros(len(NAMES))
    steps = perturb("quantisation=0.1", q)[:, WRIST]
    np.testing.assert_allclose(np.unique(np.diff(np.unique(steps))), np.radians(0.1), rtol=1e-9)
    assert np.abs(steps - q[:, WRIST]).max() <= np.radians(0.05) + 1e-12


@pytest.mark.slow
def test_drift_starts_at_zero_is_smooth_and_has_its_spread_after_8_s():
    paths = np.array([(perturb("joint_drift=0.5", still(801), seed) - still(801))[:, WRIST] for seed in range(200)])
    assert not paths[:, 0].any()
    assert np.degrees(paths[:, 800].std()) == pytest.approx(0.5, rel=0.15)
    assert np.degrees(np.abs(np.diff(paths, axis=1)).max()) < 0.5 / 100
    assert np.degrees(np.abs(np.diff(paths, 2, axis=1)).max()) < 1e-4


def test_seed_and_arm_draw_apart():
    one = perturb("joint_noise=1,joint_drift=1", still(20))
    np.testing.assert_array_equal(one, perturb("joint_noise=1,joint_drift=1", still(20)))
    for seed, arm in ((2, 0), (1, 1)):
        other = perturb("joint_noise=1,joint_drift=1", still(20), seed, arm)
        assert (one[1:, WRIST] != other[1:, WRIST]).all()


def test_a_log_of_other_order_names_and_joints_is_perturbed_alike():
    q = np.random.default_rng(2).normal(size=(3, len(NAMES)))
    order = [WRIST, NAMES.index("yaw")]
    names = [*(NAMES[index] for index in order), "gripper"]
    world = ReplayedWorld(parse_perturbations("joint_noise=1,backlash=1"), PROFILE, 1)
    _, found = world.reported("PSM1", names, STEP_NS * np.arange(3), np.column_stack([q[:, order], np.ones(3)]))
    whole = perturb("joint_noise=1,backlash=1", q)
    np.testing.assert_array_equal(found, np.column_stack([whole[:, order], np.ones(3)]))


@given(st.integers(-9, 9), st.integers(20, 60))
def test_a_lag_shifts_joints_exactly(samples_late, count):
    """By whole sample periods: what is reported is what was true so long ago, and goes on straight at the ends."""
    rng = np.random.default_rng(count)
    stamps = 1_700_000_000_000_000_000 + STEP_NS * np.arange(count)
    values = rng.normal(size=(count, 2))
    late = reported_late(values, stamps, Perturbations((("lag", 10.0 * samples_late),)))
    kept = np.arange(count)[(np.arange(count) >= samples_late) & (np.arange(count) < count + samples_late)]
    np.testing.assert_allclose(late[kept], values[kept - samples_late], atol=1e-12)
    if samples_late > 0:
        slope = values[1] - values[0]
        np.testing.assert_allclose(late[0], values[0] - samples_late * slope, atol=1e-11)


def test_a_lag_that_drifts_grows_with_time():
    stamps = STEP_NS * np.arange(1001)
    growing = parse_perturbations("lag=5,lag_drift=2")
    late_ms = 1e-6 * (late_stamps_ns(stamps, growing, 0) - stamps)
    np.testing.assert_allclose(late_ms[[0, 500, 1000]], [5.0, 15.0, 25.0])
    ramp = 1e-9 * stamps[:, None].astype(float)
    late = reported_late(ramp, stamps, growing)
    np.testing.assert_allclose(ramp[1000] - late[1000], 0.025, rtol=0.01)
