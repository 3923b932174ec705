"""The clearance between the instruments of one image, where a method found several of them in 3D."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import combinations

import numpy as np

from svmdist.estimation.distances import as_vector
from svmdist.estimation.instrument.model import InstrumentModel
from svmdist.estimation.instrument.pose import ToolPose
from svmdist.geometry.separation import Separation, capsule_separation
from svmdist.geometry.surfaces import Capsules
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
    gaps = _gaps(bodies)
    return [_with_nearest(row, poses, i, gaps) for i, row in enumerate(rows)]


def _gaps(bodies: Sequence[Capsules | None]) -> dict[tuple[int, int], Separation]:
    """The separation of each two bodies, and the same as seen from the other one."""
    gaps = {}
    for (i, body), (j, other) in combinations(enumerate(bodies), 2):
        if body is not None and other is not None:
            gaps[i, j] = capsule_separation(body, other)
            gaps[j, i] = gaps[i, j].reversed()
    return gaps


def _with_nearest(
    row: Estimate, poses: Sequence[ToolPose | None], i: int, gaps: dict[tuple[int, int], Separation]
) -> Estimate:
    """The row of instrument `i` with its smallest separation, where it has one."""
    others = [j for j in range(len(poses)) if (i, j) in gaps]
    if not others:
        return row
    nearest = min(others, key=lambda j: gaps[i, j].distance_m)
    gap, pose, other_pose = gaps[i, nearest], poses[i], poses[nearest]
    if pose is None or other_pose is None:  # what has a body has a pose
        return row
    return replace(
        row,
        instrument_clearance_m=gap.distance_m,
        instrument_clearance_std_m=between_std_m(gap, pose, other_pose),
        instrument_clearance_direction=as_vector(gap.direction),
    )


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
