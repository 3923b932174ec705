"""Measurements about a state: residual and derivatives, as filter and batch take them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from svmdist.estimation.filter.constants import SharedBias
from svmdist.estimation.filter.corrected_links import CorrectedLink
from svmdist.estimation.filter.measurement import LinkMeasurement
from svmdist.transforms import Array


@dataclass(frozen=True, slots=True)
class Linearised:
    """A measurement about a state: residual (..., m) = H δ + Σ B ξ + noise.

    δ is the error state, H has shape (..., m, n); of the biases, the first is the measurement's own and the others are
    errors of constants. Residual and H are not finite where the link cannot be seen.
    """

    residual: Array
    H: Array
    biases: tuple[SharedBias, ...]
    noise: Array

    @property
    def is_finite(self) -> bool:
        """Whether the link could be seen."""
        return bool(np.isfinite(self.residual).all() and np.isfinite(self.H).all())

    @property
    def bias_jacobian(self) -> Array:
        """Derivative by all biases, one beside the other, shape (..., m, k)."""
        shape = self.residual.shape
        return np.concatenate(
            [np.broadcast_to(bias.jacobian, (*shape, bias.jacobian.shape[-1])) for bias in self.biases], -1
        )

    def member(self, k: int) -> Linearised:
        """One of a stack."""
        several = self.residual.shape[0]
        biases = tuple(
            SharedBias(
                bias.name,
                np.broadcast_to(bias.jacobian, (several, *bias.jacobian.shape[-2:]))[k],
                bias.correlation_time_s,
            )
            for bias in self.biases
        )
        return Linearised(self.residual[k], self.H[k], biases, self.noise[k])

    @property
    def covariance(self) -> Array:
        """Of the residual where it is seen once, shape (..., m, m): noise and bias."""
        B = self.bias_jacobian
        return np.asarray(self.noise + B @ np.swapaxes(B, -1, -2))


def linearise(measurement: LinkMeasurement, link: CorrectedLink) -> Linearised:
    """A measurement about its link's pose."""
    by_pose = measurement.linearise(link.T_camera_link)
    own = SharedBias(
        measurement.bias_name,
        measurement.bias_jacobian(link.T_camera_link, by_pose.derivative),
        measurement.correlation_time_s,
    )
    H = -(by_pose.derivative @ link.derivative)
    biases = (own, *measurement.shared_biases(link.T_camera_link))
    if measurement.delay_std_s > 0.0:
        by_time = H[..., link.time_column, None] * measurement.delay_std_s
        biases = (*biases, SharedBias("delay of colour", by_time))
    return Linearised(by_pose.residual, H, biases, measurement.covariance)


def block_diagonal(blocks: Sequence[Array]) -> Array:
    """Square matrices along the diagonal of one."""
    size = sum(len(block) for block in blocks)
    joined = np.zeros((size, size))
    at = 0
    for block in blocks:
        joined[at : at + len(block), at : at + len(block)] = block
        at += len(block)
    return joined
