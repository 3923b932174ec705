"""How high the tissue stands over where the profile has it, as stereo shows it in one frame, and what that may err by.

The profile's plane is measured once, and tissue moves with breath and pulse: its height is a constant that the profile
states within a deviation, and a motion about it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.detection.stereo_surface import StereoSurface
from svmdist.estimation.filter.constants import Deviations, SharedBias
from svmdist.estimation.filter.linearisation import Linearised
from svmdist.estimation.tissue.dome import DomeModel
from svmdist.estimation.tissue.pose import ray_on_plane_biases
from svmdist.geometry.surfaces import Plane
from svmdist.least_squares import median
from svmdist.profile import Tissue
from svmdist.profile.settings import StereoSettings, TissueTrackingSettings
from svmdist.samples import RightView
from svmdist.transforms import Array, inverse

MIN_POINTS = 50
"""Of a surface inside of the dome's rim: fewer are no view of it."""
OUTLINE = "tissue height"


@dataclass(frozen=True, slots=True)
class TissueHeight:
    """What is uncertain about the plane's distance at the tissue: constant and motion, as deviations in m."""

    constant_std_m: float
    motion_std_m: float
    motion_time_s: float

    @classmethod
    def of(cls, tissue: Tissue, position_m: Array) -> TissueHeight:
        """At a place on the plane, shape (3,): a tilt lifts what lies beside the foot of the camera's perpendicular."""
        normal = np.array(tissue.plane_normal)
        beside_m = position_m + tissue.plane_distance_m * normal
        tilt_m = tissue.plane_tilt_std_rad * float(np.linalg.norm(beside_m))
        constant = float(np.hypot(tissue.plane_distance_std_m, tilt_m))
        return cls(constant, tissue.motion_std_m, tissue.motion_time_s)

    def biases(self, by_height: Array) -> tuple[SharedBias, ...]:
        """Of what a height in m moves by `by_height`, shape (m,)."""
        column = by_height[:, None]
        return (
            SharedBias("tissue plane", self.constant_std_m * column),
            SharedBias("tissue motion", self.motion_std_m * column, self.motion_time_s),
        )

    def in_m(self, plane: float, motion: float) -> float:
        """The height in m of both biases, in units of their deviations."""
        return self.constant_std_m * plane + self.motion_std_m * motion


def measured_height(
    surface: StereoSurface,
    dome: DomeModel,
    height: TissueHeight,
    camera: Camera,
    right: RightView,
    deviations: Deviations,
    stereo: StereoSettings,
    tracking: TissueTrackingSettings,
) -> tuple[Linearised, float] | None:
    """The height over the dome where the profile has it, as a measurement, and in m; None where too little is seen.

    A surface by stereo errs by as much over all of the tissue as its texture misleads the matching: the larger part
    of that lasts.
    """
    points_m = dome.to_tissue_frame(surface.points_m)
    inner = dome.normalised_radius(points_m[:, :2], dome.shape[:2]) < stereo.inner_radius
    if np.count_nonzero(inner) < MIN_POINTS:
        return None
    over_m = float(median(points_m[inner, 2] - dome.height_m(points_m[inner, :2])))
    at_m = np.median(surface.points_m[inner], 0)
    # Disparity to depth to height along the plane's normal: a larger disparity is nearer to the camera.
    along_normal = abs(float(dome.T_camera_tissue[2, 2]))
    stereo_biases = (bias.scaled(along_normal) for bias in depth_biases(at_m, camera, right, deviations))
    by_shape = dome.derivative(points_m[inner, :2]).mean(0)
    dome_std_m = float(np.sqrt(by_shape[2:] @ dome.covariance[2:, 2:] @ by_shape[2:]))
    own = SharedBias(
        OUTLINE,
        np.array([[np.hypot(tracking.lasting_height_share * surface.std_m, dome_std_m)]]),
        tracking.height_correlation_time_s,
    )
    noise_m2 = (1.0 - tracking.lasting_height_share**2) * surface.std_m**2
    part = Linearised(
        np.array([over_m]),
        np.zeros((1, 0)),
        (own, *height.biases(np.ones(1)), *stereo_biases),
        np.array([[noise_m2]]),
    )
    return part, over_m


def depth_biases(
    p_camera_m: Array, camera: Camera, right: RightView, deviations: Deviations
) -> tuple[SharedBias, ...]:
    """What errors of both cameras do to the depth in m that a surface by stereo has at a point, shape (3,)."""
    T_right_left = inverse(right.T_left_right)
    disparity_px = float(camera.K[0, 0] * np.linalg.norm(T_right_left[:3, 3]) / p_camera_m[2])
    biases = deviations.of_disparity_at(p_camera_m, right.camera, np.array(disparity_px), T_right_left)
    return tuple(bias.scaled(p_camera_m[2] / disparity_px) for bias in biases)


def by_constants(
    position_m: Array, plane: Plane, height: TissueHeight, camera: Camera, deviations: Deviations
) -> tuple[SharedBias, ...]:
    """What height, focal length and principal point do to the place where the outline's ray meets the plane, (3, k)."""
    return (
        *height.biases(position_m / plane.offset_m),
        *ray_on_plane_biases(position_m, plane, camera, deviations.camera),
    )
