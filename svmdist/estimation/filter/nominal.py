"""The tool under nominal (uncorrected) kinematics, as sure as the profile says."""

from __future__ import annotations

import numpy as np

from svmdist.estimation.filter.error_model import ErrorModel
from svmdist.kinematics.dh import DHChain, shaft_of
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile import KinematicError
from svmdist.results import ToolPose


def nominal_tool(chain: DHChain, error: KinematicError, state: RobotState) -> ToolPose:
    """The tool's nominal pose in the camera frame and its covariance, as the profile states the errors.

    It is what the filter starts from, so that a method that filters and one that does not state the same. The
    covariance is of first order in the errors, and leaves out that turns shorten a lever: 2 degrees about two axes
    pull the tool 1.7 mm towards a base 1.4 m away, beside 68 mm of error.
    """
    model = ErrorModel(chain, error)
    links = model.links(model.nominal(state), model.no_correction(), model.anchor_m(state))
    tool, shaft = links.link(None), shaft_of(chain)
    axis = (
        tool.T_camera_link[:3, 0]
        if shaft is None
        else links.link(shaft.link).T_camera_link[:3, :3] @ shaft.axis
    )
    covariance = tool.derivative @ model.prior(state) @ tool.derivative.T
    return ToolPose(tool.T_camera_link, covariance, np.asarray(axis))
