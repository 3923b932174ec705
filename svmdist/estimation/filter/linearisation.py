"""Observations about a state: residual and derivatives, as filter and batch take them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from svmdist.estimation.filter.measurements import LinkMeasurement
from svmdist.transforms import Array, rotation_of

STEP = 1e-6
"""Step of the central differences in m and rad: truncation and rounding are both below 1e-8 px of it."""
TURNS = rotation_of(np.repeat(np.eye(3), 2, axis=0) * np.tile([STEP, -STEP], 3)[:, None])


@dataclass(frozen=True, slots=True)
class Linearised:
    """An measurement about a state: residual (m,) = H δ + `bias_jacobian` ξ + noise, of derivatives (m, n) and (m, k).

    δ is the error state, ξ the measurement's own error; nothing of it is finite where the link cannot be seen.
    """

    residual: Array
    H: Array
    bias_jacobian: Array
    noise: Array

    @property
    def is_finite(self) -> bool:
        """Whether the link could be seen."""
        return bool(np.all(np.isfinite(self.residual)) and np.all(np.isfinite(self.H)))

    @property
    def covariance(self) -> Array:
        """Of the residual where it is seen once, shape (m, m): noise and own error."""
        return np.asarray(self.noise + self.bias_jacobian @ self.bias_jacobian.T)


def linearise(measurement: LinkMeasurement, T_camera_link: Array, by_state: Array) -> Linearised:
    """An measurement about a link's pose, shape (4, 4), of which the state's derivative is (6, n)."""
    residual = measurement.residual(T_camera_link[None])[0]
    by_pose = pose_derivative(measurement, T_camera_link)
    bias_jacobian = measurement.bias_jacobian(T_camera_link, by_pose)
    return Linearised(residual, -by_pose @ by_state, bias_jacobian, measurement.covariance)


def pose_derivative(measurement: LinkMeasurement, T_camera_link: Array) -> Array:
    """Derivative of the residual by (δp, δθ) of the link's pose in the camera frame, shape (m, 6).

    Central differences: exact to 1e-6 of what they are, and one formula for every kind of measurement.
    """
    poses = np.repeat(T_camera_link[None], 12, axis=0)
    for column in range(3):
        poses[2 * column, column, 3] += STEP
        poses[2 * column + 1, column, 3] -= STEP
    poses[6:, :3, :3] = TURNS @ T_camera_link[:3, :3]
    residuals = measurement.residual(poses)
    if not np.all(np.isfinite(residuals)):
        return np.full((residuals.shape[1], 6), np.nan)
    return np.asarray((residuals[0::2] - residuals[1::2]).T / (2.0 * STEP))


def block_diagonal(blocks: Sequence[Array]) -> Array:
    """Square matrices along the diagonal of one."""
    size = sum(len(block) for block in blocks)
    joined = np.zeros((size, size))
    at = 0
    for block in blocks:
        joined[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return joined
