"""The tissue over time: its place by its outline, its height over the profile's plane by stereo."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from svmdist.estimation.frame import Frame
from svmdist.estimation.instrument.consistency import GatingResult, chi_square_bound
from svmdist.estimation.instrument.kinematic_error_filter import KinematicErrorFilter
from svmdist.estimation.instrument.measurement import SharedBias
from svmdist.estimation.instrument.state import Linearised
from svmdist.estimation.scene import Arm
from svmdist.estimation.tissue.detection import (
    TissueDetection,
    TissuePose,
    ray_on_plane_biases,
    require_tissue,
    tissue_plane,
)
from svmdist.estimation.tissue.dome import INNER_RADIUS, DomeModel
from svmdist.estimation.tissue.surface import depth_biases
from svmdist.geometry import Cloud
from svmdist.least_squares import median, scale_of
from svmdist.profile.robot import Tissue
from svmdist.profile.settings import TissueTrackingSettings
from svmdist.transforms import Array

PLANE_DEGREES = 2  # of freedom that a place on a plane has
MIN_SCATTER_COUNT = 4.0  # fewer poses do not tell how much they scatter beyond their stated covariance
# Normal quantile of the gate for a pose against the remembered one: 1 in 1,000 true ones is refused
GATE_Z = 3.09
# Wet, breathing tissue scatters by 0.10 to 0.20 from frame to frame; 0.98 leaves 0.20
LASTING_HEIGHT_SHARE = 0.98
HEIGHT_CORRELATION_TIME_S = 30.0  # how long that lasts: longer than the logs of 8 s that it was seen in

TINY_M2 = 1e-14  # added to covariances of poses that lie on one plane, so that they have an inverse


class CorrelatedMean:
    """A weighted mean of places on a plane, shape (3,), that err alike.

    Its covariance is the mean's of one measurement (the harmonic mean of all), never smaller for their number. Where
    they scatter more than they say of themselves, as under blur and noise, it grows by as much (Birge 1932).
    """

    def __init__(self, memory_count: float) -> None:
        self._fade = 1.0 - 1.0 / memory_count
        self._information: Array = np.zeros((3, 3))
        self._weighted: Array = np.zeros(3)
        self._squares = self._count = 0.0

    def add(self, value: Array, covariance: Array) -> None:
        """Take up a measurement; earlier ones fade."""
        weight = np.asarray(np.linalg.inv(covariance + TINY_M2 * np.eye(3)), np.float64)
        self._information = self._fade * self._information + weight
        self._weighted = self._fade * self._weighted + weight @ value
        self._squares = self._fade * self._squares + float(value @ weight @ value)
        self._count = self._fade * self._count + 1.0

    def now(self) -> tuple[Array, Array]:
        """Mean and covariance, after a first measurement."""
        spread = np.linalg.inv(self._information)
        mean = np.asarray(spread @ self._weighted, np.float64)
        excess = 1.0
        if self._count >= MIN_SCATTER_COUNT:
            scatter = self._squares - float(self._weighted @ mean)
            excess = max(1.0, scatter / (PLANE_DEGREES * (self._count - 1.0)))
        return mean, np.asarray(excess * self._count * spread, np.float64)


class TissueTracker:
    """The tissue's pose, which a wild detection does not enter, and its dome's shape, where frames show it."""

    def __init__(self, settings: TissueTrackingSettings) -> None:
        self._settings = settings
        self._forget()

    def _forget(self) -> None:
        self._outlier_count = 0
        self._best: TissuePose | None = None
        self._place = CorrelatedMean(self._settings.memory_count)

    def add(self, seen: TissueDetection | None) -> TissuePose | None:
        """Take up a frame's pose, if it has one; gives the tissue as known then."""
        pose = None if seen is None else seen.pose
        if pose is None:
            return self.now()
        if not self._agrees(pose):
            self._outlier_count += 1
            if self._outlier_count < self._settings.moved_count:
                return self.now()
            self._forget()
        self._outlier_count = 0
        self._place.add(pose.position_m, pose.outline_covariance)
        if self._best is None or np.trace(pose.outline_covariance) <= np.trace(self._best.outline_covariance):
            self._best = pose
        return self.now()

    def now(self) -> TissuePose | None:
        """The tissue as it is known; None before the first pose."""
        if self._best is None:
            return None
        # Outlines differ from frame to frame and are averaged; the plane is as uncertain in all of them.
        position_m, of_outline = self._place.now()
        covariance = of_outline + self._best.covariance - self._best.outline_covariance
        known = self._best.moved_to(position_m)  # spatial distance and clearance are to one tissue
        return replace(known, covariance=covariance, outline_covariance=of_outline)

    def _agrees(self, pose: TissuePose) -> bool:
        if self._best is None:
            return True
        position_m, covariance = self._place.now()
        offset_m = pose.position_m - position_m
        nis = offset_m @ np.linalg.solve(pose.outline_covariance + covariance + TINY_M2 * np.eye(3), offset_m)
        return bool(nis <= chi_square_bound(3, GATE_Z))


MIN_POINTS = 50  # of a surface inside of the dome's rim: fewer are no view of it
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


MAX_SHAPE_STDS = 2.0  # beyond, a surface that is seen is better than a shape: it only widens the interval
OFF_PLANE_STDS = 3.5  # of the surface by stereo from the profile's, above which they contradict each other


def surface_by_stereo(frame: Frame, known: TissuePose) -> TissuePose | None:
    """The tissue with the surface that both views show, with its own errors; None where they do not agree on one."""
    surface, right = frame.scene.stereo_surface, frame.scene.observation.right
    if surface is None or right is None:
        return None
    cloud = surface.cloud(frame.left.camera, right, frame.arm.deviations)
    off_m = _off_plane_m(surface.points_m, median(cloud.std_m), require_tissue(frame.arm.profile))
    return replace(known, surface=cloud, surface_std_m=off_m, dome=None, is_measured=True)


def _off_plane_m(points_m: Array, std_m: float, tissue: Tissue) -> float:
    """How far a surface, (n, 3), stands off where the profile's plane and shape allow it, 0 where it does not."""
    if tissue.mesh is not None:
        return 0.0
    height_m = points_m @ np.array(tissue.plane_normal) + tissue.plane_distance_m
    top_m, shape_m = 0.0, tissue.surface_std_m
    if tissue.dome is not None:
        top_m, shape_m = tissue.dome.height_m, tissue.dome.height_std_m
    tilt_m = tissue.plane_tilt_std_rad * float(np.linalg.norm(np.median(points_m, 0)[:2]))
    parts = (std_m, tissue.plane_distance_std_m, tissue.motion_std_m, shape_m, tilt_m)
    middle_m = float(np.median(height_m))
    off_m = max(-middle_m, middle_m - top_m, 0.0)
    return off_m if off_m > OFF_PLANE_STDS * float(np.linalg.norm(parts)) else 0.0


class FollowedTissue:
    """The tissue between frames: a place that is averaged, a shape, and a height that the filter's state holds."""

    def __init__(self, arm: Arm) -> None:
        self._profile = arm.profile
        self._tissue = require_tissue(arm.profile)
        self._plane = tissue_plane(self._tissue)
        self._deviations = arm.deviations
        self._tracker = TissueTracker(arm.profile.settings.tissue)
        self._known: TissuePose | None = None

    def see(self, frame: Frame) -> TissuePose | None:
        """The tissue on the profile's plane after this frame, which may hide it."""
        self._known = self._tracker.add(frame.scene.tissue)
        return self._known

    def measure_height(self, frame: Frame, kalman: KinematicErrorFilter) -> GatingResult | None:
        """Tell the filter how high stereo shows the tissue; None where it does not show it."""
        known, right = self._known, frame.scene.observation.right
        if known is None or known.dome is None or right is None:
            return None
        surface, dome = frame.scene.stereo_surface, known.dome
        if surface is None:
            return None
        points_m = dome.to_tissue_frame(surface.points_m)
        inner = dome.polar.normalised_radius(points_m[:, :2]) < INNER_RADIUS
        if np.count_nonzero(inner) < MIN_POINTS:
            return None
        over_m = float(median(points_m[inner, 2] - dome.height_m(points_m[inner, :2])))
        at_m = np.median(surface.points_m[inner], 0)
        # Disparity to depth to height along the plane's normal: a larger disparity is nearer to the camera.
        along_normal = abs(float(dome.T_camera_tissue[2, 2]))
        of_cameras = depth_biases(at_m, frame.left.camera, right, self._deviations)
        by_shape = dome.derivative(points_m[inner, :2]).mean(0)
        dome_std_m = float(np.sqrt(by_shape[2:] @ dome.covariance[2:, 2:] @ by_shape[2:]))
        lasting_m = np.hypot(LASTING_HEIGHT_SHARE * surface.std_m, dome_std_m)
        own = SharedBias(OUTLINE, np.array([[lasting_m]]), HEIGHT_CORRELATION_TIME_S)
        noise_m2 = (1.0 - LASTING_HEIGHT_SHARE**2) * surface.std_m**2
        height = TissueHeight.of(self._tissue, known.position_m)
        biases = (own, *height.biases(np.ones(1)), *(bias.scaled(along_normal) for bias in of_cameras))
        part = Linearised(np.array([over_m]), np.zeros((1, 0)), biases, np.array([[noise_m2]]))
        return kalman.update_scene(OUTLINE, part)

    def placed(
        self, known: TissuePose, frame: Frame, kalman: KinematicErrorFilter
    ) -> tuple[TissuePose, Array]:
        """The tissue at the height found, with all its errors, and their covariance with the tool's pose, (6, 3).

        Where both views show a surface and the profile knows its shape no better, that surface is taken: as if its
        errors were not the tool's, too, which makes their difference only wider.
        """
        height = TissueHeight.of(self._tissue, known.position_m)
        plane_m = height.constant_std_m * kalman.constant("tissue plane")
        height_m = plane_m + height.motion_std_m * kalman.constant("tissue motion")
        plane = replace(self._plane, offset_m=self._plane.offset_m + height_m)
        placed = known.scaled(plane.offset_m / self._plane.offset_m)
        place_m, of_camera = placed.position_m, self._deviations.camera
        by_ray = ray_on_plane_biases(place_m, plane, frame.left.camera, of_camera)
        covariance, coupling = kalman.coupled((*height.biases(place_m / plane.offset_m), *by_ray))
        placed = replace(placed, covariance=placed.outline_covariance + covariance)
        seen = surface_by_stereo(frame, placed)
        if seen is None:
            return placed, coupling
        shape_std_m = self._shape_std_m(seen)
        assert isinstance(seen.surface, Cloud)
        seen_std_m = float(np.hypot(median(seen.surface.std_m), seen.surface_std_m))
        is_surer = shape_std_m < seen_std_m and self._has_shape(placed.dome, frame, shape_std_m)
        return placed if is_surer else seen, coupling

    def _has_shape(self, dome: DomeModel | None, frame: Frame, std_m: float) -> bool:
        """Whether a surface that is seen has a dome's shape, `std_m` apart, at whatever height."""
        surface = frame.scene.stereo_surface
        if dome is None or surface is None:
            return True
        points_m = dome.to_tissue_frame(surface.points_m)
        inner_m = points_m[dome.polar.normalised_radius(points_m[:, :2]) < INNER_RADIUS]
        if len(inner_m) < MIN_POINTS:
            return True
        over_m = inner_m[:, 2] - dome.height_m(inner_m[:, :2])
        return scale_of(over_m - median(over_m)) < MAX_SHAPE_STDS * float(np.hypot(std_m, surface.std_m))

    def _shape_std_m(self, seen: TissuePose) -> float:
        """How wrong the profile's shape of a surface that is seen may be; without a dome or mesh it knows none."""
        tissue = self._tissue
        if tissue.dome is None and tissue.mesh is None:
            return np.inf
        assert isinstance(seen.surface, Cloud)
        from_origin_m = seen.surface.points_m - seen.position_m
        tilt_m = tissue.plane_tilt_std_rad * float(np.median(np.linalg.norm(from_origin_m, axis=1)))
        dome_m = 0.0 if tissue.dome is None else tissue.dome.height_std_m
        return float(np.linalg.norm([tissue.surface_std_m, dome_m, tilt_m]))
