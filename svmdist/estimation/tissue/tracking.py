"""The tissue over time: its place by its outline, its height over the profile's plane by stereo."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from svmdist.estimation.frame import Frame
from svmdist.estimation.instrument.consistency import GatingResult, chi_square_bound
from svmdist.estimation.instrument.kinematic_error_filter import KinematicErrorFilter
from svmdist.estimation.instrument.measurement import BiasTerm, Linearised
from svmdist.estimation.tissue import detection
from svmdist.estimation.tissue.detection import TissueDetection, TissuePose, require_tissue
from svmdist.estimation.tissue.surface import depth_biases
from svmdist.geometry import Cloud, Plane
from svmdist.least_squares import median, scale_of
from svmdist.profile.robot import Tissue
from svmdist.profile.settings import TissueTrackingSettings
from svmdist.transforms import Array

PLANE_DEGREES = 2  # of freedom that a place on a plane has
MIN_SCATTER_COUNT = 4.0  # with fewer poses their scatter beyond their covariance is unknown
GATE_Z = 3.09  # normal quantile of the gate for a pose against the remembered one: 1 in 1,000 true ones is rejected
CORRELATED_HEIGHT_SHARE = 0.98  # wet, breathing tissue scatters by 0.10 to 0.20 from frame to frame; 0.98 leaves 0.20
HEIGHT_CORRELATION_TIME_S = 30.0  # how long that lasts: longer than the logs of 8 s that it was seen in
MIN_POINTS = 50  # of a surface inside of the dome's rim: fewer are no view of it
MAX_SHAPE_STDS = 2.0  # beyond, a surface that is seen is better than a shape: it only widens the interval
OFF_PLANE_STDS = 3.5  # of the surface by stereo from the profile's, above which they contradict each other
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
    """The tissue's pose, which outliers do not enter until some in a row say that it has moved."""

    def __init__(self, settings: TissueTrackingSettings) -> None:
        self._settings, self._outlier_count = settings, 0
        self._best: TissuePose | None = None
        self._place = CorrelatedMean(settings.memory_count)

    def add(self, seen: TissueDetection | None) -> TissuePose | None:
        """Take up a frame's pose, if it has one; gives the tissue as known then, None before the first pose."""
        pose = None if seen is None else seen.pose
        if pose is not None:
            self._outlier_count = 0 if self._agrees(pose) else self._outlier_count + 1
            if self._outlier_count >= self._settings.moved_count:
                self._outlier_count, self._best = 0, None
                self._place = CorrelatedMean(self._settings.memory_count)
            if self._outlier_count == 0:
                self._place.add(pose.position_m, pose.outline_covariance)
                if self._best is None or np.trace(pose.outline_covariance) <= np.trace(self._best.outline_covariance):
                    self._best = pose
        if self._best is None:
            return None
        # Outlines differ from frame to frame and are averaged; the plane is as uncertain in all of them.
        position_m, of_outline = self._place.now()
        covariance = of_outline + self._best.covariance - self._best.outline_covariance
        known = self._best.at(position_m)  # spatial distance and clearance are to one tissue
        return replace(known, covariance=covariance, outline_covariance=of_outline)

    def _agrees(self, pose: TissuePose) -> bool:
        if self._best is None:
            return True
        position_m, covariance = self._place.now()
        offset_m = pose.position_m - position_m
        nis = offset_m @ np.linalg.solve(pose.outline_covariance + covariance + TINY_M2 * np.eye(3), offset_m)
        return bool(nis <= chi_square_bound(PLANE_DEGREES, GATE_Z))


def surface_by_stereo(frame: Frame, known: TissuePose) -> TissuePose | None:
    """The tissue with the surface that both views show, with its own errors; None where they do not agree on one."""
    surface, right = frame.scene.stereo_surface, frame.scene.observation.right
    if surface is None or right is None:
        return None
    std_m, within = surface.deviations_m(frame.left.camera, right, frame.arm.profile.camera_error), surface.is_within
    cloud = Cloud(surface.grid_m[within], std_m[within])  # also what is hidden between what is seen
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


def measure_height(prior: Tissue, known: TissuePose, frame: Frame, kalman: KinematicErrorFilter) -> GatingResult | None:
    """Update the filter with the tissue's height by stereo over the profile's plane; None where it is not seen."""
    surface, right = frame.scene.stereo_surface, frame.scene.observation.right
    if surface is None or right is None or known.dome is None:
        return None
    dome, above = known.dome, known.dome.above(surface.points_m)
    if len(above.over_m) < MIN_POINTS:
        return None
    at_m = np.median(surface.points_m[above.inner], 0)
    # Depth along the ray to height along the plane's normal: a larger disparity is nearer to the camera.
    along_normal = abs(float(dome.T_camera_tissue[:3, 2] @ at_m) / float(at_m[2]))
    by_depth = depth_biases(at_m, frame.left.camera, right, frame.arm.profile.camera_error)
    of_cameras = [replace(bias, jacobian=along_normal * bias.jacobian) for bias in by_depth]
    by_shape = dome.derivative(above.flat_m).mean(0)
    dome_std_m = float(np.sqrt(by_shape[2:] @ dome.covariance[2:, 2:] @ by_shape[2:]))
    bias_m = np.hypot(CORRELATED_HEIGHT_SHARE * surface.std_m, dome_std_m)
    own = BiasTerm("tissue height", np.array([[bias_m]]), HEIGHT_CORRELATION_TIME_S)
    noise_m2 = (1.0 - CORRELATED_HEIGHT_SHARE**2) * surface.std_m**2
    biases = (own, *detection.height_biases(prior, known.position_m), *of_cameras)
    over_m = np.array([median(above.over_m)])
    return kalman.update_scene(own.name, Linearised(over_m, np.zeros((1, 0)), biases, np.array([[noise_m2]])))


def at_height(prior: Tissue, known: TissuePose, frame: Frame, kalman: KinematicErrorFilter) -> tuple[TissuePose, Array]:
    """The tissue at the height found, with all its errors, and their covariance with the tool's pose, (6, 3)."""
    camera, of_camera = frame.left.camera, frame.arm.profile.camera_error
    plane, biases = detection.tissue_plane(prior), detection.height_biases(prior, known.position_m)
    offset_m = plane.offset_m + sum(float(bias.jacobian[0, 0]) * kalman.state.bias(bias.name) for bias in biases)
    scale = offset_m / plane.offset_m
    corrected = known.at(scale * known.position_m, scale)
    by_height = corrected.position_m[:, None] / offset_m
    by_ray = detection.ray_on_plane_biases(corrected.position_m, Plane(plane.normal, offset_m), camera, of_camera)
    along = (replace(bias, jacobian=by_height @ bias.jacobian) for bias in biases)
    covariance, cross_covariance = kalman.bias_covariances((*along, *by_ray))
    corrected = replace(corrected, covariance=corrected.outline_covariance + covariance)
    # What both views show, where the profile knows its shape no better, is taken as if its errors were not the tool's,
    # too, which makes their difference only wider.
    seen = surface_by_stereo(frame, corrected)
    return (corrected if seen is None or _has_surer_shape(prior, corrected, seen, frame) else seen), cross_covariance


def _has_surer_shape(tissue: Tissue, corrected: TissuePose, seen: TissuePose, frame: Frame) -> bool:
    """Whether the profile's shape is surer than a surface that is seen, and that one has it, at whatever height."""
    cloud, surface = seen.surface, frame.scene.stereo_surface
    assert isinstance(cloud, Cloud)
    if tissue.dome is None and tissue.mesh is None:
        return False
    away_m = float(np.median(np.linalg.norm(cloud.points_m - seen.position_m, axis=1)))
    dome_std_m = 0.0 if tissue.dome is None else tissue.dome.height_std_m
    std_m = float(np.linalg.norm([tissue.surface_std_m, dome_std_m, tissue.plane_tilt_std_rad * away_m]))
    if std_m >= np.hypot(median(cloud.std_m), seen.surface_std_m):
        return False
    if corrected.dome is None or surface is None:
        return True
    over_m = corrected.dome.above(surface.points_m).over_m
    if len(over_m) < MIN_POINTS:
        return True
    return scale_of(over_m - median(over_m)) < MAX_SHAPE_STDS * float(np.hypot(std_m, surface.std_m))
