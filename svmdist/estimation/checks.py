"""Checks: what a log shows more than once, by two ways each, with what is uncertain of both."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import combinations
from typing import NamedTuple

import cv2
import numpy as np

from svmdist.camera import Camera
from svmdist.estimation import comparison
from svmdist.estimation.comparison import MAX_DEVIATIONS, Difference
from svmdist.estimation.frame import Arm, Frame, Scene
from svmdist.estimation.instrument.distal_marker import marker_in
from svmdist.estimation.instrument.model import joints_of, wrist_in_tool
from svmdist.estimation.tissue.detection import TissuePose, height_biases
from svmdist.estimation.tissue.surface import depth_biases
from svmdist.geometry import Mesh
from svmdist.geometry.distance import signed_distances
from svmdist.kinematics import rows_behind_insertion
from svmdist.least_squares import scale_of
from svmdist.profile import Profile
from svmdist.profile.robot import CameraError, Tissue
from svmdist.results import Failure, ToolPose
from svmdist.transforms import Array
from svmdist.vision.stereo import RectifiedPair, RowAlignment, corresponding_points

MIN_MATCHES, MIN_FITTED = 8, 60  # points of both views that determine a median, and how rows change over the picture
MOST_POINTS = 0.75  # of those that show how rows bend: a few are at the border, or false
MAX_ROWS_PX = 30.0  # by which rows of both views may differ to be compared at all
ROWS_STD_PX = 0.4  # at the picture's border: pairs that are called rectified are so within half a pixel
FIELD_STD = 0.1  # logarithm: the bounds of a field of view are round numbers
MARKER_STD = 0.42  # of a disc's visible middle, over its radius: one half may be hidden
SIDES_STD_RAD = 0.01  # of the plane between the shaft's sides: one of them may be a shadow's
OUTLINE_STD = 0.06  # logarithm of the size of a tissue's outline: what hides it is completed
JAW_STD_M = 1e-3  # of a jaw's length in the image: its tip is round, the mask's edge a pixel or two off
JAW_STEP_M, JAW_REACH = 2.5e-4, 3.0  # along a jaw, and over its length in the profile
MAX_TURN_STD_RAD = 0.3  # beyond, a pose does not say where jaws point to
MOTION_STD_M = 2e-3  # of a nominal motion between two frames: backlash, and stamps of joints
MOTION_SHARE = 0.05  # of the motion itself: offsets of joints
STEADY = 0.5  # of the deviation of a place in the image, what changes between frames
POINTS = 60  # of the surface by stereo that are compared with a profile's mesh


def of_profile(arm: Arm) -> Iterator[Difference]:
    """Sizes of the profile against those of a field; no frame is needed."""
    instrument, field, chain = arm.profile.instrument, arm.profile.field, arm.chain
    if instrument is not None:
        yield _bounded("diameter of the instrument", 2.0 * instrument.shaft_radius_m, field.diameter_m)
    if chain is not None:
        # Behind the roll, whose own length may be all of the shaft's.
        wrist = [chain.rows[index] for index in rows_behind_insertion(chain)[1:]]
        if lengths := [np.hypot(row.a_m, row.d_m) for row in wrist]:
            yield _bounded("length of a wrist's link", float(max(lengths)), (0.0, field.wrist_link_m))


def of_calibrations(changes: Iterable[tuple[Camera, Camera]], error: CameraError) -> Iterator[Difference]:
    """The focal length of a camera that a log publishes anew, against the one before; images take what holds then."""
    for before, after in changes:
        is_same_size = (before.width_px, before.height_px) == (after.width_px, after.height_px)
        off = float(np.log(after.K[0, 0] / before.K[0, 0])) if is_same_size else np.inf
        yield Difference("focal length", (comparison.CAMERAS, comparison.LATER), off, error.focal_std_fraction, "")


def _bounded(what: str, value: float, bounds: tuple[float, float], source: str = comparison.PROFILE) -> Difference:
    """By how much a length in m is outside of bounds, as a logarithm."""
    nearest = min(max(value, bounds[0]), bounds[1])
    off = 0.0 if value == nearest else float(np.log(value / nearest)) if value > 0.0 else -np.inf
    return Difference(what, (source, comparison.FIELD), off, FIELD_STD, "")


def of_frame(frame: Frame, sources: Mapping[str, ToolPose]) -> Iterator[Difference]:
    """What one frame shows of one instrument more than once; `sources` as by `places_of`."""
    field = frame.arm.profile.field
    for source in (comparison.KINEMATICS, comparison.TAG):
        if (pose := sources.get(source)) is not None:
            yield _bounded("distance of the tool", float(pose.position_m[2]), (0.0, field.depth_m), source)
            if pose.position_m[2] > 0.0:
                yield from _against_image(frame, source, pose)
    yield from _directions(frame, sources)
    for (one, pose), (other, reference) in combinations(sources.items(), 2):
        ray = reference.position_m / np.linalg.norm(reference.position_m)
        variance = ray @ (pose.position_covariance + reference.position_covariance) @ ray
        off_m = float(ray @ (pose.position_m - reference.position_m))
        yield Difference("depth of the tool", (one, other), off_m, float(np.sqrt(variance)), "m")
    if (pose := sources.get(comparison.TAG) or sources.get(comparison.SHAFT)) is not None:
        yield from _jaws(frame, pose)


def of_motion(places_m: Sequence[Mapping[str, ToolPose]]) -> Iterator[Difference]:
    """How the tool moved between two frames, nominally and by the images: no shift of the base changes that."""
    # Of each frame the usual one of its motions to all others: a mistaken frame spoils each motion that it is in.
    for source in (comparison.SHAFT, comparison.DISPARITY, comparison.TAG):
        both = [one for one in places_m if source in one and comparison.KINEMATICS in one]
        for one in both if len(both) > 1 else ():
            motions = [_moved(source, one, other) for other in both if other is not one]
            yield sorted(motions, key=lambda motion: motion.deviations)[(len(motions) - 1) // 2]


def _moved(source: str, one: Mapping[str, ToolPose], other: Mapping[str, ToolPose]) -> Difference:
    seen, nominal = (one[name].position_m - other[name].position_m for name in (source, comparison.KINEMATICS))
    off_m = float(np.linalg.norm(nominal - seen))
    along = (nominal - seen) / max(off_m, 1e-9)
    covariance = one[source].position_covariance + other[source].position_covariance
    turned_m = (MOTION_SHARE + one[comparison.KINEMATICS].shaft_std_rad) * float(np.linalg.norm(nominal))
    variance = float(along @ covariance @ along)
    std_m = float(np.linalg.norm([STEADY * np.sqrt(variance), MOTION_STD_M, turned_m]))
    return Difference(comparison.MOTION, (comparison.KINEMATICS, source), off_m, std_m, "m")


def _jaws(frame: Frame, pose: ToolPose) -> Iterator[Difference]:
    """The jaws' length: along a jaw the tissue's mask begins where it ends, before the tissue's border."""
    arm, view, tissue = frame.arm, frame.left, frame.scene.tissue
    instrument, q = arm.profile.instrument, joints_of(arm.chain, frame.joints)
    is_coloured = view.masks.seen is None and view.distal_marker is not None
    is_posed = pose.position_m[2] > 0.0 and pose.shaft_std_rad < MAX_TURN_STD_RAD
    if instrument is None or q is None or tissue is None or not (is_coloured and is_posed):
        return
    mask = cv2.blur((view.masks.tissue > 0).astype(np.float32), (3, 3))
    hull = np.zeros(mask.shape, np.uint8)
    cv2.fillConvexPoly(hull, tissue.region.hull, 1)
    inside = cv2.erode(hull, np.ones((5, 5), np.uint8))
    along_m = np.arange(2.0 * instrument.knuckle_radius_m, JAW_REACH * instrument.jaw_length_m, JAW_STEP_M)
    found = []
    for along, _, _ in wrist_in_tool(arm.required_chain, q).jaws:
        points_m = pose.position_m + np.outer(along_m, pose.T_camera_tool[:3, :3] @ along)
        at = np.rint(view.camera.project(points_m)).astype(np.int64)
        kept = np.logical_and.accumulate(((at >= 0) & (at < mask.shape[::-1])).all(1))
        at = at[kept]
        is_tissue = mask[at[:, 1], at[:, 0]] > 0.7
        steel = np.flatnonzero(~is_tissue & (along_m[: len(at)] < instrument.jaw_length_m))
        begin = int(steel[-1]) if len(steel) else 0  # what is red before it is blood on the jaw
        end = begin + int(np.argmax(is_tissue[begin:])) if is_tissue[begin:].any() else -1
        if end > 0 and inside[at[end, 1], at[end, 0]]:
            found.append(float(along_m[end]))
    if found:
        off_m = max(found) - instrument.jaw_radius_m - instrument.jaw_length_m
        depth_std = float(np.sqrt(pose.covariance[2, 2])) / float(pose.position_m[2])
        std_m = float(np.hypot(JAW_STD_M, depth_std * max(found)))
        yield Difference("length of the jaws", (comparison.JAWS, "the image"), off_m, std_m, "m")


def _against_image(frame: Frame, source: str, pose: ToolPose) -> Iterator[Difference]:
    """A tool's pose against where the image shows its marker."""
    view, arm = frame.left, frame.arm
    seen = marker_in(view, arm, None)
    if seen is None:
        return
    place_m, instrument = pose.position_m, arm.profile.instrument
    if instrument is not None:
        place_m = place_m + pose.T_camera_tool[:3, :3] @ np.array(instrument.knuckle_position_m)
    depth_m, ray = float(place_m[2]), view.camera.rays(seen.pixel)[0]
    off_m = (place_m - depth_m * ray)[:2]
    along = np.column_stack([np.eye(2), -ray[:2]])  # what depth moves, the ray moves with
    std_px = float(np.hypot(seen.std_px, MARKER_STD * seen.radius_px))
    own_m = float(np.hypot(depth_m / float(view.camera.K[0, 0]) * std_px, seen.error.place_std_m))
    covariance = along @ pose.position_covariance @ along.T + own_m**2 * np.eye(2)
    square = float(off_m @ np.linalg.solve(covariance, off_m))
    length_m = float(np.linalg.norm(off_m))
    # Of two dimensions: as many deviations as a normal number of that probability has, to first order.
    deviations = np.sqrt(max(square - 1.0, 0.0))
    std_m = length_m / deviations if deviations > 0.0 else np.inf
    yield Difference("place in the image", (source, "the marker"), length_m, std_m, "m")


def _directions(frame: Frame, sources: Mapping[str, ToolPose]) -> Iterator[Difference]:
    """Directions of the shaft against the plane between its sides in the image."""
    sides = {contour.side: contour for contour in frame.left.shaft.contours}
    if len(sides) < 2:
        return
    middle = sides[1].normal - sides[-1].normal
    middle /= np.linalg.norm(middle)
    found = []
    for source in (comparison.KINEMATICS, comparison.TAG):
        if (pose := sources.get(source)) is not None and pose.position_m[2] > 0.0:
            off_rad = float(np.arcsin(np.clip(middle @ pose.axis, -1.0, 1.0)))
            std_rad = float(np.hypot(pose.shaft_std_rad, SIDES_STD_RAD))
            found.append(Difference("direction of the shaft", (source, "its sides"), off_rad, std_rad, "rad"))
    if len(found) == 2:  # where both agree, the sides are not those of the shaft: a mask has a strip of it
        one, other = found
        apart = abs(one.value - other.value) / float(np.hypot(one.std, other.std))
        if apart < MAX_DEVIATIONS < min(one.deviations, other.deviations):
            return
    yield from found


def of_scene(scene: Scene) -> Iterator[Difference]:
    """The baseline's sign; a mesh against the tissue's outline; the surface by both views against the profile's."""
    right = scene.observation.right
    if right is not None and right.T_left_right[0, 3] <= 0.0:
        yield Difference("baseline", (comparison.VIEWS, comparison.CAMERAS), -np.inf, 1.0, "m")
    tissue, prior = scene.tissue, scene.profile.tissue
    if tissue is None or tissue.pose is None or prior is None:
        return
    if isinstance(tissue.pose.surface, Mesh) and tissue.pose.dome is None:
        corners_m = tissue.pose.surface.vertices_m
        if np.all(corners_m[:, 2] > 0.0):
            curves_px = scene.observation.camera.project(corners_m), tissue.outline.curve_px
            areas = [cv2.contourArea(cv2.convexHull(px.astype(np.float32))) for px in curves_px]
            off = 0.5 * float(np.log(max(areas[0], 1.0) / max(areas[1], 1.0)))
            std = float(np.hypot(OUTLINE_STD, prior.plane_distance_std_m / prior.plane_distance_m))
            yield Difference("size of the tissue", (comparison.TISSUE, "its outline"), off, std, "")
    yield from _of_surface(scene, tissue.pose, prior)


def _of_surface(scene: Scene, pose: TissuePose, prior: Tissue) -> Iterator[Difference]:
    """The surface's height and tilt over the profile's, and what else differs."""
    surface, right, profile = scene.stereo_surface, scene.observation.right, scene.profile
    if surface is None or right is None:
        return
    points_m, normal, of_shape = surface.points_m, np.array(prior.plane_normal), np.zeros((0, 0))
    if pose.dome is not None:
        above = pose.dome.above(points_m)
        points_m, over_m, of_shape = points_m[above.inner], above.over_m, pose.dome.covariance
    elif isinstance(pose.surface, Mesh):
        points_m = points_m[:: max(1, len(points_m) // POINTS)]
        over_m = signed_distances(points_m, pose.surface)[1]
    else:
        over_m = points_m @ normal + prior.plane_distance_m
    if len(points_m) < POINTS:
        return
    by_shape = np.zeros((len(points_m), 0)) if pose.dome is None else pose.dome.derivative(above.flat_m)
    middle_m = np.mean(points_m, 0)
    across_m = (points_m - middle_m) @ np.linalg.svd(normal[None])[2][1:].T
    B = np.column_stack([across_m, np.ones(len(over_m))])
    P = np.linalg.pinv(B)
    fit, moved, own_m = P @ over_m, P @ by_shape, float(np.hypot(surface.std_m, pose.surface_std_m))
    of_fit = np.sqrt(np.diag(moved @ of_shape @ moved.T))  # what is uncertain of a dome's shape
    of_cameras = depth_biases(middle_m, scene.observation.camera, right, profile.camera_error)
    biases_m = [np.linalg.norm(one.jacobian) for one in (*height_biases(prior, middle_m), *of_cameras)]
    std_m = float(np.linalg.norm([*biases_m, of_fit[2], own_m]))
    by_both = comparison.TISSUE, comparison.DISPARITY
    yield Difference(comparison.HEIGHT, by_both, float(fit[2]), std_m, "m")
    reach_m = float(np.sqrt(np.linalg.eigvalsh(np.cov(across_m.T))[0]))  # of its shorter side
    turned_rad = profile.camera_error.right_rotation_std_rad
    std_rad = float(np.linalg.norm([prior.plane_tilt_std_rad, own_m / reach_m, turned_rad, *of_fit[:2]]))
    yield Difference(comparison.TILT, by_both, float(np.arctan(np.linalg.norm(fit[:2]))), std_rad, "rad")
    rest = by_shape - B @ moved
    shape_m = float(np.sqrt(own_m**2 + np.mean(np.einsum("ni,ij,nj->n", rest, of_shape, rest))))
    yield Difference(comparison.SHAPE, by_both, float(np.std(over_m - B @ fit)), shape_m, "m")


class Matches(NamedTuple):
    """Points that both views of a pair show, where rows correspond: by how much their columns and rows differ."""

    pair: RectifiedPair
    disparity_px: Array  # shape (n,)
    rows: Array  # shape (n, 5): 1, x, y, xy on z = 1, and by how much their rows differ in px


def matched(scene: Scene) -> Matches | None:
    """Points that look alike in both views, wherever in a row; None without a pair of cameras."""
    pair = scene.stereo_pair
    if isinstance(pair, Failure) or scene.right is None:
        return None
    left_px, right_px = corresponding_points((scene.left.grey, scene.right.grey), pair, MAX_ROWS_PX)
    disparity_px, off_px = left_px[:, 0] - right_px[:, 0] - pair.offset_px, right_px[:, 1] - left_px[:, 1]
    x, y = ((left_px - pair.K[:2, 2]) / pair.K[0, 0]).T
    return Matches(pair, disparity_px, np.column_stack([np.ones(len(x)), x, y, x * y, off_px]))


def of_views(profile: Profile, found: Sequence[Matches]) -> Iterator[Difference]:
    """Both views against each other: sign and size of their disparities, in each pair, and how rows of all differ."""
    field, enough = profile.field, [one for one in found if len(one.rows) >= MIN_MATCHES]
    for pair, disparity_px, _ in enough:
        middle_px = float(np.median(disparity_px))
        # Of a median; points of one texture err alike.
        std_px = 1.25 * scale_of(disparity_px - middle_px) / np.sqrt(0.5 * len(disparity_px)) + 0.5
        far_px, near_px = pair.disparity_at(field.depth_m), pair.disparity_at(field.least_depth_m)
        off_px = min(middle_px - far_px, 0.0) + max(middle_px - near_px, 0.0)
        yield Difference("disparities", (comparison.VIEWS, comparison.CAMERAS), off_px, float(std_px), "px")
    if sum(len(one.rows) for one in enough) >= MIN_FITTED:
        yield _bent_rows(profile, [one.rows for one in enough], found[0].pair)


def row_alignment(found: Sequence[Matches]) -> RowAlignment:
    """How the rows of both views differ, as points of pairs have it."""
    fit, _ = _robust_fit(np.concatenate([one.rows for one in found]))
    along_x, along_y = (fit[1:3] / found[0].pair.K[0, 0]).tolist()
    return RowAlignment(float(fit[0]), (along_x, along_y))


def _bent_rows(profile: Profile, rows: Sequence[Array], pair: RectifiedPair) -> Difference:
    """How much rows bend at most points by x, y and xy: of a turn about the view, another focal length, a lens."""
    fit, covariance = _robust_fit(np.concatenate(rows))
    # Cameras bend rows of all pairs alike: what one says that others do not is false matches (jackknife, Tukey 1958).
    if len(rows) > 1:
        without = [_robust_fit(np.concatenate([*rows[:at], *rows[at + 1 :]]))[0] for at in range(len(rows))]
        covariance += (len(rows) - 1) * np.cov(np.transpose(without), bias=True)
    error, focal_px, B = profile.camera_error, pair.K[0, 0], np.concatenate(rows)[:, 1:4]
    turn_px = focal_px * error.right_rotation_std_rad
    covariance = covariance[1:, 1:] + np.diag([turn_px, focal_px * error.focal_std_fraction, turn_px]) ** 2
    B = B - np.median(B, axis=0)
    bends_px = B @ fit[1:]
    at = int(np.argsort(np.abs(bends_px))[int(MOST_POINTS * len(B))])
    std_px = float(np.hypot(np.sqrt(B[at] @ covariance @ B[at]), ROWS_STD_PX))
    return Difference(comparison.ROWS, (comparison.VIEWS, comparison.CAMERAS), float(bends_px[at]), std_px, "px")


def _robust_fit(rows: Array) -> tuple[Array, Array]:
    B, rows_px = rows[:, :-1], rows[:, -1]
    # From the offset that most have, not from the mean of false ones.
    fit = np.eye(B.shape[1])[0] * np.median(rows_px)
    for _ in range(30):
        scale_px = scale_of(rows_px - B @ fit) + 0.05
        weight = 1.0 / np.sqrt(1.0 + ((rows_px - B @ fit) / scale_px) ** 2)
        fit = np.linalg.lstsq(B * weight[:, None], rows_px * weight, rcond=None)[0]
    # Points of one texture err alike.
    normal = (B * weight[:, None] ** 2).T @ B + 1e-9 * len(B) * np.eye(B.shape[1])
    return np.asarray(fit), np.asarray(2.0 * scale_px**2 * np.linalg.inv(normal))
