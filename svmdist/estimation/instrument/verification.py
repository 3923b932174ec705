"""Verification: a tool's pose is projected into the image, and what the image shows of the instrument may refute it.

An image refutes a pose by what it shows elsewhere, never by what it does not show: tissue, blood, smoke and other
instruments hide an instrument that is where it should be. All differences count in the pose's own standard deviations,
so that an honest wide interval stays, and a narrow one beside the instrument does not.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.estimation.frame import Frame, View
from svmdist.estimation.instrument.distal_marker import OTHER_PART_PLACE
from svmdist.estimation.instrument.model import HINGE, ShaftSections, shaft_sections
from svmdist.estimation.tissue.detection import TissuePose, require_tissue, tissue_plane
from svmdist.geometry import Capsules
from svmdist.profile.robot import CameraError, Instrument, Tissue
from svmdist.results import Z_95, ToolPose
from svmdist.transforms import Array, cross
from svmdist.vision.lines import apparent_radius_px

MAX_DEVIATIONS = 4.0  # two normal errors are beyond it in 1 of 3,000 frames, and priors are rounded
HALF_HIDDEN = 0.2  # deviation of a disc's centroid over its radius: hiding one half moves it by 0.42
MIN_MARKER_AREA = 0.5  # of the projected marker's: less of the colour may be anything
USUAL_SIZE = 0.15  # logarithm of the marker's seen radius over the projected one, which is not looked into
MASK_STD = 1.0 / 640  # of a mask's border, over the image's width: thresholds cut a blurred edge somewhere
SHAPE_STD = 2.5 / 640  # the same of one that a shape was fitted for, in a reduced image
CELLS = 160  # of a section of the projected shaft, across it
MAX_REACH = 6.0  # in half widths: a pose that is less certain across its shaft is refuted by nothing
MIN_SECTIONS = 6  # that show anything: fewer are a short segment, whose sides are as likely something else's
MIN_LENGTH = 2.0  # of the visible shaft, in half widths, for the same reason
MIN_SHARE = 0.3  # of a section that is instrument within reach: less is a speck or a shadow
MIN_INSIDE = 0.8  # of a section that is dark as the shaft: it may have a shadow around it
BAR_WIDTHS = (0.7, 1.4)  # of a shaft elsewhere over the projected one: as far as it may be nearer or farther
MAX_BESIDE = 0.7  # of the sections, beyond which the shaft is beside the instrument


def contradiction(frame: Frame, pose: ToolPose, body: Capsules | None, tissue: TissuePose) -> str:
    """Why images and tissue refute a pose, with the instrument's capsules in the camera frame; empty where they do not.

    A tool beyond the picture is refuted only by what is seen of it in the picture.
    """
    if said := _out_of_place(pose, tissue, require_tissue(frame.arm.profile)):
        return said
    instrument = frame.arm.profile.instrument
    if instrument is None or body is None:
        return ""
    shaft = _ShaftEvidence.of(frame, pose, instrument, body)
    if said := _off_marker(frame, pose, instrument, shaft):
        return said
    if shaft is not None and shaft.is_beside:
        return f"the projected shaft lies beside the instrument in the image: {shaft.inside:.0%} of it is on it"
    return ""


def _out_of_place(pose: ToolPose, seen: TissuePose, tissue: Tissue) -> str:
    """Whether the tool is behind the camera, or behind the plane that the tissue lies on, where no instrument is."""
    if not pose.position_m[2] > 0.0:
        return "the tool is behind the camera"
    plane = tissue_plane(tissue)
    below_m = plane.offset_m - float(plane.normal @ pose.position_m)
    aside_m = float(np.linalg.norm(cross(plane.normal, pose.position_m - seen.position_m)))
    parts_m = tissue.plane_tilt_std_rad * aside_m, seen.surface_std_m, tissue.surface_std_m
    variance_m2 = float(plane.normal @ (seen.covariance + pose.position_covariance) @ plane.normal)
    # Nothing is there, so that an interval that lies behind it as a whole is wrong: a part of a marker seems far away
    # as a whole one, and points of a measured surface have no inside.
    if below_m <= Z_95 * np.sqrt(variance_m2 + np.sum(np.square(parts_m))):
        return ""
    return f"the tool is {1e3 * below_m:.0f} mm behind the plane that the tissue lies on"


def _off_marker(frame: Frame, pose: ToolPose, instrument: Instrument, shaft: _ShaftEvidence | None) -> str:
    """Whether the coloured distal marker is seen where the pose does not allow it, or of another size."""
    view, camera, error = frame.left, frame.left.camera, frame.arm.profile.camera_error
    marker_m = pose.position_m + pose.T_camera_tool[:3, :3] @ np.array(instrument.knuckle_position_m)
    if view.masks.seen is not None or not marker_m[2] > instrument.knuckle_radius_m or (region := view.region) is None:
        return ""
    radius_px = float(apparent_radius_px(marker_m, instrument.knuckle_radius_m, camera))

    def deviations(pixel: Array, place_std_m: float) -> float:
        """By how many standard deviations the marker is off the ray of a pixel, (2,), at whatever depth."""
        std_px = np.hypot(HALF_HIDDEN * radius_px, _calibration_std_px(pixel, camera, error))
        variance_m2 = (std_px * marker_m[2] / camera.K[0, 0]) ** 2 + place_std_m**2
        information = np.linalg.inv(pose.position_covariance + variance_m2 * np.eye(3))
        ray = camera.rays(pixel)[0]
        along = max(float(ray @ information @ marker_m), 0.0) ** 2 / float(ray @ information @ ray)
        return float(np.sqrt(max(float(marker_m @ information @ marker_m) - along, 0.0)))

    is_off = deviations(region.centroid_px, instrument.knuckle_position_std_m) > MAX_DEVIATIONS
    is_odd = abs(0.5 * np.log(region.area_px / (np.pi * radius_px**2))) > USUAL_SIZE
    marker = view.distal_marker if is_off or is_odd else None
    if marker is None:
        return ""
    size, log_std = 1.0, np.inf
    if marker.radius_px is not None:
        size, depth_std = marker.radius_px / radius_px, float(np.sqrt(pose.covariance[2, 2]) / pose.position_m[2])
        parts = marker.radius_std_px / marker.radius_px, instrument.knuckle_radius_std_fraction
        log_std = float(np.linalg.norm([*parts, error.focal_std_fraction, depth_std]))
    is_odd = abs(np.log(size)) > MAX_DEVIATIONS * log_std
    # A shaft as wide as projected says that the coloured part is another one, on a wrist that is no thicker.
    is_on_wrist = size * instrument.knuckle_radius_m <= instrument.wrist_radius_m
    is_other = is_odd and is_on_wrist and shaft is not None and abs(shaft.narrower) < MAX_DEVIATIONS
    if is_off:
        pixel, place_std_m = marker.centre_px, instrument.knuckle_position_std_m
        if marker.disc is not None:
            pixel = marker.disc.centre_px
        elif region.area_px < MIN_MARKER_AREA * np.pi * radius_px**2:
            return ""
        if is_other or marker.disc is None:  # another part, or mostly hidden: somewhere about the tool
            place_std_m = OTHER_PART_PLACE * instrument.knuckle_radius_m
        if (off := deviations(pixel, place_std_m)) > MAX_DEVIATIONS:
            beside = f"{np.linalg.norm(camera.project(marker_m)[0] - pixel):.0f} px beside its projection"
            return f"the distal marker is seen {beside}, {off:.1f} standard deviations"
    # Nothing makes a sphere look larger; what covers a part of it makes it smaller, and leaves the shaft as wide.
    if is_odd and not is_other and (size > 1.0 or (shaft is not None and shaft.narrower > MAX_DEVIATIONS)):
        return f"the distal marker looks {size:.2f} times as large as its projection"
    return ""


@dataclass(frozen=True, slots=True)
class _ShaftEvidence:
    """What the image shows where the shaft is projected: the share that is instrument, and whether that refutes."""

    inside: float
    is_beside: bool  # the shaft is seen, and neither of its sides is where the pose has it
    narrower: float  # by how many deviations it is less wide than projected; NaN where that is not known

    @staticmethod
    def of(frame: Frame, pose: ToolPose, instrument: Instrument, body: Capsules) -> _ShaftEvidence | None:
        """The evidence at sections of the shaft; None where the pose allows nearly anything, or nothing is known."""
        view, camera, masks = frame.left, frame.left.camera, frame.left.masks
        seen = shaft_sections(camera, body)
        if seen is None or not seen.length_px >= MIN_LENGTH * np.max(seen.half_px):
            return None
        mask_px = (MASK_STD if masks.seen is None else SHAPE_STD) * camera.width_px
        own_px = np.hypot(mask_px, instrument.shaft_radius_std_fraction * seen.half_px)
        all_px = np.hypot(own_px, _calibration_std_px(seen.middles_px, camera, frame.arm.profile.camera_error))
        of_pose_px = _across_std_px(seen, body.start_m[HINGE], pose, camera)
        allowed = MAX_DEVIATIONS * np.hypot(all_px, of_pose_px) / seen.half_px
        if masks.shaft is None or np.max(allowed) > MAX_REACH:
            return None
        # Across each section, in half widths: what is the instrument's, and what no other instrument's.
        reach = max(1.5 + float(np.max(allowed)), MAX_REACH)
        offset = np.linspace(-reach, reach, CELLS)
        at_px = seen.middles_px[:, None] + (offset * seen.half_px[:, None])[..., None] * seen.across[:, None]
        own, known = _sampled(view, at_px)
        width = max(1, round(2.0 / (offset[1] - offset[0])))
        own_count, known_count = (sliding_window_view(values, width, axis=1).sum(-1) for values in (own, known))
        share = own_count / np.maximum(known_count, MIN_SHARE * width)
        away = np.abs(offset[: CELLS - width + 1] + 1.0)
        here = int(np.argmin(away))
        is_near = np.max(np.where(away <= allowed[:, None], share, 0.0), axis=1) > MIN_SHARE
        begin, end, has_bar = _sides(own, known, offset)
        is_off = np.fmin(np.abs(begin + 1.0), np.abs(end - 1.0)) > allowed
        if masks.seen is None:
            is_off &= share[:, here] < MIN_INSIDE
        is_seen = is_near | has_bar
        if np.count_nonzero(is_seen) < MIN_SECTIONS:
            return None
        is_beside = np.where(is_near, is_off, has_bar)
        half = 0.5 * (end - begin)[is_near & np.isfinite(end - begin) & (end > begin)]
        depth_std = float(np.sqrt(pose.covariance[2, 2]) / pose.position_m[2])
        width_std = np.hypot(float(np.max(own_px / seen.half_px)), depth_std)
        narrower = float(-np.log(np.median(half)) / width_std) if len(half) >= MIN_SECTIONS else np.nan
        inside = float(own_count[:, here].sum() / max(known_count[:, here].sum(), 1.0))
        return _ShaftEvidence(inside, bool(np.mean(is_beside[is_seen]) > MAX_BESIDE), narrower)


def _calibration_std_px(pixels: Array, camera: Camera, error: CameraError) -> Array:
    """How far focal length and principal point may move pixels, shape (..., 2), along any direction."""
    from_centre_px = np.linalg.norm(pixels - camera.K[:2, 2], axis=-1)
    return np.asarray(np.hypot(error.centre_std_px, error.focal_std_fraction * from_centre_px))


def _across_std_px(seen: ShaftSections, hinge_m: Array, pose: ToolPose, camera: Camera) -> Array:
    """The pose's standard deviation across each section, shape (n,), in px."""
    # The wrist's bend moves tool and hinge against each other, and the shaft's direction is surer than the tool's.
    _, by_point = camera.project_with_derivative(seen.axis_m)
    slope = across = (seen.across[:, None] @ by_point)[:, 0]
    if pose.hinge is None:
        slope = np.concatenate([across, cross(hinge_m - pose.position_m, across)], axis=1)
    covariance = pose.covariance if pose.hinge is None else pose.hinge.covariance
    of_hinge = np.einsum("ni,ij,nj->n", slope, covariance, slope)
    of_turn = np.linalg.norm(across, axis=1) * np.linalg.norm(seen.axis_m - hinge_m, axis=1) * pose.shaft_std_rad
    return np.asarray(np.sqrt(np.maximum(of_hinge, 0.0) + of_turn**2))


def _sampled(view: View, at_px: Array) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """What of pixels, shape (n, k, 2), is the instrument, and what is in the picture and no other instrument's."""
    masks, others = view.masks, view.others
    size = np.array([view.camera.width_px, view.camera.height_px])
    place = np.rint(at_px).astype(np.int64)
    known = ((place >= 0) & (place < size)).all(-1)
    x, y = np.moveaxis(np.clip(place, 0, size - 1), -1, 0)
    if others is not None:
        known &= others[y, x] == 0
    if masks.picture is not None:
        known &= masks.picture[y, x] > 0
    own = masks.instrument[y, x] > 0
    if masks.shaft is not None:
        own |= masks.shaft[y, x] > 0
    return np.asarray(own & known), np.asarray(known)


def _sides(own: NDArray[np.bool_], known: NDArray[np.bool_], offset: Array) -> tuple[Array, Array, NDArray[np.bool_]]:
    """Where the instrument begins nearest to -1 and ends nearest to 1, (n,), NaN without; if anywhere a shaft wide."""
    at = 0.5 * (offset[1:] + offset[:-1])
    is_border = (own[:, 1:] != own[:, :-1]) & known[:, 1:] & known[:, :-1]
    begins, ends = (np.where(is_border & own[:, side], at, np.nan) for side in (np.s_[1:], np.s_[:-1]))
    next_end = np.fmin.accumulate(ends[:, ::-1], axis=1)[:, ::-1]
    width = 0.5 * (next_end - begins)
    has_bar = ((width > BAR_WIDTHS[0]) & (width < BAR_WIDTHS[1])).any(1)

    def nearest(borders: Array, place: float) -> Array:
        at = np.argmin(np.nan_to_num(np.abs(borders - place), nan=np.inf), axis=1)
        return np.asarray(borders[np.arange(len(borders)), at])

    return nearest(begins, -1.0), nearest(ends, 1.0), np.asarray(has_bar)
