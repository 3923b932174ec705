"""The distances between a tool and the tissue in 3D, and their standard deviations.

Errors are propagated to first order (ISO/IEC Guide 98-3, sec. 5.1), those of a length to second. Tool and tissue are
measured from different pixels, but perhaps by the same wrong camera: a method that knows says how their errors go
together.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from svmdist.estimation.frame import Frame
from svmdist.estimation.tissue.pose import TissuePose
from svmdist.geometry.separation import Separation, separation
from svmdist.results import Distance, Distances, FrameResult, ToolEstimate, ToolPose, as_pixel, as_vector
from svmdist.samples import Status
from svmdist.transforms import Array

INDEPENDENT = np.zeros((6, 3))


def measured(
    result: FrameResult,
    frame: Frame,
    tool: ToolEstimate,
    tissue: TissuePose,
    coupling: Array = INDEPENDENT,
) -> FrameResult:
    """The result with the tool, its place in the image, and the distances from it to the tissue.

    `coupling`, shape (6, 3), is the covariance of the tool's pose with the tissue's place.

    Without sizes of the instrument in the profile there is no clearance. A value that is not finite rejects the frame.
    """
    pose = tool.pose
    if not (np.all(np.isfinite(pose.T_camera_tool)) and np.all(np.isfinite(pose.covariance))):
        return result.rejected(Status.NOT_FINITE)
    offset_m = pose.position_m - tissue.position_m
    covariance = pose.position_covariance + tissue.covariance - coupling[:3] - coupling[:3].T
    if not (np.all(np.isfinite(offset_m)) and np.all(np.isfinite(covariance))):
        return result.rejected(Status.NOT_FINITE)
    planar, spatial = _length(offset_m[:2], covariance[:2, :2]), _length(offset_m, covariance)
    clearance = None
    if frame.arm.body is not None:
        capsules = frame.arm.body.posed(pose, tool.joints, tool.has_plate)
        gap = separation(capsules, tissue.surface)
        std_m = float(np.hypot(clearance_std_m(gap, pose, tissue, coupling), frame.arm.body.surface_std_m))
        std_m = _with_overlap(gap.distance_m, std_m)
        clearance = Distance(gap.distance_m, std_m, as_vector(gap.direction), as_vector(gap.on_instrument_m))
    distances = Distances(planar, spatial, clearance)
    return replace(with_tool(result, frame, tool), status=Status.OK, distances=distances)


def with_tool(result: FrameResult, frame: Frame, tool: ToolEstimate) -> FrameResult:
    """The result with the tool, and its place in the image where it is before the camera."""
    result = replace(result, tool=tool)
    position_m = tool.pose.position_m
    if not position_m[2] > 0.0:
        return result
    return result.with_image(tool_px=as_pixel(frame.left.camera.project(position_m)[0]))


def clearance_std_m(
    gap: Separation, pose: ToolPose, tissue: TissuePose, coupling: Array = INDEPENDENT
) -> float:
    """Standard deviation of a separation from an instrument of known shape; `coupling` as in `measured`.

    The closest points are extremal, so to first order a small motion changes the distance only through
    their own motion along the direction d (envelope theorem): by -d · (δp + δθ x r) for the instrument, with r
    from the tool to its closest point, and by d · δt for the tissue. Errors of the surface model at the closest
    point carry over.
    """
    variance = variance_along(gap.direction, gap.on_instrument_m, pose)
    variance += float(gap.direction @ tissue.covariance @ gap.direction)
    variance -= 2.0 * float(_moves(gap.direction, gap.on_instrument_m, pose) @ coupling @ gap.direction)
    variance += tissue.surface_variance_m2(gap.on_tissue_m, gap.direction)
    return float(np.sqrt(max(variance, 0.0)))


def variance_along(direction: Array, point_m: Array, pose: ToolPose) -> float:
    """Variance in m² along a unit vector, shape (3,), of a point, shape (3,), fixed on a tool of uncertain pose."""
    derivative = _moves(direction, point_m, pose)
    return float(derivative @ pose.covariance @ derivative)


def _moves(direction: Array, point_m: Array, pose: ToolPose) -> Array:
    """How far a pose's (δp, δθ) moves a point of the tool along a direction: derivative, shape (6,)."""
    return np.concatenate([direction, np.cross(point_m - pose.position_m, direction)])


def _with_overlap(distance_m: float, std_m: float) -> float:
    """The deviation of a clearance with what may be wrong where surfaces seem to overlap.

    Bodies do not: soft tissue has given way, which its model does not know, and the clearance is 0; or tool or tissue
    is elsewhere. How much of the overlap that explains is not known, so that all of it is a deviation.
    """
    return float(np.hypot(std_m, max(-distance_m, 0.0)))


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
