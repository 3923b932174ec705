"""What every 3D method finds first: the tool's pose in the camera frame, and how sure it is."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svmdist.transforms import Array


@dataclass(frozen=True, slots=True)
class ToolPose:
    """`T_camera_tool`, shape (4, 4), and the covariance of its error, shape (6, 6).

    The error is (δp, δθ), both in the camera frame: p_true = p + δp in m, R_true = exp([δθ]) R in rad. The
    tool's x axis points along the jaws; `axis` is the shaft's direction, from the base to the tip, a unit
    vector of shape (3,) in the camera frame.
    """

    T_camera_tool: Array
    covariance: Array
    axis: Array

    @property
    def position_m(self) -> Array:
        """The tool's origin in the camera frame, shape (3,)."""
        return np.asarray(self.T_camera_tool[:3, 3])

    @property
    def position_covariance(self) -> Array:
        """Covariance of the position, shape (3, 3), in m²."""
        return np.asarray(self.covariance[:3, :3])
