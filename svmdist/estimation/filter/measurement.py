"""What a measurement of a link is for the filter: a residual of the link's pose, its derivative, noise and bias.

A measurement may also be a stack of many of its kind. Its fields have a leading axis then, and `linearise` takes as
many poses. `filter.stacks` makes them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar, Protocol

import numpy as np
from numpy.typing import NDArray

from svmdist.estimation.filter.constants import SharedBias
from svmdist.transforms import Array


@dataclass(frozen=True, slots=True)
class PoseResidual:
    """Measured minus predicted, shape (..., m), and its derivative by (δp, δθ) of the link's pose, shape (..., m, 6).

    δp in m and δθ in rad are in the camera frame, p + δp and exp([δθ]) R. The residual is inf and the derivative NaN
    where the link cannot be seen.
    """

    residual: Array
    derivative: Array

    @classmethod
    def where_visible(
        cls, visible: NDArray[np.bool_] | np.bool_, residual: Array, derivative: Array
    ) -> PoseResidual:
        """With what is invisible, shape (...), marked as such."""
        if visible.all():
            return cls(residual, derivative)
        return cls(
            np.where(np.asarray(visible)[..., None], residual, np.inf),
            np.where(np.asarray(visible)[..., None, None], derivative, np.nan),
        )


class LinkMeasurement(Protocol):
    """A measurement of the frame of the DH row `link`, or of the tool where that is None.

    `covariance` is that of what changes from frame to frame, the noise. What stays alike, the bias, is a vector of
    `bias_size` numbers of variance one that fade with the time constant `correlation_time_s`.
    """

    __dataclass_fields__: ClassVar[dict[str, Any]]
    STACKED: ClassVar[tuple[str, ...]]
    """Fields with a leading axis in a stack."""
    bias_size: ClassVar[int]
    source: ClassVar[str]
    """The detection that it is made of."""

    @property
    def name(self) -> str:
        """What was measured, for a person."""

    @property
    def link(self) -> str | None:
        """The DH row whose frame was measured."""

    @property
    def covariance(self) -> Array:
        """Covariance of the residual's noise, shape (..., m, m)."""

    @property
    def bias_name(self) -> str:
        """Measurements of one such name share one bias."""

    @property
    def delay_std_s(self) -> float:
        """How late what was measured may be against the rest of its image, as where colour is of two fields."""

    @property
    def correlation_time_s(self) -> float:
        """How long the bias lasts: the time constant of its fading."""

    def linearise(self, T_camera_link: Array) -> PoseResidual:
        """Residual and derivative about poses of the link, shape (..., 4, 4)."""

    def bias_jacobian(self, T_camera_link: Array, derivative: Array, /) -> Array:
        """Derivative of the residual by the bias, (..., m, bias_size), from the pose and the pose's derivative."""

    def shared_biases(self, T_camera_link: Array, /) -> tuple[SharedBias, ...]:
        """What errors of constants do to the residual."""


class ConstantBias:
    """What measurements have in common whose bias Jacobian is the same for all poses: a bias of their own name."""

    name: str
    delay_std_s: ClassVar[float] = 0.0

    @property
    def bias_name(self) -> str:
        """It shares its bias with measurements of the same name only."""
        return self.name
