"""The first step of every method: what is known of a frame before the tool is measured."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from svmdist.estimation.frame import Frame
from svmdist.estimation.instrument.model import InstrumentModel
from svmdist.estimation.instrument.verification import contradiction
from svmdist.estimation.tissue.detection import TissuePose
from svmdist.geometry import Capsules
from svmdist.geometry.distance import Separation, capsule_separation, separation
from svmdist.results import Distance, Distances, FrameResult, ToolEstimate, ToolPose, as_pixel, as_vector
from svmdist.samples import Status
from svmdist.transforms import Array, cross, make_transform

INDEPENDENT = np.zeros((6, 3))


def with_tissue(frame: Frame) -> FrameResult:
    """A result of status `ok` with the tissue that this frame shows, or of `no_tissue`."""
    result, tissue = FrameResult(frame.stamp_ns, Status.OK), frame.scene.tissue
    if tissue is None:
        return result.rejected(Status.NO_TISSUE)
    result = result.with_image(tissue_px=as_pixel(tissue.outline.centroid_px), tissue_area_px=tissue.region.area_px)
    if tissue.pose is None:
        return result.rejected(Status.NO_TISSUE, "the tissue's ray does not meet the profile's plane")
    return result


def measured(
    result: FrameResult, frame: Frame, tool: ToolEstimate, tissue: TissuePose, cross_covariance: Array = INDEPENDENT
) -> FrameResult:
    """The result with the tool, its place in the image, and the distances from it to the tissue.

    `cross_covariance`, shape (6, 3), is the covariance of the tool's pose with the tissue's place. Without sizes of the
    instrument in the profile there is no clearance. A value that is not finite rejects the frame.
    """
    pose = tool.pose
    offset_m = pose.position_m - tissue.position_m
    covariance = pose.position_covariance + tissue.covariance - cross_covariance[:3] - cross_covariance[:3].T
    if not all(np.isfinite(part).all() for part in (pose.T_camera_tool, pose.covariance, offset_m, covariance)):
        return result.rejected(Status.NOT_FINITE)
    planar, spatial = _length(offset_m[:2], covariance[:2, :2]), _length(offset_m, covariance)
    clearance = capsules = None
    if frame.arm.body is not None:
        capsules = frame.arm.body.posed(tool)
        gap = separation(capsules, tissue.surface)
        frame.left.measured_surface = tissue.surface
        parts_m = clearance_std_m(gap, pose, tissue, cross_covariance), _bent_std_m(gap, capsules, pose, tissue)
        std_m = float(np.linalg.norm([*parts_m, frame.arm.body.instrument.body_std_m]))
        # With all of an overlap in it: soft tissue has given way, or tool or tissue is elsewhere.
        overlap_std_m = float(np.hypot(std_m, max(-gap.distance_m, 0.0)))
        ends = as_vector(gap.direction), as_vector(gap.on_instrument_m)
        clearance = Distance(gap.distance_m, overlap_std_m, *ends, std_m)
    result = with_tool(result, frame, tool)
    if reason := contradiction(frame, pose, capsules, tissue):
        return result.rejected(Status.INCONSISTENT, reason)
    return replace(result, status=Status.OK, distances=Distances(planar, spatial, clearance))


def with_tool(result: FrameResult, frame: Frame, tool: ToolEstimate) -> FrameResult:
    """The result with the tool, and its place in the image where it is before the camera."""
    result, position_m = replace(result, tool=tool), tool.pose.position_m
    if not position_m[2] > 0.0:
        return result
    return result.with_image(tool_px=as_pixel(frame.left.camera.project(position_m)[0]))


def clearance_std_m(gap: Separation, pose: ToolPose, tissue: TissuePose, cross_covariance: Array) -> float:
    """Standard deviation of a separation from an instrument of known shape; `cross_covariance` as in `measured`.

    The closest points are extremal, so to first order a small motion changes the distance only through their own motion
    along the direction d (envelope theorem): by -d · (δp + δθ x r) for the instrument, with r from the tool to its
    closest point, and by d · δt for the tissue. Errors of the surface model at the closest point carry over.
    """
    variance, moves = _along(gap.direction, gap.on_instrument_m, pose)
    if not tissue.is_measured:
        variance += float(gap.direction @ tissue.covariance @ gap.direction)
        variance -= 2.0 * float(moves @ cross_covariance @ gap.direction)
    variance += tissue.surface_variance_m2(gap.on_tissue_m, gap.direction)
    return float(np.sqrt(max(variance, 0.0)))


def _bent_std_m(gap: Separation, capsules: Capsules, pose: ToolPose, tissue: TissuePose) -> float:
    """What `clearance_std_m` leaves out: another point becomes the closest along where the tool is least sure."""
    # By separations of the tool moved by ±√3 deviations, as sigma points (Julier and Uhlmann 2004).
    variances, axes = np.linalg.eigh(pose.position_covariance)
    step_m = float(np.sqrt(3.0 * max(variances[-1], 0.0))) * axes[:, -1]
    squared = -2.0 * float(gap.direction @ step_m) ** 2
    for moved_m in (step_m, -step_m):
        moved = capsules.transformed(make_transform(np.eye(3), moved_m))
        squared += (separation(moved, tissue.surface).distance_m - gap.distance_m) ** 2
    return float(np.sqrt(max(squared / 6.0, 0.0)))


def _along(direction: Array, point_m: Array, pose: ToolPose) -> tuple[float, Array]:
    """Variance in m² of a tool's point, (3,), along a unit vector, (3,); how far its (δp, δθ) moves it there, (6,)."""
    moves = np.concatenate([direction, cross(point_m - pose.position_m, direction)])
    return float(moves @ pose.covariance @ moves), moves


def _length(offset_m: Array, covariance: Array) -> Distance:
    """Length of an offset and its standard deviation, to second order.

    To first order an error across the offset does not change its length L: that is true of errors that are small
    against L, and a tool seen by one camera may be close to the tissue and uncertain along the view. With the unit
    vector u and the curvature H = (I - u uᵀ) / L, the squared error of the length is
    uᵀ Σ u + tr((H Σ)²) / 2 + (tr(H Σ) / 2)². It is never more than that of the whole offset, tr Σ, as |δL| <= |δ|.
    """
    length_m, most = float(np.linalg.norm(offset_m)), float(np.trace(covariance))
    if length_m == 0.0:
        return Distance(0.0, float(np.sqrt(max(most, 0.0))))
    along = offset_m / length_m
    across = (covariance - np.outer(along, along @ covariance)) / length_m  # H Σ
    variance = float(along @ covariance @ along)
    variance += 0.5 * float(np.sum(across * across.T)) + 0.25 * float(np.trace(across)) ** 2
    return Distance(length_m, float(np.sqrt(max(min(variance, most), 0.0))))


def with_clearance_between(rows: Sequence[FrameResult], bodies: Sequence[InstrumentModel | None]) -> list[FrameResult]:
    """The results of one image, one per instrument, each with the smallest distance to another instrument's surface."""
    posed = [
        (at, body.posed(row.tool), row.tool.pose, body)
        for at, (row, body) in enumerate(zip(rows, bodies, strict=True))
        if row.tool is not None and body is not None and row.measured
    ]
    filled = list(rows)
    for first, (i, capsules, pose, body) in enumerate(posed):
        for j, other_capsules, other_pose, other_body in posed[:first]:
            gap = capsule_separation(capsules, other_capsules)
            of_surfaces_m = np.hypot(body.instrument.body_std_m, other_body.instrument.body_std_m)
            std_m = float(np.hypot(between_std_m(gap, pose, other_pose), of_surfaces_m))
            ends = ((i, gap.direction, gap.on_instrument_m), (j, -gap.direction, gap.on_tissue_m))
            for at, direction, start_m in ends:
                found, distances = filled[at], filled[at].distances
                if distances.to_instrument is None or gap.distance_m < distances.to_instrument.value_m:
                    distance = Distance(gap.distance_m, std_m, as_vector(direction), as_vector(start_m))
                    filled[at] = replace(found, distances=replace(distances, to_instrument=distance))
    return filled


def between_std_m(gap: Separation, pose: ToolPose, other: ToolPose) -> float:
    """Standard deviation of a separation of two instruments of known shape that err independently."""
    variance = _along(gap.direction, gap.on_instrument_m, pose)[0] + _along(gap.direction, gap.on_tissue_m, other)[0]
    return float(np.sqrt(max(variance, 0.0)))
