"""Three distances and their standard deviations, from the tool's pose and the tissue in 3D.

Errors are propagated to first order (ISO/IEC Guide 98-3, sec. 5.1). Tool and tissue are taken as
independent: they are measured from different pixels.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.instrument.model import InstrumentModel
from svmdist.estimation.instrument.pose import ToolPose
from svmdist.estimation.tissue.fix import TissuePose
from svmdist.geometry.separation import Separation, separation
from svmdist.samples import Estimate, JointSample, Status, ToolState, Vector
from svmdist.transforms import Array


def measure(
    row: Estimate,
    pose: ToolPose,
    tissue: TissuePose,
    model: InstrumentModel | None = None,
    joints: JointSample | None = None,
    camera: Camera | None = None,
    has_plate: bool = False,
) -> Estimate:
    """Fill the row with what the pose and the tissue tell; without a model there is no clearance.

    `joints` bend the model's wrist; without them it is straight along the shaft. With a `camera` the row tells
    where the tool is in the image. `has_plate` says that the profile's tag, and so its plate, is on the instrument.
    """
    if not (np.all(np.isfinite(pose.T_camera_tool)) and np.all(np.isfinite(pose.covariance))):
        return replace(row, status=Status.NOT_FINITE)
    offset_m = pose.position_m - tissue.position_m
    covariance = pose.position_covariance + tissue.covariance
    planar_m, planar_std_m = _length(offset_m[:2], covariance[:2, :2])
    spatial_m, spatial_std_m = _length(offset_m, covariance)
    if not np.all(np.isfinite([planar_m, spatial_m, planar_std_m, spatial_std_m])):
        return replace(row, status=Status.NOT_FINITE)
    row = replace(
        row,
        status=Status.OK,
        distance_m=planar_m,
        spatial_m=spatial_m,
        distance_std_m=planar_std_m,
        spatial_std_m=spatial_std_m,
        tool_position_m=as_vector(pose.position_m),
        tool_axis=as_vector(pose.axis),
        tool_state=ToolState(pose.T_camera_tool, pose.covariance, pose.axis, joints, has_plate),
    )
    if camera is not None:
        row = with_tool(row, pose, camera)
    if model is None:
        return row
    gap = separation(model.posed(pose, joints, has_plate), tissue.surface)
    return replace(
        row,
        clearance_m=gap.distance_m,
        clearance_std_m=clearance_std_m(gap, pose, tissue),
        clearance_direction=as_vector(gap.direction),
    )


def with_tool(row: Estimate, pose: ToolPose, camera: Camera) -> Estimate:
    """The row with where the tool is in the image; as it is for a tool that is not before the camera."""
    if not pose.position_m[2] > 0.0:
        return row
    x_px, y_px = (float(value) for value in camera.project(pose.position_m)[0])
    return replace(row, tool_x_px=x_px, tool_y_px=y_px)


def clearance_std_m(gap: Separation, pose: ToolPose, tissue: TissuePose) -> float:
    """Standard deviation of a separation.

    The closest points are extremal, so to first order a small motion changes the distance only through
    their own motion along the direction d (envelope theorem): by -d · (δp + δθ x r) for the instrument, with r
    from the tool to its closest point, by d · δt for the tissue, and by what its surface stands off there.
    """
    arm_m = gap.on_instrument_m - pose.position_m
    derivative = -np.concatenate([gap.direction, np.cross(arm_m, gap.direction)])
    variance = derivative @ pose.covariance @ derivative
    variance += gap.direction @ tissue.covariance @ gap.direction
    variance += tissue.surface_variance_m2(gap.on_tissue_m, gap.direction)
    return float(np.sqrt(max(float(variance), 0.0)))


def as_vector(values: Array) -> Vector:
    """Three floats from an array of shape (3,)."""
    x, y, z = (float(value) for value in values)
    return x, y, z


def _length(offset_m: Array, covariance: Array) -> tuple[float, float]:
    """Length of an offset and its standard deviation; at zero length every direction counts alike."""
    length_m = float(np.linalg.norm(offset_m))
    if length_m > 0.0:
        along = offset_m / length_m
        return length_m, float(np.sqrt(max(float(along @ covariance @ along), 0.0)))
    return 0.0, float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))
