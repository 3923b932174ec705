"""Checks: what a log shows more than once must agree, within what profile and measurements say of themselves.

A difference is one value by two independent ways, with its standard deviation, in one frame. Frames from all of a log
are compared; one comparison is all differences of one kind. What differs by more than `MAX_DEVIATIONS` in two frames of
five, and in two, contradicts: one frame alone may be mistaken. Each kind is a test of its own (Baarda 1968), so that
the line says what to look at.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import cv2
import numpy as np

from svmdist.estimation.dome import INNER_RADIUS
from svmdist.estimation.frame import Frame
from svmdist.estimation.instrument.error_model import nominal_tool
from svmdist.estimation.instrument.factors import marker_in, pair_markers
from svmdist.estimation.instrument.measurement import Deviations
from svmdist.estimation.one_view import tool_from_tag
from svmdist.estimation.scene import Arm, Scene
from svmdist.estimation.stereo import nominal_orientation_pose
from svmdist.estimation.tissue_tracking import depth_biases
from svmdist.geometry import Mesh
from svmdist.geometry.distance import signed_distances
from svmdist.kinematics import rows_behind_insertion
from svmdist.least_squares import scale_of
from svmdist.results import Failure, ToolPose
from svmdist.transforms import Array
from svmdist.vision.lines import undistorted
from svmdist.vision.stereo import corresponding_points

MAX_DEVIATIONS = (
    4.0  # as of a constant: 1 normal error in 16,000 is beyond it, and stated deviations are rounded
)
MIN_FRAMES, MIN_SHARE = 2, 0.4  # that contradict, of those that compare
MIN_MATCHES, MIN_FITTED = (
    8,
    40,
)  # points in both views that tell a median, and how rows change over the picture
MAX_ROWS_PX = 30.0  # by which rows of both views may differ to be compared at all
FIELD_STD = 0.1  # logarithm: the bounds of a field of view are round numbers
MARKER_STD = 0.42  # of a disc's visible middle, over its radius: one half may be hidden
SHAPE_SHARE = 0.5  # of a surface's error by stereo, what is not its offset: measured on clean and wet tissue
OUTLINE_STD = 0.06  # logarithm of the size of a tissue's outline: what hides it is completed
POINTS = 60  # of the surface by stereo that are compared with a profile's mesh

KINEMATICS, SHAFT, DISPARITY, TAG = "kinematics", "the shaft's width", "disparity", "the tag"
MARKER = "the marker's size"
TISSUE, VIEWS, FIELD = "tissue", "views", "field"
HEIGHT = "height of the tissue"
MISTAKES = {
    KINEMATICS: (
        "the camera-to-base transform (mm for m, inverse, order of the quaternion, moved since)",
        "the chain (another robot's, modified for standard DH)",
        "joints (order, signs, unit, late)",
    ),
    SHAFT: ("shaft_radius_m (a diameter?)", "the focal length (another zoom?)"),
    DISPARITY: ("the baseline (unit, half, sign)", "exchanged or turned views"),
    MARKER: ("knuckle_radius_m", "the focal length"),
    TAG: ("the tag's size_m", "its link, place or rotation"),
    TISSUE: ("[tissue]: plane, dome or mesh (place, tilt, height, unit, axes)", "focal length or baseline"),
    VIEWS: (
        "left and right exchanged",
        "the baseline (unit, sign)",
        "a lens stated of rectified images",
        "a turned camera",
    ),
    FIELD: ("a unit (mm for m)", "a diameter for a radius", "[field], where this robot is another one"),
}
"""The mistakes that look like a contradiction of each source, the commonest first."""
RELIES = {
    "kinematic": {KINEMATICS, TISSUE, FIELD},
    "fiducial": {TAG, TISSUE, FIELD},
    "shaft": {SHAFT, MARKER, TISSUE, FIELD},
    "stereo": {DISPARITY, VIEWS, SHAFT, MARKER, FIELD},
    "fused": {KINEMATICS, SHAFT, MARKER, DISPARITY, TAG, VIEWS, TISSUE, FIELD},
}
"""What each method relies on; the planar ones rely on their calibration alone."""


class Difference(NamedTuple):
    """One value by one source less that by another, in one frame, and its standard deviation."""

    what: str
    sources: tuple[str, ...]
    value: float
    std: float
    unit: str  # m, px, rad; empty for a logarithm

    @property
    def deviations(self) -> float:
        """Over its standard deviation, without a sign."""
        return abs(self.value) / self.std if self.std > 0.0 else np.inf if self.value else 0.0


@dataclass(frozen=True, slots=True)
class Comparison:
    """All differences of one kind over a log: the usual one, and whether it contradicts."""

    usual: Difference
    frames: int
    contradicting: int
    least: int = 1  # frames that must contradict

    @property
    def contradicts(self) -> bool:
        """Whether enough frames are beyond what is uncertain."""
        return self.contradicting >= max(self.least, MIN_SHARE * self.frames)

    @property
    def verdict(self) -> str:
        """`agrees` or `contradicts`."""
        return "contradicts" if self.contradicts else "agrees"

    @property
    def against(self) -> str:
        """The sources, in words."""
        return " against ".join(self.usual.sources)

    @property
    def could_be(self) -> tuple[str, ...]:
        """What mistakes look like this."""
        two = 2 if len(self.usual.sources) > 1 else 4
        return tuple(one for source in self.usual.sources for one in MISTAKES.get(source, ())[:two])

    def with_mistakes(self) -> str:
        """The sentence, and what to look at."""
        return f"{self}; look at {', or '.join(self.could_be)}"

    def __str__(self) -> str:
        """A sentence for a person."""
        found = self.usual
        return (
            f"{found.what}: {self.against} contradicts by {readable(found)}, {found.deviations:.0f} standard"
            f" deviations, in {self.contradicting} of {self.frames} frames"
        )


@dataclass(frozen=True)
class Checks:
    """All comparisons of one instrument in a log."""

    comparisons: tuple[Comparison, ...]

    @classmethod
    def of(cls, differences: Iterable[Difference], frames: int) -> Checks:
        """Put the differences of some frames together by their kind, in the order in which they first came."""
        kinds: dict[tuple[str, tuple[str, ...]], list[Difference]] = {}
        for one in differences:
            kinds.setdefault((one.what, one.sources), []).append(one)
        return cls(tuple(_compared(ones, frames) for ones in kinds.values()))

    @property
    def contradictions(self) -> tuple[Comparison, ...]:
        """Those that contradict, the worst first."""
        found = [one for one in self.comparisons if one.contradicts]
        return tuple(sorted(found, key=lambda one: -one.usual.deviations))

    @property
    def blamed(self) -> set[str]:
        """The sources that may be wrong: of two that contradict the one that fewer others agree with, else both."""
        votes: dict[str, int] = {}
        for one in self.comparisons:
            for source in one.usual.sources:
                votes[source] = votes.get(source, 0) + (-1 if one.contradicts else 1)
        blamed: set[str] = set()
        for one in self.contradictions:
            least = min(votes[source] for source in one.usual.sources)
            blamed |= {source for source in one.usual.sources if votes[source] == least}
        return blamed

    def doubt(self, method: str) -> str:
        """Why no row of a method can be trusted; empty where none of what it relies on is contradicted."""
        wrong = RELIES.get(method, set()) & self.blamed
        return next((str(one) for one in self.contradictions if wrong & set(one.usual.sources)), "")

    @property
    def tissue_off_m(self) -> float | None:
        """By how much both views show the tissue elsewhere than the profile has it; None where they do not show it."""
        return next((abs(one.usual.value) for one in self.comparisons if one.usual.what == HEIGHT), None)


def _compared(ones: Sequence[Difference], frames: int) -> Comparison:
    beyond = [one for one in ones if one.deviations > MAX_DEVIATIONS]
    least = 1 if ones[0].sources == (FIELD,) else min(MIN_FRAMES, frames)
    found = Comparison(ones[0], len(ones), len(beyond), least)
    shown = sorted(beyond if found.contradicts else ones, key=lambda one: one.deviations)
    return replace(found, usual=shown[len(shown) // 2])


def readable(found: Difference) -> str:
    """The difference with its unit."""
    if not np.isfinite(found.value):
        return "all"
    scale, unit = {"m": (1e3, "mm"), "rad": (180.0 / np.pi, "°"), "px": (1.0, "px")}.get(
        found.unit, (100.0, "%")
    )
    return f"{scale * found.value:.3g}{'' if unit in '°%' else ' '}{unit}"


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


def _bounded(what: str, value: float, bounds: tuple[float, float]) -> Difference:
    """By how much a length in m is outside of bounds, as a logarithm."""
    low, high = bounds
    off = 0.0
    if value > high:
        off = float(np.log(value / high))
    elif value < low:
        off = -np.inf if value <= 0.0 else float(np.log(value / low))
    return Difference(what, (FIELD,), off, FIELD_STD, "")


def of_frame(frame: Frame) -> Iterator[Difference]:
    """What one frame shows of one instrument more than once."""
    sources, field = dict(_sources(frame)), frame.arm.profile.field
    for source in (KINEMATICS, TAG):
        if (pose := sources.get(source)) is not None:
            yield _bounded(
                "distance of the tool from the camera", float(pose.position_m[2]), (0.0, field.depth_m)
            )
            if pose.position_m[2] > 0.0:
                yield from _against_image(frame, source, pose)
    for (one, pose), (other, reference) in combinations(sources.items(), 2):
        ray = reference.position_m / np.linalg.norm(reference.position_m)
        variance = ray @ (pose.position_covariance + reference.position_covariance) @ ray
        off_m = float(ray @ (pose.position_m - reference.position_m))
        yield Difference("depth of the tool", (one, other), off_m, float(np.sqrt(variance)), "m")


def _sources(frame: Frame) -> Iterator[tuple[str, ToolPose]]:
    """The tool by each way that the log has; poses that their own image refutes are left out."""
    arm, robot, pair, right = (
        frame.arm,
        frame.robot_in_camera,
        frame.scene.stereo_pair,
        frame.scene.observation.right,
    )
    error = arm.profile.kinematic_error
    if not isinstance(robot, Failure):
        yield KINEMATICS, nominal_tool(arm.required_chain, error, robot)
    if arm.profile.segmentation.shaft is not None and arm.body is not None and arm.chain is not None:
        fit = frame.shaft_pose
        if not isinstance(fit, Failure):  # in doubt, too: what is wrong with a size makes it doubtful
            yield SHAFT, fit.pose
    size = _by_marker_size(frame)
    if size is not None:
        yield MARKER, size
    if not isinstance(pair, Failure) and right is not None:
        markers = pair_markers(frame, pair)
        if not isinstance(markers, Failure):
            anyhow = ToolPose(np.eye(4), np.eye(6), np.array([1.0, 0.0, 0.0]))
            yield DISPARITY, nominal_orientation_pose(markers, pair, right, anyhow, arm.deviations)
    fiducial, tag = arm.profile.fiducial, frame.tag
    if fiducial is not None and tag is not None and not isinstance(frame.robot, Failure):
        focal_px = np.diag(frame.left.camera.K)[:2]
        yield TAG, tool_from_tag(tag, fiducial, frame.robot, error, arm.deviations, focal_px)


def _by_marker_size(frame: Frame) -> ToolPose | None:
    """The tool where the distal marker has its size; None where it is not whole."""
    view, instrument = frame.left, frame.arm.profile.instrument
    marker = view.distal_marker
    if instrument is None or marker is None or marker.radius_px is None or marker.disc is None:
        return None
    depth_m = float(view.camera.K[0, 0]) * instrument.knuckle_radius_m / marker.radius_px
    parts = (marker.radius_std_px / marker.radius_px, instrument.knuckle_radius_std_fraction)
    std_m = depth_m * float(np.hypot(*parts))
    ray = np.append(undistorted(view.camera, marker.disc.centre_px[None])[0], 1.0)
    pose = np.eye(4)
    pose[:3, 3] = depth_m * ray
    covariance = np.eye(6)
    covariance[:3, :3] = std_m**2 * np.outer(ray, ray) + 1e-8 * np.eye(3)
    return ToolPose(pose, covariance, np.array([1.0, 0.0, 0.0]))


def _against_image(frame: Frame, source: str, pose: ToolPose) -> Iterator[Difference]:
    """A tool's pose against where the image shows its marker, and against the plane between the shaft's sides."""
    view, arm = frame.left, frame.arm
    seen = marker_in(view, arm, None)
    if seen is not None:
        place_m = pose.position_m
        if arm.profile.instrument is not None:
            place_m = place_m + pose.T_camera_tool[:3, :3] @ np.array(
                arm.profile.instrument.knuckle_position_m
            )
        depth_m, ray = float(place_m[2]), np.append(undistorted(view.camera, seen.pixel[None])[0], 1.0)
        off_m = (place_m - depth_m * ray)[:2]
        along = np.column_stack([np.eye(2), -ray[:2]])  # what depth moves, the ray moves with
        pixel_m = (
            depth_m / float(view.camera.K[0, 0]) * float(np.hypot(seen.std_px, MARKER_STD * seen.radius_px))
        )
        own_m = float(np.hypot(pixel_m, seen.place_std_m))
        covariance = along @ pose.position_covariance @ along.T + own_m**2 * np.eye(2)
        square = float(off_m @ np.linalg.solve(covariance, off_m))
        length_m = float(np.linalg.norm(off_m))
        # Of two dimensions: as many deviations as a normal number of that probability has, to first order.
        deviations = np.sqrt(max(square - 1.0, 0.0))
        yield Difference(
            "place in the image", (source, "the marker"), length_m, _std(length_m, deviations), "m"
        )
    sides = {contour.side: contour.plane for contour in view.shaft.contours}
    if len(sides) == 2 and not view.shaft.is_stub:
        middle = sides[1].normal - sides[-1].normal
        middle /= np.linalg.norm(middle)
        off_rad = float(np.arcsin(np.clip(middle @ pose.axis, -1.0, 1.0)))
        yield Difference(
            "direction of the shaft",
            (source, "its sides"),
            off_rad,
            float(np.hypot(pose.shaft_std_rad, 0.01)),
            "rad",
        )


def _std(value: float, deviations: float) -> float:
    return value / deviations if deviations > 0.0 else np.inf


def of_scene(scene: Scene) -> Iterator[Difference]:
    """The tissue: a mesh against its outline, and the surface by both views against the profile's."""
    tissue, profile = scene.tissue, scene.profile
    if tissue is None or tissue.pose is None or profile.tissue is None:
        return
    if isinstance(tissue.pose.surface, Mesh) and tissue.pose.dome is None:
        corners_m = tissue.pose.surface.vertices_m
        seen = tissue.outline.curve_px
        if np.all(corners_m[:, 2] > 0.0):
            areas = [
                cv2.contourArea(cv2.convexHull(px.astype(np.float32)))
                for px in (scene.observation.camera.project(corners_m), seen)
            ]
            depth_std = profile.tissue.plane_distance_std_m / profile.tissue.plane_distance_m
            off = 0.5 * float(np.log(max(areas[0], 1.0) / max(areas[1], 1.0)))
            yield Difference(
                "size of the tissue",
                (TISSUE, "its outline"),
                off,
                float(np.hypot(OUTLINE_STD, depth_std)),
                "",
            )
    yield from _of_surface(scene)


def _of_surface(scene: Scene) -> Iterator[Difference]:
    """The surface's height and tilt over the profile's, and what else differs."""
    surface, tissue, right, profile = (
        scene.stereo_surface,
        scene.tissue,
        scene.observation.right,
        scene.profile,
    )
    if surface is None or tissue is None or tissue.pose is None or right is None or profile.tissue is None:
        return
    pose, stated, points_m = tissue.pose, profile.tissue, surface.points_m
    normal, by_shape, of_shape = np.array(stated.plane_normal), np.zeros((len(points_m), 0)), np.zeros((0, 0))
    if pose.dome is not None:
        local_m = pose.dome.to_tissue_frame(points_m)
        inner = pose.dome.polar.normalised_radius(local_m[:, :2]) < INNER_RADIUS
        points_m, flat_m = points_m[inner], local_m[inner, :2]
        over_m = local_m[inner, 2] - pose.dome.height_m(flat_m)
        by_shape, of_shape = pose.dome.derivative(flat_m), pose.dome.covariance
    elif isinstance(pose.surface, Mesh):
        points_m = points_m[:: max(1, len(points_m) // POINTS)]
        over_m, by_shape = signed_distances(points_m, pose.surface)[1], np.zeros((len(points_m), 0))
    else:
        over_m = points_m @ normal + stated.plane_distance_m
    if len(points_m) < POINTS:
        return
    middle_m = np.mean(points_m, 0)
    across_m = (points_m - middle_m) @ np.linalg.svd(normal[None])[2][1:].T
    B = np.column_stack([across_m, np.ones(len(over_m))])
    P = np.linalg.pinv(B)
    fit, own_m = P @ over_m, float(np.hypot(surface.std_m, pose.surface_std_m))
    of_fit = np.sqrt(
        np.diag(P @ by_shape @ of_shape @ (P @ by_shape).T)
    )  # what is uncertain of a dome's shape
    beside_m = float(np.linalg.norm(middle_m + stated.plane_distance_m * normal))
    of_cameras = depth_biases(middle_m, scene.observation.camera, right, Deviations.of(profile))
    biases_m = [float(np.linalg.norm(one.jacobian)) for one in of_cameras]
    plane_m = (stated.plane_distance_std_m, stated.motion_std_m, stated.plane_tilt_std_rad * beside_m)
    std_m = float(np.linalg.norm([*plane_m, *biases_m, of_fit[2], own_m]))
    yield Difference(HEIGHT, (TISSUE, DISPARITY), float(fit[2]), std_m, "m")
    reach_m = float(np.sqrt(np.linalg.eigvalsh(np.cov(across_m.T))[0]))  # of its shorter side
    turned_rad = profile.camera_error.right_rotation_std_rad
    std_rad = float(np.linalg.norm([stated.plane_tilt_std_rad, own_m / reach_m, turned_rad, *of_fit[:2]]))
    tilt_rad = float(np.arctan(np.linalg.norm(fit[:2])))
    yield Difference("tilt of the tissue", (TISSUE, DISPARITY), tilt_rad, std_rad, "rad")
    rest = by_shape - B @ (P @ by_shape)
    shape_m = float(np.hypot(SHAPE_SHARE * surface.std_m, pose.surface_std_m))
    shape_m = float(np.sqrt(shape_m**2 + np.mean(np.einsum("ni,ij,nj->n", rest, of_shape, rest))))
    yield Difference(
        "shape of the tissue", (TISSUE, DISPARITY), float(np.std(over_m - B @ fit)), shape_m, "m"
    )


def of_views(scene: Scene) -> Iterator[Difference]:
    """Both views against each other: the sign and size of their disparities, and how their rows differ."""
    right, pair = scene.observation.right, scene.stereo_pair
    if right is None or scene.right is None:
        return
    if isinstance(pair, Failure):
        along_m = float(right.T_left_right[0, 3])
        yield Difference("baseline", (VIEWS,), np.copysign(np.inf, along_m), 1.0, "m")
        return
    left_px, right_px = corresponding_points(scene.left.grey, scene.right.grey, MAX_ROWS_PX)
    if len(left_px) < MIN_MATCHES:
        return
    at_left, at_right = (
        _on_rows(pair.homography(right=side), px) for side, px in ((False, left_px), (True, right_px))
    )
    rows_px = at_right[:, 1] - at_left[:, 1]
    disparity_px = at_left[:, 0] - at_right[:, 0] - pair.offset_px
    field, focal_px = scene.profile.field, float(pair.K[0, 0])
    middle_px = float(np.median(disparity_px))
    # Of a median; points of one texture err alike.
    middle_std_px = 1.25 * scale_of(disparity_px - middle_px) / np.sqrt(0.5 * len(disparity_px)) + 1.0
    far_px, near_px = pair.disparity_at(field.depth_m), pair.disparity_at(field.least_depth_m)
    off_px = min(middle_px - far_px, 0.0) + max(middle_px - near_px, 0.0)
    yield Difference("disparities", (VIEWS,), off_px, float(middle_std_px), "px")
    if len(left_px) < MIN_FITTED:
        return
    # Rows by x, y and xy: a turn about the view, another focal length, a toe-in; the constant part is removed.
    x, y = ((at_left - pair.K[:2, 2]) / focal_px).T
    B = np.column_stack([np.ones(len(x)), x, y, x * y])
    weight = np.ones(len(x))
    for _ in range(8):
        fit = np.linalg.lstsq(B * weight[:, None], rows_px * weight, rcond=None)[0]
        left_over = rows_px - B @ fit
        scale_px = scale_of(left_over) + 0.1
        weight = 1.0 / np.sqrt(1.0 + (left_over / scale_px) ** 2)
    bent_px = B[:, 1:] @ fit[1:]
    rms_px = float(np.sqrt(np.mean((bent_px - bent_px.mean()) ** 2)))
    turn_px = focal_px * scene.profile.camera_error.right_rotation_std_rad
    yield Difference("rows of both views", (VIEWS,), rms_px, float(np.hypot(turn_px, 0.5)), "px")


def _on_rows(H: Array, pixels: Array) -> Array:
    moved = np.column_stack([pixels, np.ones(len(pixels))]) @ H.T
    return np.asarray(moved[:, :2] / moved[:, 2:])
