"""What both views have in common without a marker: which shaft is which, and how deep what a wrist shows lies."""

from __future__ import annotations

import cv2
import numpy as np

from svmdist.camera import Camera
from svmdist.profile.robot import Instrument
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.instruments.find_instruments import SeenInstrument
from svmdist.vision.lines import axis_of_cylinder, line_between, tangent_normal, tangent_plane

ENDS_STD_WIDTHS = 0.5  # of the shaft's end along it, over its width: one view may show the dark part's
WIDTH_STD = 0.08  # logarithm of the width in one view: shade and blur take a pixel of it
LINE_STD_PX = 1.5  # of a middle line, in pixels of the working image


def sides_beside(
    seen: SeenInstrument, cameras: tuple[Camera, Camera], T_other_own: Array, radius_m: float
) -> Array | None:
    """Where one camera has the sides of a shaft of a radius that another one shows, (2, 2, 2) in px, or None."""
    K, ends = cameras[0].K, cameras[0].rays(seen.sides)[:, :2].reshape(2, 2, 2)
    inside, scale = ends.mean((0, 1)), float(K[0, 0]) ** -2
    lines = [line_between(*one) for one in zip(ends, scale * seen.side_covariance, strict=True)]
    axis = axis_of_cylinder(tangent_plane(lines[0], inside), tangent_plane(lines[1], inside), radius_m)
    if axis is None:
        return None
    rays = np.column_stack([ends.mean(0), np.ones(2)])
    # Where each ray passes the axis: the middle of what the other directions leave of it.
    across = np.cross(axis.direction, np.cross(rays, axis.direction))
    own_m = rays * ((across @ axis.point_m) / np.sum(across * rays, 1))[:, None]
    points_m = own_m @ T_other_own[:3, :3].T + T_other_own[:3, 3]
    along = (points_m[1] - points_m[0]) / max(float(np.linalg.norm(points_m[1] - points_m[0])), 1e-9)
    normals = [tangent_normal(points_m[1], along, radius_m, side)[0] for side in (-1, 1)]
    if not (min(own_m[:, 2].min(), points_m[:, 2].min()) > radius_m and np.isfinite(normals).all()):
        return None
    return np.array([cameras[1].project(points_m - radius_m * normal) for normal in normals])


def disagreement(
    left: SeenInstrument,
    right: SeenInstrument,
    cameras: tuple[Camera, Camera],
    T_right_left: Array,
    instrument: Instrument,
) -> float:
    """Squared deviations of the right view's shaft from where the left one's width puts it; infinite behind a camera.

    The depth by the radius says where along their epipolar lines both ends of the left middle line are to be seen.
    """
    radius_m, fraction = instrument.shaft_radius_m, np.hypot(instrument.shaft_radius_std_fraction, WIDTH_STD)
    depths = (radius_m, radius_m * (1.0 + fraction))
    near, far = (sides_beside(left, cameras, T_right_left, one) for one in depths)
    if near is None or far is None:
        return np.inf
    entry_px, end_px = right.sides.mean(0)
    moved_px, off_px, along = (far - near).mean(0), near.mean(0) - end_px, end_px - entry_px
    along /= max(float(np.linalg.norm(along)), 1e-9)
    normal = np.array([-along[1], along[0]])
    across = (off_px @ normal) / np.hypot(moved_px @ normal, LINE_STD_PX * (left.pixel_px + right.pixel_px))
    ends_px = [min(one.end_std_px, 1e6) for one in (left, right)]
    of_end = (
        off_px[1] @ along / np.linalg.norm([moved_px[1] @ along, ENDS_STD_WIDTHS * right.width_px, *ends_px])
    )
    of_width = np.log(right.width_px / np.linalg.norm(near[0, 1] - near[1, 1])) / (np.sqrt(2.0) * WIDTH_STD)
    return float(across @ across + of_end**2 + of_width**2)


ROWS_PX = (-2.0, -1.0, 0.0, 1.0, 2.0)  # by which rows may differ
LEAST_LIKENESS, LEAST_LEAD = 0.6, 0.05  # correlation of a match, and how much better than any elsewhere
SAME_PX = 3.0  # what is so near to the best match is the same


def matched_place(views: tuple[Image, Image], at_px: Array, half_px: float, places_px: Array) -> int | None:
    """Which of the right view's places, (n, 2), looks like a pixel of the left one, (2,); None where several do.

    `views` are grey, (h, w), of cameras turned alike, and what is compared reaches `half_px` to every side.
    """
    half = max(3, round(half_px))
    patch = cv2.getRectSubPix(views[0], (2 * half + 1,) * 2, (float(at_px[0]), float(at_px[1])))
    ours = patch.astype(np.float32) - float(patch.mean())
    offset = np.arange(-half, half + 1)
    likeness = np.full(len(places_px), -1.0)
    for row_px in ROWS_PX:
        grid = places_px[:, None, None] + np.stack(np.meshgrid(offset, offset + row_px), -1)
        at = grid.reshape(len(places_px), -1, 2).astype(np.float32)
        pixels = cv2.remap(views[1], at[..., 0], at[..., 1], cv2.INTER_LINEAR, None, cv2.BORDER_REPLICATE)
        seen = np.asarray(pixels, np.float32)
        theirs = seen - seen.mean(1, keepdims=True)
        scale = np.sqrt(float((ours**2).sum()) * (theirs**2).sum(1)) + 1.0
        likeness = np.maximum(likeness, (theirs @ ours.ravel()) / scale)
    best = int(np.argmax(likeness))
    is_away = np.linalg.norm(places_px - places_px[best], axis=1) > SAME_PX
    lead = likeness[best] - np.max(likeness[is_away], initial=-1.0)
    return best if likeness[best] > LEAST_LIKENESS and lead > LEAST_LEAD else None
