"""The batch of the first frames: the prior where nothing was seen, and the truth where enough was."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.estimation.instrument.corrected_links import Correction
from svmdist.estimation.instrument.error_model import ErrorModel
from svmdist.estimation.instrument.measurement_kinds import PoseMeasurement
from svmdist.estimation.instrument.window import MeasurementsAt, Window
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile.settings import FilterSettings
from svmdist.transforms import Array, make_transform, rotation_of
from tests.shipped import CHAIN, CONSTANT_ERROR, POSTURE
from tests.synthetic import make_scene

MODEL = ErrorModel(CHAIN, CONSTANT_ERROR)
ROBOT = RobotState(CHAIN, 0, POSTURE, make_scene().T_camera_base)
PRIOR = MODEL.prior(ROBOT)


@pytest.fixture
def window() -> Window:
    return Window(MODEL, MODEL.anchor_m(ROBOT), PRIOR, FilterSettings())


def seen(T_camera_tool: Array, std: float = 1e-5) -> PoseMeasurement:
    """The tool's pose measured as a whole, far better than the prior knows it."""
    covariance = std**2 * np.eye(6)
    return PoseMeasurement("tool", None, np.eye(4), T_camera_tool, covariance, 1e-2 * covariance)


def tool_at(correction: Correction) -> Array:
    links = MODEL.links(MODEL.nominal(ROBOT), correction, MODEL.anchor_m(ROBOT))
    return links.link(None).T_camera_link


TRUTH = make_transform(
    rotation_of([0.01, -0.02, 0.015]) @ ROBOT.T_camera_tool[:3, :3],
    ROBOT.T_camera_tool[:3, 3] + [0.004, -0.006, 0.003],
)


def test_without_measurements_it_is_the_prior(window: Window) -> None:
    """One frame that shows nothing: no correction, from wherever the search starts.

    The sum of squares is within 1e-3 of its minimum, where the search ends: 3 % of a deviation.
    """
    window.add(MeasurementsAt(ROBOT, ()))
    rng = np.random.default_rng(2)
    for start in (MODEL.no_correction(), MODEL.no_correction().retract(1e-3 * rng.normal(size=MODEL.size))):
        found = window.solve(start)
        assert found is not None
        assert found.vector() @ np.linalg.solve(PRIOR + 1e-14 * np.eye(MODEL.size), found.vector()) < 1e-3
    np.testing.assert_allclose(window.prior_at(MODEL.no_correction()), PRIOR, rtol=1e-9, atol=1e-15)
    np.testing.assert_allclose(window.step_to_prior(MODEL.no_correction()), 0.0, atol=1e-15)


def test_the_step_to_the_prior_leads_there(window: Window) -> None:
    """To second order in a turn of 0.02 rad: 0.02² of it."""
    at = MODEL.no_correction().retract(0.02 * np.random.default_rng(3).normal(size=MODEL.size) * 0.5)
    np.testing.assert_allclose(at.retract(window.step_to_prior(at)).vector(), 0.0, atol=4e-4)


def test_what_was_measured_well_is_found(window: Window) -> None:
    """Centimetres of prior against 10 µm: the tool is where it was seen, within three deviations."""
    window.add(MeasurementsAt(ROBOT, (seen(TRUTH),)))
    found = window.solve(MODEL.no_correction())
    assert found is not None
    np.testing.assert_allclose(tool_at(found), TRUTH, atol=3e-5)


def test_one_wild_detection_is_outvoted(window: Window) -> None:
    """Three frames that agree and one that is 30 mm off: the tool is where three saw it, and it is left out."""
    wild = TRUTH.copy()
    wild[0, 3] += 0.03
    for T in (TRUTH, TRUTH, wild, TRUTH):
        window.add(MeasurementsAt(ROBOT, (seen(T, 1e-4),)))
    assert len(window) == 4
    found = window.solve(MODEL.no_correction())
    assert found is not None
    np.testing.assert_allclose(tool_at(found), TRUTH, atol=3e-4)
    weights = [frame.weights for frame in window.linearised(found)]
    assert weights[2] == ()
    assert min(weights[0][0], weights[1][0], weights[3][0]) > 0.9


def test_frames_come_back_as_they_were_added(window: Window) -> None:
    """Each with its measurements that are visible, and a residual of its own."""
    measured = [seen(TRUTH, 0.02), seen(ROBOT.T_camera_tool)]
    for one in measured:
        window.add(MeasurementsAt(ROBOT, (one,)))
    window.add(MeasurementsAt(ROBOT, ()))
    frames = list(window.linearised(MODEL.no_correction()))
    assert [frame.measurements for frame in frames] == [(measured[0],), (measured[1],), ()]
    np.testing.assert_allclose(frames[1].parts[0].residual, 0.0, atol=1e-12)
    assert np.abs(frames[0].parts[0].residual).max() > 1e-3
