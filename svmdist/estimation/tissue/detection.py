"""The tissue in an image: its region, its completed outline, and where it lies on the known plane."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import cv2
import numpy as np

from svmdist.camera import Camera
from svmdist.errors import ProfileError
from svmdist.estimation.instrument.measurement import BiasTerm
from svmdist.estimation.tissue.dome import DomeModel
from svmdist.geometry import Cloud, Mesh, Plane, Surface, meet_plane, read_closed_mesh
from svmdist.profile import Profile
from svmdist.profile.hand_eye import FOCAL_LENGTH, PRINCIPAL_POINT
from svmdist.profile.robot import CameraError, Tissue
from svmdist.samples import Image
from svmdist.transforms import Array, cross, make_transform
from svmdist.vision.regions import CompletedOutline, Region, complete_outline, find_region
from svmdist.vision.segmentation import Masks

BLOOD_FRACTION = 0.1  # parts below this fraction of the tissue may be blood on an instrument, as red as tissue
RING_PX = 3  # what lies this close to a part surrounds it
BLOOD_RING_FRACTION = 0.5  # share of dark shaft around such a part above which it is blood

METRES_PER_UNIT = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
ACROSS = 0.99  # cosine between normal and axis from which on the axis has no direction on the plane


@dataclass(frozen=True, slots=True)
class TissuePose:
    """The tissue's origin in the camera frame, shape (3,) in m, with covariance (3, 3), and its surface there.

    `outline_covariance` is the part of that covariance that is the outline's own, without the plane's.
    `surface_std_m` is how far the surface may stand off the real one, beside the origin's error and what a `dome` or a
    cloud states of its own shape. A surface that `is_measured` stands where it was seen: errors of
    the origin do not move it.
    """

    position_m: Array
    covariance: Array
    surface: Surface
    surface_std_m: float = 0.0
    dome: DomeModel | None = None
    outline_covariance: Array = field(default_factory=lambda: np.zeros((3, 3)))
    is_measured: bool = False

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
    covariance = of_outline + variance_m2 * np.outer(along, along)
    # What focal length and principal point do to where the outline's ray meets the plane.
    biases = ray_on_plane_biases(position_m, plane, camera, error)
    J = np.concatenate([bias.jacobian for bias in biases], -1)
    covariance = covariance + J @ J.T
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
    """What is uncertain of the plane's height in m at a place on it, (3,), as derivatives (1, 1): constant, and motion.

    A tilt lifts what lies beside the foot of the camera's perpendicular.
    """
    beside_m = position_m + tissue.plane_distance_m * np.array(tissue.plane_normal)
    tilt_m = tissue.plane_tilt_std_rad * float(np.linalg.norm(beside_m))
    constant_std_m = float(np.hypot(tissue.plane_distance_std_m, tilt_m))
    return (
        BiasTerm("tissue plane", np.array([[constant_std_m]])),
        BiasTerm("tissue motion", np.array([[tissue.motion_std_m]]), tissue.motion_time_s),
    )


def ray_on_plane_biases(
    position_m: Array, plane: Plane, camera: Camera, error: CameraError
) -> tuple[BiasTerm, BiasTerm]:
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
