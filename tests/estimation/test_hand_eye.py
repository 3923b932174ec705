"""The camera-to-base transform from places of the tool: exact without noise, robust, and as certain as it says."""

from dataclasses import replace

import numpy as np
import pytest

from svmdist.estimation.alignment import HandEyeFit, ToolPlaces, fit_hand_eye
from svmdist.profile.settings import HandEyeSettings
from svmdist.transforms import make_transform, rotation_of, rotation_vector, transform_points

T_CAMERA_BASE = make_transform(rotation_of([2.8, 0.3, -0.5]), [0.05, -0.1, 0.2])
STEP_NS = 10**9
"""A second between frames, more than errors last."""


def _places(rng: np.random.Generator, count: int = 60, noise_m: float = 0.0, shared: int = 0) -> ToolPlaces:
    """Places all over a view, seen with noise that is larger along the line of sight, and errors that all share."""
    seen_m = rng.uniform([-0.03, -0.02, 0.08], [0.03, 0.02, 0.13], (count, 3))
    R = T_CAMERA_BASE[:3, :3]
    nominal_m = (seen_m - T_CAMERA_BASE[:3, 3]) @ R
    axis = rng.normal([0.2, 0.3, 1.0], 0.1, (count, 3))
    axis /= np.linalg.norm(axis, axis=1, keepdims=True)
    camera_shared = np.zeros((count, 6, shared))
    drawn = rng.normal(size=shared)
    for k in range(shared):
        camera_shared[:, :3, k] = 0.02 * seen_m if k == 0 else 0.01 * np.roll(seen_m, k, 1)
    std = noise_m * np.array([1.0, 1.0, 3.0])
    stated = np.maximum(std, 1e-9)
    noisy_m = seen_m + rng.normal(size=(count, 3)) * std + camera_shared[:, :3] @ drawn
    return ToolPlaces(
        np.arange(count) * STEP_NS,
        noisy_m,
        np.repeat(np.diag(stated**2)[None], count, 0),
        nominal_m,
        np.zeros((count, 3, 3)),
        axis,
        np.full(count, np.nan),
        axis @ R,
        np.zeros((count, 6, 0)),
        camera_shared,
    )


def _fitted(places: ToolPlaces) -> HandEyeFit:
    fit = fit_hand_eye(places, HandEyeSettings())
    assert isinstance(fit, HandEyeFit), fit
    return fit


def test_exact_without_noise():
    """What agrees exactly gives the transform to 1e-9."""
    fit = _fitted(_places(np.random.default_rng(1)))
    np.testing.assert_allclose(fit.T_camera_base, T_CAMERA_BASE, atol=1e-9)
    assert fit.inliers.all()


def test_outliers_are_left_out():
    """A third of the places are somewhere else: they are told, and the transform stays."""
    rng = np.random.default_rng(3)
    places = _places(rng, 90, 3e-4)
    wild = np.arange(90) % 3 == 0
    seen_m = places.seen_m.copy()
    seen_m[wild] += rng.normal(size=(30, 3)) * 0.02 + 0.01
    fit = _fitted(replace(places, seen_m=seen_m))
    assert not fit.inliers[wild].any()
    assert fit.inliers[~wild].mean() > 0.95
    off_m = transform_points(fit.T_camera_base, places.nominal_m) - places.seen_m
    assert np.linalg.norm(off_m, axis=1).max() < 5e-3


@pytest.mark.parametrize("shared", [0, 2])
def test_errors_are_within_the_stated_ellipsoid(shared, monkeypatch):
    """Over 100 draws, noise and errors that all frames share leave 90 % or more in the 95 % ellipsoid."""
    rng = np.random.default_rng(4)
    monkeypatch.setattr("svmdist.estimation.alignment.POSITION_FLOOR_M", 1e-9)
    monkeypatch.setattr("svmdist.estimation.alignment.TRIALS", 20)
    distances = []
    for _ in range(100):
        fit = _fitted(_places(rng, 40, 5e-4, shared))
        turn = rotation_vector(T_CAMERA_BASE[:3, :3] @ fit.T_camera_base[:3, :3].T)
        error = np.concatenate([T_CAMERA_BASE[:3, 3] - fit.T_camera_base[:3, 3], turn])
        distances.append(error @ np.linalg.solve(fit.covariance, error))
    inside = np.mean(np.array(distances) < 12.6)  # chi square of 6 degrees of freedom, 95 %
    assert inside >= 0.9
    # Shared errors dwarf the noise; without them the ellipsoid is no wider than it must be.
    assert shared > 0 or 3.0 < np.mean(distances) < 8.0


@pytest.mark.parametrize(
    ("scale", "said"),
    [
        ([0.0, 0.0, 0.0], "the tool moved by 0.0 mm only"),
        ([1.0, 0.0, 0.0], "along a line only"),
        ([1.0, 0.02, 0.0], "the rotation is uncertain by"),
    ],
)
def test_too_little_motion_is_refused(scale, said):
    """A still tool, a line, and nearly a line determine no rotation."""
    places = _places(np.random.default_rng(6), 40, 3e-4)
    noise = places.seen_m - transform_points(T_CAMERA_BASE, places.nominal_m)
    nominal = places.nominal_m[0] + (places.nominal_m - places.nominal_m[0]) * scale
    seen = transform_points(T_CAMERA_BASE, nominal) + noise
    fit = fit_hand_eye(replace(places, seen_m=seen, nominal_m=nominal), HandEyeSettings())
    assert said in fit.reason
