"""Measurements about a state: residual and derivatives, as filter and batch take them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from svmdist.estimation.filter.corrected_links import CorrectedLink
from svmdist.estimation.filter.measurement import LinkMeasurement
from svmdist.transforms import Array


@dataclass(frozen=True, slots=True)
class Linearised:
    """A measurement about a state: residual (..., m) = H δ + `bias_jacobian` ξ + noise.

    δ is the error state, ξ the measurement's bias, H has shape (..., m, n) and the bias Jacobian (..., m, k). Residual
    and H are not finite where the link cannot be seen.
    """

    residual: Array
    H: Array
    bias_jacobian: Array
    noise: Array

    @property
    def is_finite(self) -> bool:
        """Whether the link could be seen."""
        return bool(np.isfinite(self.residual).all() and np.isfinite(self.H).all())

    @property
    def covariance(self) -> Array:
        """Of the residual where it is seen once, shape (..., m, m): noise and bias."""
        return np.asarray(self.noise + self.bias_jacobian @ np.swapaxes(self.bias_jacobian, -1, -2))


def linearise(measurement: LinkMeasurement, link: CorrectedLink) -> Linearised:
    """A measurement about its link's pose."""
    by_pose = measurement.linearise(link.T_camera_link)
    return Linearised(
        by_pose.residual,
        -(by_pose.derivative @ link.derivative),
        measurement.bias_jacobian(link.T_camera_link, by_pose.derivative),
        measurement.covariance,
    )


def block_diagonal(blocks: Sequence[Array]) -> Array:
    """Square matrices along the diagonal of one."""
    size = sum(len(block) for block in blocks)
    joined = np.zeros((size, size))
    at = 0
    for block in blocks:
        joined[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return joined
