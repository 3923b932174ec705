"""Smooth curves over a scenario's progress from 0 to 1: all twice continuously differentiable."""

from __future__ import annotations

import numpy as np

from svmdist.transforms import Array


def smooth_step(s: Array, start: float = 0.0, end: float = 1.0) -> Array:
    """Rise from 0 to 1 between `start` and `end` with zero velocity and acceleration at both (quintic)."""
    x = np.clip((s - start) / (end - start), 0.0, 1.0)
    return np.asarray(x**3 * (10.0 - 15.0 * x + 6.0 * x * x))


def smooth_pulse(s: Array, rise: tuple[float, float], fall: tuple[float, float]) -> Array:
    """Rise from 0 to 1 over one span of progress, and fall back over another."""
    return smooth_step(s, *rise) - smooth_step(s, *fall)


def cubic_spline(knots: Array, s: Array) -> Array:
    """Natural cubic spline through knots, shape (k, ...), evenly spaced over 0 to 1, at s, shape (n,)."""
    count = len(knots)
    h = 1.0 / (count - 1)
    # Second derivatives m solve m[i-1] + 4 m[i] + m[i+1] = 6 (k[i-1] - 2 k[i] + k[i+1]) / h², zero at ends.
    A = np.eye(count)
    right = np.zeros_like(knots)
    for index in range(1, count - 1):
        A[index, index - 1 : index + 2] = 1.0, 4.0, 1.0
        right[index] = 6.0 * (knots[index - 1] - 2.0 * knots[index] + knots[index + 1]) / h**2
    m = np.linalg.solve(A, right.reshape(count, -1)).reshape(knots.shape)
    left = np.clip((s / h).astype(int), 0, count - 2)
    shape = (-1, *([1] * (knots.ndim - 1)))
    b = (s / h - left).reshape(shape)
    a = 1.0 - b
    return np.asarray(
        a * knots[left] + b * knots[left + 1] + ((a**3 - a) * m[left] + (b**3 - b) * m[left + 1]) * h**2 / 6.0
    )


def wander(rng: np.random.Generator, s: Array, cycles: float = 1.5) -> Array:
    """A gentle wave between -1 and 1 with a random phase and frequencies about `cycles`, shape (n,)."""
    phases = rng.uniform(0.0, 2.0 * np.pi, 2)
    first = cycles * rng.uniform(0.85, 1.15)
    return np.asarray(
        0.65 * np.sin(2 * np.pi * first * s + phases[0])
        + 0.35 * np.sin(2 * np.pi * 2.3 * first * s + phases[1])
    )
