"""`--method stereo`: both cameras. The tool by triangulation, the tissue as a cloud from matching and alignment."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.estimation.distances import measure
from svmdist.estimation.filter import KinematicErrorFilter
from svmdist.estimation.instrument_model import InstrumentModel
from svmdist.estimation.locate import locate_both
from svmdist.estimation.pose import ToolPose
from svmdist.estimation.robot_scene import Belief, belief_of, require_chain
from svmdist.estimation.rows import first_rows
from svmdist.estimation.tissue import TissueFix, require_tissue, see_tissue
from svmdist.geometry.surfaces import Cloud
from svmdist.profile import Profile
from svmdist.samples import Estimate, Image, Observation, RightView, Status
from svmdist.transforms import Array
from svmdist.vision.segmenter import Segmenter, make_segmenter
from svmdist.vision.stereo import DisparitySurface, fit_surface

NEAR_M, FAR_M = 0.04, 0.25
"""Working distance of an endoscope: bounds the disparities that are searched."""
CENTROID_STD_PX = 0.15
"""Of one instrument centroid in one image; measured 0.2 mm of depth at 88 mm, that is 0.07 px a pair."""
SURFACE_STD_PX = 0.12
"""What an aligned low-order surface leaves: measured 0.36 mm at 105 mm and a baseline of 5 mm."""
ROW_TOLERANCE_PX = 3.0
"""Corresponding points of rectified images lie on one row; the instrument's region is cut a little differently."""
GRID_STEP_PX = 5


class StereoEstimator:
    """One observation with both views in, one estimate out; keeps nothing between frames."""

    name = "stereo"

    def __init__(self, profile: Profile, segmenter: Segmenter | None = None) -> None:
        require_tissue(profile)
        self._profile = profile
        self._segmenter = segmenter or make_segmenter(profile.segmentation)
        self._chain = require_chain(profile)
        self._model = InstrumentModel.of(profile)

    def estimate(self, observation: Observation) -> Estimate:
        """Measure one frame; a frame that cannot be measured says why."""
        # Left view: tissue and instrument, as in every method.
        tissue, instrument = locate_both(
            self._segmenter.masks(observation.image_bgr), self._profile.segmentation
        )
        row = first_rows(observation.stamp_ns, tissue, instrument)
        if instrument is None or row.status is not Status.OK:
            return row
        right = observation.right
        if right is None or (problem := _unfit(observation, right)):
            return replace(row, status=Status.NO_STEREO, detail=problem if right else "no right view")

        # Right view: the instrument again, and its depth. Its direction is what the robot believes.
        belief = belief_of(observation, self._chain)
        if isinstance(belief, str):
            return replace(row, status=Status.NO_JOINTS, detail=belief)
        pose = self._triangulate(observation, right, instrument.centroid_px, belief)

        # The tissue's surface, and the distances.
        fix = self._tissue(observation, right)
        if pose is None or fix is None:
            what = "instrument" if pose is None else "tissue's surface"
            return replace(row, status=Status.NO_STEREO, detail=f"the views do not agree on the {what}")
        return measure(row, pose, fix, self._model, observation.joints)

    def _triangulate(
        self, observation: Observation, right: RightView, left_px: Array, belief: Belief
    ) -> ToolPose | None:
        _, instrument = locate_both(self._segmenter.masks(right.image_bgr), self._profile.segmentation)
        if instrument is None or abs(left_px[1] - instrument.centroid_px[1]) > ROW_TOLERANCE_PX:
            return None
        K, baseline_m = observation.camera.K, float(right.T_left_right[0, 3])
        offset_px = K[0, 2] - right.camera.K[0, 2]
        disparity_px = float(left_px[0] - instrument.centroid_px[0]) - offset_px
        if disparity_px <= K[0, 0] * baseline_m / FAR_M:
            return None
        p_camera_m, J = _reproject(left_px, disparity_px, K, baseline_m)
        # A filter that has seen nothing: believed kinematics, with the profile's uncertainty.
        kalman = KinematicErrorFilter(self._chain, self._profile.kinematic_error)
        kalman.predict(observation.stamp_ns, belief.q, belief.T_camera_base)
        believed = kalman.tool_pose()
        T_camera_tool, covariance = believed.T_camera_tool.copy(), np.zeros((6, 6))
        T_camera_tool[:3, 3] = p_camera_m
        # The disparity holds the errors of both centroids; it is not independent of the left one, but nearly.
        covariance[:3, :3] = J @ np.diag([1.0, 1.0, 2.0]) @ J.T * CENTROID_STD_PX**2
        covariance[3:, 3:] = believed.covariance[3:, 3:]
        return ToolPose(T_camera_tool, covariance, believed.axis)

    def _tissue(self, observation: Observation, right: RightView) -> TissueFix | None:
        """The origin by the outline on the profile's plane, as elsewhere; the surface by stereo."""
        sight = see_tissue(self._segmenter.masks(observation.image_bgr), self._profile, observation.camera)
        if sight is None or sight.fix is None:
            return None
        K, baseline_m = observation.camera.K, float(right.T_left_right[0, 3])
        mask, right_mask = (
            self._segmenter.masks(image).tissue for image in (observation.image_bgr, right.image_bgr)
        )
        bounds = (int(K[0, 0] * baseline_m / FAR_M), int(np.ceil(K[0, 0] * baseline_m / NEAR_M)))
        surface = fit_surface(_grey(observation.image_bgr), _grey(right.image_bgr), mask, right_mask, *bounds)
        if surface is None:
            return None
        points_m = _cloud(surface, sight.region.hull, K, baseline_m, mask.shape)
        depth_m = float(np.median(points_m[:, 2]))
        surface_std_m = depth_m**2 / (K[0, 0] * baseline_m) * SURFACE_STD_PX
        # The surface has its own error; the outline's is not part of a clearance.
        return replace(sight.fix, surface=Cloud(points_m), surface_std_m=surface_std_m)


def _cloud(
    surface: DisparitySurface, hull: NDArray[np.int32], K: Array, baseline_m: float, shape: tuple[int, ...]
) -> Array:
    """Points of the surface inside the tissue's hull, shape (n, 3), under the instrument too."""
    inside = np.zeros(shape[:2], np.uint8)
    cv2.fillConvexPoly(inside, np.asarray(hull, np.int32), 255)
    rows, columns = np.nonzero(inside[::GRID_STEP_PX, ::GRID_STEP_PX])
    points_px = np.stack([columns, rows], -1).astype(np.float64) * GRID_STEP_PX
    disparity_px = np.maximum(surface.at(points_px), K[0, 0] * baseline_m / FAR_M)
    depth_m = K[0, 0] * baseline_m / disparity_px
    x = (points_px[:, 0] - K[0, 2]) / K[0, 0]
    y = (points_px[:, 1] - K[1, 2]) / K[1, 1]
    return np.stack([x * depth_m, y * depth_m, depth_m], -1)


def _reproject(left_px: Array, disparity_px: float, K: Array, baseline_m: float) -> tuple[Array, Array]:
    """The point of a left pixel and a disparity, shape (3,) in m, and its Jacobian by (u, v, d), shape (3, 3)."""
    z = K[0, 0] * baseline_m / disparity_px
    x, y = (left_px[0] - K[0, 2]) / K[0, 0], (left_px[1] - K[1, 2]) / K[1, 1]
    point = np.array([x * z, y * z, z])
    J = np.zeros((3, 3))
    J[0, 0], J[1, 1] = z / K[0, 0], z / K[1, 1]
    J[:, 2] = -point / disparity_px
    return point, J


def _unfit(observation: Observation, right: RightView) -> str:
    """What is wrong with the pair: rows correspond without turn or distortion, the right camera to the right."""
    T, K, K_right = right.T_left_right, observation.camera.K, right.camera.K
    if not (np.allclose(T[:3, :3], np.eye(3), atol=1e-6) and np.allclose(T[1:3, 3], 0.0, atol=1e-6)):
        return "the pair is not rectified: the right camera is turned, or not beside the left one"
    if T[0, 3] <= 0.0:
        return "the right camera is not to the right of the left one: are the topics swapped?"
    if (
        not np.allclose(np.delete(K - K_right, 2, axis=1), 0.0, atol=1e-3)
        or abs(K[1, 2] - K_right[1, 2]) > 1e-3
    ):
        return "the pair is not rectified: focal lengths or rows of the principal points differ"
    if observation.camera.D.any() or right.camera.D.any():
        return "the pair is not rectified: the images are distorted"
    return ""


def _grey(image_bgr: Image) -> Image:
    return np.asarray(cv2.cvtColor(image_bgr, cv2.COLOR_BGR2GRAY), np.uint8)
