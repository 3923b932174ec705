"""The tissue in an image: its region, its completed outline, where it lies on the known plane, and its shape there."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property, lru_cache
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.errors import ProfileError
from svmdist.estimation.instrument.measurement import BiasTerm
from svmdist.geometry import Cloud, Mesh, Plane, Surface, meet_plane, read_closed_mesh
from svmdist.profile import Profile
from svmdist.profile.hand_eye import FOCAL_LENGTH, PRINCIPAL_POINT
from svmdist.profile.robot import CameraError, Dome, Tissue
from svmdist.samples import Image
from svmdist.transforms import Array, cross, inverse, make_transform, transform_points
from svmdist.vision.colour import Masks
from svmdist.vision.regions import CompletedOutline, Region, complete_outline, find_region

BLOOD_FRACTION = 0.1  # parts below this fraction of the tissue may be blood on an instrument, as red as tissue
RING_PX = 3  # what lies this close to a part surrounds it
BLOOD_RING_FRACTION = 0.5  # share of dark shaft around such a part above which it is blood
METRES_PER_UNIT = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
ACROSS = 0.99  # cosine between normal and axis from which on the axis has no direction on the plane
INNER_RADIUS = 0.9  # of the dome, normalised: beyond it the rim is too steep for a surface of low order
STEP = 1e-7  # of the shape's numbers, by which the derivative is taken
RINGS = 14
SIDES = 72  # the dome's mesh: chords of 5° stand 0.03 mm off an outline of 28 mm
STEEP_RADIUS = 0.98
"""Towards the rim a dome's slope has no bound; beyond this normalised radius it counts as it is here."""


@dataclass(frozen=True, slots=True)
class TissuePose:
    """The tissue's origin in the camera frame, shape (3,), with covariance (3, 3), and its surface there."""

    position_m: Array
    covariance: Array
    surface: Surface
    surface_std_m: float = 0.0  # off the real one, beside the origin's error and what dome or cloud state of themselves
    dome: DomeModel | None = None
    outline_covariance: Array = field(default_factory=lambda: np.zeros((3, 3)))  # without the plane's
    is_measured: bool = False  # whether the surface stands where it was seen: errors of the origin do not move it

    def at(self, position_m: Array, scale: float = 1.0) -> TissuePose:
        """The same at another place, shape (3,), of its plane, or of a parallel one that is farther by a scale."""
        dome, surface = self.dome, self.surface
        if dome is not None:
            dome = dome.at(position_m, scale)
            surface = dome.mesh
        elif isinstance(surface, Plane):
            surface = Plane(surface.normal, scale * surface.offset_m)
        elif isinstance(surface, Mesh):
            surface = surface.transformed(make_transform(np.eye(3), position_m - self.position_m))
        return replace(self, position_m=position_m, surface=surface, dome=dome)

    def surface_variance_m2(self, point_m: Array, direction: Array) -> float:
        """By how much the surface may stand off at one of its points, shape (3,), along a unit vector, shape (3,)."""
        variance_m2 = self.surface_std_m**2
        if isinstance(self.surface, Cloud):
            variance_m2 += self.surface.std_at_m(point_m) ** 2
        return variance_m2 if self.dome is None else variance_m2 + self.dome.variance_m2(point_m, direction)


def require_tissue(profile: Profile) -> Tissue:
    """The profile's tissue; raises ProfileError where it has none, or a mesh that cannot be used."""
    if profile.tissue is None:
        raise ProfileError(
            f"profile {profile.name} has no [tissue]: a distance in 3D from one camera needs the plane that the"
            " tissue lies on (plane_normal, plane_distance_m)"
        )
    _profile_mesh(profile.tissue)  # read once, before the first frame
    return profile.tissue


def _profile_mesh(tissue: Tissue) -> Mesh | None:
    return None if tissue.mesh is None else read_closed_mesh(tissue.mesh, METRES_PER_UNIT[tissue.mesh_unit])


def tissue_pose(outline: CompletedOutline, camera: Camera, tissue: Tissue, error: CameraError) -> TissuePose | None:
    """Place tissue and surface by an outline; None where its centroid's ray does not meet the plane."""
    plane = tissue_plane(tissue)
    position_m = meet_plane(camera.rays(outline.centroid_px), plane)[0]
    if not np.all(np.isfinite(position_m)):
        return None
    # The outline's pixels, and the plane's distance and tilt, to first order: X = offset / (n · r) r.
    steps_px = np.array([[0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])
    on_plane = meet_plane(camera.rays(outline.centroid_px + steps_px), plane)
    J_px = np.stack([on_plane[0] - on_plane[1], on_plane[2] - on_plane[3]], -1)
    of_outline = J_px @ outline.covariance_px2 @ J_px.T
    ray = position_m / position_m[2]
    along = ray / float(plane.normal @ ray)  # dX by the offset
    variance_m2 = sum(float(np.sum(bias.jacobian**2)) for bias in height_biases(tissue, position_m))
    # What focal length and principal point do to where the outline's ray meets the plane.
    J = np.concatenate([bias.jacobian for bias in ray_on_plane_biases(position_m, plane, camera, error)], -1)
    covariance = of_outline + variance_m2 * np.outer(along, along) + J @ J.T
    T_camera_tissue, dome = tissue_frame(position_m, plane.normal), None
    surface: Surface = plane
    outline_m = meet_plane(camera.rays(outline.curve_px), plane)
    if tissue.dome is not None and np.all(np.isfinite(outline_m)) and len(outline_m) >= 3:
        dome = DomeModel.over(outline_m, T_camera_tissue, tissue.dome)
        surface = dome.mesh
    elif (mesh := _profile_mesh(tissue)) is not None:
        surface = mesh.transformed(T_camera_tissue @ tissue.T_tissue_mesh)
    return TissuePose(position_m, covariance, surface, tissue.surface_std_m, dome, of_outline)


def tissue_plane(tissue: Tissue) -> Plane:
    """The profile's plane, the tissue's side below it."""
    return Plane(np.array(tissue.plane_normal), -tissue.plane_distance_m)


def tissue_frame(origin_m: Array, normal: Array) -> Array:
    """`T_camera_tissue`, shape (4, 4): z along the plane's normal, x the camera's x axis laid onto the plane."""
    along = np.eye(3)[0 if abs(normal[0]) < ACROSS else 1]
    x = along - normal * float(normal @ along)
    x /= np.linalg.norm(x)
    return make_transform(np.stack([x, cross(normal, x), normal], -1), origin_m)


def height_biases(tissue: Tissue, position_m: Array) -> tuple[BiasTerm, BiasTerm]:
    """What is uncertain of the plane's height in m at its point, (3,), as Jacobians (1, 1): constant, and motion."""
    # A tilt lifts what lies beside the foot of the camera's perpendicular.
    beside_m = position_m + tissue.plane_distance_m * np.array(tissue.plane_normal)
    tilt_m = tissue.plane_tilt_std_rad * float(np.linalg.norm(beside_m))
    constant_std_m = float(np.hypot(tissue.plane_distance_std_m, tilt_m))
    return (
        BiasTerm("tissue plane", np.array([[constant_std_m]])),
        BiasTerm("tissue motion", np.array([[tissue.motion_std_m]]), tissue.motion_time_s),
    )


def ray_on_plane_biases(position_m: Array, plane: Plane, camera: Camera, error: CameraError) -> tuple[BiasTerm, ...]:
    """What focal length and principal point do to where a ray meets a plane, at `position_m`: Jacobians (3, k)."""
    ray = position_m / position_m[2]
    slope = float(plane.normal @ ray)
    by_ray = plane.offset_m * (np.eye(3) / slope - np.outer(ray, plane.normal) / slope**2)
    focal = -error.focal_std_fraction * by_ray @ (ray * np.array([1.0, 1.0, 0.0]))
    centre = -error.centre_std_px * by_ray[:, :2] / np.diag(camera.K)[:2]
    return BiasTerm(FOCAL_LENGTH, focal[:, None]), BiasTerm(PRINCIPAL_POINT, centre)


@dataclass(frozen=True, slots=True)
class TissueDetection:
    """What an image shows of the tissue; `pose` is None where the outline's rays do not meet the plane."""

    region: Region
    outline: CompletedOutline
    pose: TissuePose | None


def detect_tissue(masks: Masks, profile: Profile, camera: Camera) -> TissueDetection | None:
    """Find the tissue in masks and place it in 3D; None where there is none; ProfileError without a plane."""
    tissue = require_tissue(profile)
    # The region's own centroid would complete the outline a first time.
    rule = profile.segmentation.tissue.model_copy(update={"occlusion": "hull"})
    mask, settings = masks.tissue, profile.settings.outline
    region = find_region(mask, rule, settings)
    if region is not None and region.part_count > 1 and masks.shaft is not None:
        mask = _without_blood(mask, masks.shaft, region.area_px)
        region = find_region(mask, rule, settings)
    if region is None:
        return None
    outline = complete_outline(mask, region.hull, settings)
    if region.part_count > 1:
        # As uncertain as the centroid depends on whether the smaller parts belong to it.
        largest = find_region(mask, rule.model_copy(update={"components": "largest"}), settings)
        if largest is not None:
            off_px = complete_outline(mask, largest.hull, settings).centroid_px - outline.centroid_px
            outline = replace(outline, covariance_px2=outline.covariance_px2 + np.outer(off_px, off_px))
    return TissueDetection(region, outline, tissue_pose(outline, camera, tissue, profile.camera_error))


def _without_blood(mask: Image, shaft: Image, area_px: int) -> Image:
    """The mask, shape (h, w), without small parts that the instrument's dark shaft surrounds."""
    count, labels, statistics, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    kept = mask.copy()
    for label in range(1, count):
        x, y, width, height, size_px = statistics[label]
        if size_px > BLOOD_FRACTION * area_px:
            continue
        box = np.s_[max(0, y - RING_PX) : y + height + RING_PX, max(0, x - RING_PX) : x + width + RING_PX]
        part = (labels[box] == label).astype(np.uint8)
        ring = cv2.dilate(part, np.ones((2 * RING_PX + 1, 2 * RING_PX + 1), np.uint8)) - part
        if np.count_nonzero(ring & (shaft[box] > 0)) > BLOOD_RING_FRACTION * np.count_nonzero(ring):
            kept[box][part > 0] = 0
    return kept


class AboveDome(NamedTuple):
    """Which of n points are inside of the rim, (n,), where these k are on the plane, (k, 2), and how far above it."""

    inner: NDArray[np.bool_]
    flat_m: Array
    over_m: Array


@dataclass(frozen=True)
class DomeModel:
    """A dome where it stands: its surface, and how unsure apex, height and curvature are."""

    T_camera_tissue: Array  # shape (4, 4), its z axis along the plane's normal
    outline_m: Array  # shape (n, 2), in that frame
    shape: Array  # shape (5,): the apex's x and y there and its height, in m, then the exponents of gauge and height
    covariance: Array  # shape (5, 5), of these

    @staticmethod
    def over(outline_m: Array, T_camera_tissue: Array, rule: Dome) -> DomeModel:
        """The profile's dome over an outline in the camera frame, shape (n, 3) in m: the apex over the origin."""
        flat_m = transform_points(inverse(T_camera_tissue), outline_m)[:, :2]
        stds = [rule.apex_std_m, rule.apex_std_m, rule.height_std_m, rule.gauge_exponent_std, rule.height_exponent_std]
        shape = np.array([0.0, 0.0, rule.height_m, rule.gauge_exponent, rule.height_exponent])
        return DomeModel(T_camera_tissue, flat_m, shape, np.diag(np.square(stds)))

    def at(self, position_m: Array, scale: float) -> DomeModel:
        """The same about another origin, shape (3,), in the camera frame: wider by a scale, and as high."""
        T = self.T_camera_tissue.copy()
        T[:3, 3] = position_m
        shape = self.shape * np.array([scale, scale, 1.0, 1.0, 1.0])
        return replace(self, T_camera_tissue=T, outline_m=scale * self.outline_m, shape=shape)

    def to_tissue_frame(self, points_m: Array) -> Array:
        """Points of the camera frame, shape (n, 3), in the tissue's frame."""
        return transform_points(inverse(self.T_camera_tissue), points_m)

    def normalised_radius(self, points_m: Array) -> Array:
        """0 at the apex, 1 on the outline, for points in the tissue's frame, shape (n, 2): shape (n,)."""
        (x, y), (corner_x, corner_y) = (points_m - self.shape[:2]).T, (self.outline_m - self.shape[:2]).T
        # Between corners the reciprocal of the length is interpolated by the angle.
        towards, angle = np.arctan2(y, x), np.arctan2(corner_y, corner_x)
        reciprocal = np.interp(towards, angle, 1.0 / np.hypot(corner_x, corner_y), period=2.0 * np.pi)
        return np.asarray(np.hypot(x, y) * reciprocal)

    def height_m(self, points_m: Array) -> Array:
        """Height over the plane, 0 beyond the outline, at points in the tissue's frame, shape (n, 2)."""
        return np.asarray(self.shape[2] * self._profile(self.normalised_radius(points_m)))

    def above(self, points_m: Array) -> AboveDome:
        """How far points of the camera frame, shape (n, 3), are above the dome."""
        local_m = self.to_tissue_frame(points_m)
        inner = self.normalised_radius(local_m[:, :2]) < INNER_RADIUS
        flat_m = local_m[inner, :2]
        return AboveDome(inner, flat_m, local_m[inner, 2] - self.height_m(flat_m))

    def derivative(self, points_m: Array) -> Array:
        """Of the height at points, shape (n, 2), by the shape: shape (n, 5), by central differences."""
        columns = []
        for step in STEP * np.eye(5):
            ahead, behind = (replace(self, shape=self.shape + by).height_m(points_m) for by in (step, -step))
            columns.append((ahead - behind) / (2.0 * STEP))
        return np.column_stack(columns)

    def variance_m2(self, point_m: Array, direction: Array) -> float:
        """By how much the surface at a point of the camera frame, (3,), may move along a unit vector, (3,)."""
        flat_m = self.to_tissue_frame(point_m[None])[:, :2]
        radius = float(self.normalised_radius(flat_m)[0])
        if radius > STEEP_RADIUS:
            apex_m = self.shape[:2]
            flat_m = apex_m + (flat_m - apex_m) * STEEP_RADIUS / radius
        J = self.derivative(flat_m)[0]
        along = float(direction @ self.T_camera_tissue[:3, 2])
        return along**2 * float(J @ self.covariance @ J)

    @cached_property
    def mesh(self) -> Mesh:
        """The closed surface in the camera frame: apex, rings of `SIDES` vertices outwards, the floor's middle."""
        outline_m = self.outline_m[np.linspace(0, len(self.outline_m), SIDES, endpoint=False).astype(int)]
        x, y = outline_m.T
        if 0.5 * np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) < 0.0:  # clockwise
            outline_m = outline_m[::-1]
        apex_m, height_m = self.shape[:2], float(self.shape[2])
        radius = np.sin(np.linspace(0.0, np.pi / 2.0, RINGS + 1)[1:])
        rings = (apex_m + radius[:, None, None] * (outline_m - apex_m)).reshape(-1, 2)
        z_m = np.repeat(height_m * self._profile(radius), SIDES)
        vertices_m = np.vstack([[*apex_m, height_m], np.column_stack([rings, z_m]), [*apex_m, 0.0]])
        return Mesh(vertices_m, _faces()).transformed(self.T_camera_tissue)

    def _profile(self, radius: Array) -> Array:
        a, b = self.shape[3:]
        inside: Array = (1.0 - np.asarray(radius) ** a).clip(0.0)
        return np.asarray(inside**b)


@lru_cache(maxsize=1)
def _faces() -> NDArray[np.int64]:
    at = 1 + np.arange(RINGS * SIDES).reshape(RINGS, SIDES)
    after = np.roll(at, -1, axis=1)
    apex, floor = np.zeros(SIDES), np.full(SIDES, 1 + RINGS * SIDES)
    faces = [np.stack([apex, at[0], after[0]], -1), np.stack([floor, after[-1], at[-1]], -1)]
    for inner, inner_after, outer, outer_after in zip(at, after, at[1:], after[1:], strict=False):
        faces.append(np.stack([inner, outer, outer_after], -1))
        faces.append(np.stack([inner, outer_after, inner_after], -1))
    return np.concatenate(faces).astype(np.int64)
