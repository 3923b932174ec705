"""A hand-eye file's transform with what constants did to it: carried to a place, and restated by a profile."""

import numpy as np
import pytest

from svmdist.profile import load_profile
from svmdist.profile.hand_eye import (
    OFFSET,
    SHAFT_RADIUS,
    ConstantEffect,
    HandEye,
    HandEyeFile,
    load_hand_eye,
    prior_deviations,
    save_hand_eye,
)
from svmdist.transforms import skew

PROFILE = load_profile("psm13")
NOISE = 1e-6 * np.diag([1.0, 2.0, 3.0, 0.4, 0.5, 0.6])
BY_RADIUS = np.array([[1e-3, 2e-3, 4e-3, 0.0, 0.01, 0.0]])
BY_PITCH = np.array([[0.0, 1e-3, 0.0, 0.02, 0.0, -0.01]])


@pytest.fixture
def hand_eye() -> HandEye:
    """A transform that a radius and a joint had a part in."""
    stated, assumed = prior_deviations(PROFILE), PROFILE.robot
    joint = OFFSET.format(next(one.name for one in assumed.joints if one.type == "revolute"))
    effects = [
        ConstantEffect(constant=name, deviation=stated[name], effects=effect.tolist())
        for name, effect in ((SHAFT_RADIUS, BY_RADIUS), (joint, BY_PITCH))
    ]
    return HandEye.model_validate(
        {
            "instrument": PROFILE.instrument_name,
            "camera": PROFILE.frames.camera,
            "base": PROFILE.frames.base,
            "rotation": np.eye(3).tolist(),
            "translation_m": [0.01, 0.02, 0.1],
            "covariance": (NOISE + BY_RADIUS.T @ BY_RADIUS + BY_PITCH.T @ BY_PITCH).tolist(),
            "constants": effects,
        }
    )


def test_effects_are_carried_as_the_covariance_is(hand_eye):
    """What is left of the covariance at a place without the effects there is the noise, carried there."""
    place = np.array([0.03, -0.02, 0.15])
    J = np.eye(6)
    J[:3, 3:] = -skew(place - np.array(hand_eye.translation_m))
    rest = hand_eye.covariance_at(place) - sum(e @ e.T for e in hand_eye.effects_at(place).values())
    np.testing.assert_allclose(rest, J @ NOISE @ J.T, atol=1e-18)


def test_a_deviation_that_is_stated_anew_scales_its_effect(hand_eye):
    """An exact constant has no effect; one that the profile lacks stays in the covariance."""
    stated = {one.constant: one.deviation for one in hand_eye.constants}
    wider = hand_eye.with_deviations(stated | {SHAFT_RADIUS: 3.0 * stated[SHAFT_RADIUS]})
    expected = NOISE + 9.0 * BY_RADIUS.T @ BY_RADIUS + BY_PITCH.T @ BY_PITCH
    np.testing.assert_allclose(wider.covariance, expected, atol=1e-15)
    np.testing.assert_allclose(wider.effects_at(np.array(hand_eye.translation_m))[SHAFT_RADIUS].T, 3.0 * BY_RADIUS)
    exact = hand_eye.with_deviations(stated | {SHAFT_RADIUS: 0.0})
    assert [one.constant for one in exact.constants] == [hand_eye.constants[1].constant]
    np.testing.assert_allclose(exact.covariance, NOISE + BY_PITCH.T @ BY_PITCH, atol=1e-15)
    alone = hand_eye.with_deviations({})
    assert alone.constants == ()
    np.testing.assert_allclose(alone.covariance, hand_eye.covariance)


def test_the_file_keeps_them_and_files_without_them_are_read(hand_eye, tmp_path):
    path = tmp_path / "hand-eye.toml"
    save_hand_eye(path, HandEyeFile(format="svmdist.hand-eye/1", transforms=(hand_eye,)))
    assert load_hand_eye(path).transforms[0] == hand_eye
    plain = hand_eye.model_copy(update={"constants": ()})
    save_hand_eye(path, HandEyeFile(format="svmdist.hand-eye/1", transforms=(plain,)))
    text = path.read_text("utf-8").replace("constants = []\n", "")
    path.write_text(text, "utf-8")
    assert load_hand_eye(path).transforms[0].constants == ()


def test_a_profile_states_its_own_deviations(hand_eye):
    """The instrument's profile has the file's effects in its own deviations, and does not restate them twice."""
    wide = PROFILE.instrument.model_copy(update={"shaft_radius_std_fraction": 0.04})
    file = HandEyeFile(format="svmdist.hand-eye/1", transforms=(hand_eye,))
    own = PROFILE.model_copy(update={"instrument": wide, "hand_eye": file})
    once = own.for_instrument(PROFILE.instrument_name)
    again = once.for_instrument(PROFILE.instrument_name)
    for found in (once, again):
        effect = next(one for one in found.kinematic_error.hand_eye.constants if one.constant == SHAFT_RADIUS)
        assert effect.deviation == 0.04
