"""The clearance between the instruments of one image, where a method found several of them in 3D."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from svmdist.estimation.distances import variance_along
from svmdist.estimation.instrument.model import InstrumentModel
from svmdist.geometry.separation import Separation, capsule_separation
from svmdist.geometry.surfaces import Capsules
from svmdist.results import Distance, FrameResult, ToolPose, as_vector


def with_clearance_between(
    results: Sequence[FrameResult], bodies: Sequence[InstrumentModel | None]
) -> list[FrameResult]:
    """The results of one image, one per instrument, each with the smallest distance to another instrument's surface.

    A result without a pose, or whose instrument has no body, stays as it is, and is no other's neighbour.
    """
    posed = [_posed(result, body) for result, body in zip(results, bodies, strict=True)]
    filled = list(results)
    nearest: dict[int, Distance] = {}
    for i, first in enumerate(posed):
        for j, second in enumerate(posed[:i]):
            if first is None or second is None:
                continue
            gap = capsule_separation(first[0], second[0])
            std_m = float(np.hypot(between_std_m(gap, first[1], second[1]), np.hypot(first[2], second[2])))
            ends = ((i, gap.direction, gap.on_instrument_m), (j, -gap.direction, gap.on_tissue_m))
            for at, direction, start_m in ends:
                distance = Distance(gap.distance_m, std_m, as_vector(direction), as_vector(start_m))
                nearest[at] = min(nearest.get(at, distance), distance, key=lambda found: found.value_m)
    for at, distance in nearest.items():
        distances = replace(results[at].distances, to_instrument=distance)
        filled[at] = replace(results[at], distances=distances)
    return filled


def between_std_m(gap: Separation, pose: ToolPose, other: ToolPose) -> float:
    """Standard deviation of a separation of two instruments of known shape that err independently.

    As for the tissue (see `distances.py`), only the motion of the closest points along the direction counts.
    """
    variance = variance_along(gap.direction, gap.on_instrument_m, pose)
    variance += variance_along(gap.direction, gap.on_tissue_m, other)
    return float(np.sqrt(max(variance, 0.0)))


def _posed(result: FrameResult, body: InstrumentModel | None) -> tuple[Capsules, ToolPose, float] | None:
    tool = result.tool
    if tool is None or body is None or not result.measured:
        return None
    return body.posed(tool.pose, tool.joints, tool.has_plate), tool.pose, body.surface_std_m
