"""The tissue as `fused` follows it: its place by its outline, its height over the profile's plane by stereo."""

from __future__ import annotations

from dataclasses import replace

from svmdist.estimation.arm import Arm
from svmdist.estimation.filter.kinematic_error_filter import KinematicErrorFilter
from svmdist.estimation.frame import Frame
from svmdist.estimation.gate import GatingResult
from svmdist.estimation.tissue.dome_fit import fit_dome
from svmdist.estimation.tissue.height import OUTLINE, TissueHeight, by_constants, measured_height
from svmdist.estimation.tissue.pose import TissuePose, require_tissue, tissue_plane
from svmdist.estimation.tissue.tracking import TissueTracker
from svmdist.transforms import Array


class FollowedTissue:
    """The tissue between frames: a place that is averaged, a shape, and a height that the filter's state holds."""

    def __init__(self, arm: Arm) -> None:
        self._profile = arm.profile
        self._tissue = require_tissue(arm.profile)
        self._plane = tissue_plane(self._tissue)
        self._deviations = arm.deviations
        self._tracker = TissueTracker(arm.profile.settings.tissue)
        self._height: TissueHeight | None = None
        self._known: TissuePose | None = None

    def see(self, frame: Frame) -> TissuePose | None:
        """The tissue on the profile's plane after this frame, which may hide it."""
        tissue = frame.scene.tissue
        known = self._known = self._tracker.add(None if tissue is None else tissue.pose)
        if known is not None:
            self._height = TissueHeight.of(self._tissue, known.position_m)
        return known

    def measure_height(self, frame: Frame, kalman: KinematicErrorFilter) -> GatingResult | None:
        """Tell the filter how high stereo shows the tissue; None where it does not show it."""
        known, right, height = self._known, frame.scene.observation.right, self._height
        surface = None if known is None or known.dome is None or right is None else frame.scene.stereo_surface
        if known is None or known.dome is None or surface is None or right is None or height is None:
            return None
        settings = self._profile.settings
        found = measured_height(
            surface,
            known.dome,
            height,
            frame.left.camera,
            right,
            self._deviations,
            settings.stereo,
            settings.tissue,
        )
        if found is None:
            return None
        part, over_m = found
        result = kalman.update_scene(OUTLINE, part)
        if result.is_accepted and self._tracker.wants_shape and frame.scene.tissue is not None:
            self._fit_shape(frame, over_m)
        return result

    def placed(
        self, known: TissuePose, frame: Frame, kalman: KinematicErrorFilter
    ) -> tuple[TissuePose, Array]:
        """The tissue at the height found, with all its errors, and their covariance with the tool's pose, (6, 3)."""
        height = self._height
        assert height is not None  # a tissue is known
        height_m = height.in_m(kalman.constant("tissue plane"), kalman.constant("tissue motion"))
        offset_m = self._plane.offset_m + height_m
        placed = known.scaled(offset_m / self._plane.offset_m)
        plane = replace(self._plane, offset_m=offset_m)
        biases = by_constants(placed.position_m, plane, height, frame.left.camera, self._deviations)
        covariance, coupling = kalman.coupled(biases)
        return replace(placed, covariance=placed.own_covariance + covariance), coupling

    def _fit_shape(self, frame: Frame, over_m: float) -> None:
        """Apex and height of the dome by the surface, which is put down onto it: how high all of it is, is no shape."""
        surface, tissue = frame.scene.stereo_surface, frame.scene.tissue
        if surface is None or tissue is None or tissue.pose is None or tissue.pose.dome is None:
            return
        down = replace(surface, points_m=surface.points_m - over_m * self._plane.normal)
        dome = fit_dome(tissue.pose.dome, down)
        if dome is not None:
            self._tracker.add_shape(dome)
