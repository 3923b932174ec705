"""The lag between images and kinematics, on made-up tracks whose lag is known."""

import numpy as np

from svmdist.estimation.alignment import estimate_lag

PERIOD_NS = 100_000_000
STAMPS_NS = np.arange(80, dtype=np.int64) * PERIOD_NS


def _track(seconds: np.ndarray) -> np.ndarray:
    """A smooth, aperiodic motion in px, shape (n, 2)."""
    x = np.sin(1.7 * seconds) + 0.5 * np.sin(0.61 * seconds + 1.0)
    y = np.cos(2.3 * seconds + 0.4) + 0.4 * np.sin(0.83 * seconds)
    return 90.0 * np.stack([x, y], -1) + 250.0


def _predict(stamps_ns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Kinematics know the motion from -0.2 s to 8.2 s."""
    seconds = stamps_ns / 1e9
    return _track(seconds), (seconds >= -0.2) & (seconds <= 8.2)


def test_standard_deviation_is_honest():
    """Over 60 draws of noise, the error's spread agrees with the stated standard deviation within a factor of 2."""
    errors, stated = [], []
    for seed in range(60):
        noise = np.random.default_rng(seed).normal(0.0, 1.5, (80, 2))
        estimate = estimate_lag(STAMPS_NS, _track(STAMPS_NS / 1e9) + noise, _predict)
        errors.append(estimate.lag_s)
        stated.append(estimate.std_s)
    assert 0.5 < np.std(errors) / np.mean([std for std in stated if std is not None]) < 2.0


def test_an_ambiguous_motion_says_so():
    """A motion that repeats every second fits at several lags: none is told."""

    def circle(seconds: np.ndarray) -> np.ndarray:
        return 80.0 * np.stack([np.cos(2 * np.pi * seconds), np.sin(2 * np.pi * seconds)], -1)

    def predict(stamps_ns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return circle(stamps_ns / 1e9), np.ones(len(stamps_ns), np.bool_)

    noise = np.random.default_rng(1).normal(0.0, 0.5, (80, 2))
    estimate = estimate_lag(STAMPS_NS, circle(STAMPS_NS / 1e9) + noise, predict)
    assert not estimate.is_observable
    assert "another lag" in estimate.reason
