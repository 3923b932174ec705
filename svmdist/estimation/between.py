"""The clearance between the instruments of one image, where a method found several of them in 3D."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from svmdist.estimation.distances import as_vector
from svmdist.estimation.instrument.model import InstrumentModel
from svmdist.estimation.instrument.pose import ToolPose
from svmdist.geometry.separation import Separation, capsule_separation
from svmdist.samples import Estimate


def with_clearance_between(
    rows: Sequence[Estimate], models: Sequence[InstrumentModel | None]
) -> list[Estimate]:
    """The rows of one image, one an instrument, each with the smallest distance to another instrument's surface.

    A row without a pose, or whose instrument has no model, stays as it is, and is no other's neighbour.
    """
    poses = [_pose(row) if model is not None else None for row, model in zip(rows, models, strict=True)]
    bodies = [
        model.posed(pose, row.tool_state.joints, row.tool_state.has_plate)
        if model and pose and row.tool_state
        else None
        for row, model, pose in zip(rows, models, poses, strict=True)
    ]
    filled = []
    for i, row in enumerate(rows):
        gaps: list[tuple[Separation, ToolPose]] = []
        for j in range(len(rows)):
            body, other, other_pose = bodies[i], bodies[j], poses[j]
            if i != j and body is not None and other is not None and other_pose is not None:
                gaps.append((capsule_separation(body, other), other_pose))
        pose = poses[i]
        if gaps and pose is not None:
            gap, other_pose = min(gaps, key=lambda found: found[0].distance_m)
            told = replace(
                row,
                instrument_clearance_m=gap.distance_m,
                instrument_clearance_std_m=between_std_m(gap, pose, other_pose),
                instrument_clearance_direction=as_vector(gap.direction),
            )
            filled.append(told)
        else:
            filled.append(row)
    return filled


def between_std_m(gap: Separation, pose: ToolPose, other: ToolPose) -> float:
    """Standard deviation of a separation of two instruments that err independently.

    As for the tissue (see `distances.py`), only the motion of the closest points along the direction d counts:
    d · (δp + δθ x r) of each instrument, with r from its tool to its closest point.
    """
    variance = 0.0
    for end_m, of in ((gap.on_instrument_m, pose), (gap.on_tissue_m, other)):
        derivative = np.concatenate([gap.direction, np.cross(end_m - of.position_m, gap.direction)])
        variance += float(derivative @ of.covariance @ derivative)
    return float(np.sqrt(max(variance, 0.0)))


def _pose(row: Estimate) -> ToolPose | None:
    state = row.tool_state
    if state is None or not row.measured:
        return None
    return ToolPose(state.T_camera_tool, state.covariance, state.axis)
