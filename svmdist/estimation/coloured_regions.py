"""Coloured regions and dark shafts of an image with several instruments, and where nominal kinematics put each."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.estimation.instrument.error_model import nominal_tool
from svmdist.estimation.instrument.model import NECK_PER_RADIUS, WRIST_LENGTH_PER_RADIUS
from svmdist.estimation.region_tracking import Blob, Gaussian, NominalPlace
from svmdist.estimation.scene import Arm
from svmdist.kinematics.robot_state import RobotState
from svmdist.profile.robot import Instrument
from svmdist.profile.segmentation import AreaGate
from svmdist.results import Failure, ToolPose
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.colour import field_of_view
from svmdist.vision.instruments.find_instruments import SeenInstrument

# A tool's nominal depth is taken to be at least this, since its pixel diverges towards the camera
MIN_DEPTH_M = 0.02
RAY_COUNT = 12  # points along a shaft's expected axis at which the image is asked whether it is dark
RAY_SPAN = (1.25, 2.2)  # where along the axis they lie, over the distance from the region to the shaft's end
LIKELY_DARK = 0.85  # how much of the line where its shaft should be is dark, for the right instrument
UNLIKELY_DARK = 0.3  # the same for another instrument
MIN_RAY_FRACTION = 0.4  # a line of which less is inside the picture tells nothing
SHAFT_REACH = 2.5  # a dark pixel farther from an axis than so many radii is not that shaft's
GROWN_PX = 5  # side of the dilation of other masks: borders differ between detectors
TURN_STD_RAD, LEAST_LIKENESS = 0.3, -8.0  # of a shaft in the image against nominal kinematics
FRAGMENT_REACH = 2.5  # radii within which coloured fragments belong to an instrument's region


@dataclass(frozen=True)
class ShaftAxis:
    """A shaft in the image: the tool's pixel (2,), unit direction (2,) away from the tip, where it begins, radius."""

    tool_px: Array
    direction: Array
    begin_px: float
    radius_px: float


@dataclass(frozen=True)
class ColouredRegions:
    """The coloured parts of an image: mask and labels of all, shape (h, w), and the parts above the area gate."""

    mask: Image
    labels: NDArray[np.int32]
    blobs: Sequence[Blob]
    names: Sequence[int]
    fragments: Sequence[tuple[int, Blob]]

    @classmethod
    def of(cls, mask: Image, rule: AreaGate) -> ColouredRegions:
        """Find them in the mask of all instruments, shape (h, w)."""
        count, labels, stats, centres = cv2.connectedComponentsWithStats(mask, connectivity=8)
        areas = stats[:, cv2.CC_STAT_AREA]
        parts = [(at, Blob(np.asarray(centres[at]), float(areas[at]))) for at in range(1, count)]
        whole = [part for part in parts if part[1].area_px > rule.min_area_px]
        fragments = [part for part in parts if part[1].area_px <= rule.min_area_px]
        blobs = [blob for _, blob in whole]
        return cls(mask, np.asarray(labels, np.int32), blobs, [label for label, _ in whole], fragments)

    def without(self, index: int | None) -> Image:
        """Mask of everything coloured but one region and the fragments about it; of everything for None."""
        mine = np.zeros_like(self.mask)
        if index is not None:
            centre_px, reach_px = self.blobs[index].centre_px, FRAGMENT_REACH * self.blobs[index].radius_px
            near = [
                at for at, part in self.fragments if np.linalg.norm(part.centre_px - centre_px) < reach_px
            ]
            mine[np.isin(self.labels, [self.names[index], *near])] = 255
            mine &= self.mask
        rest = cv2.dilate(cv2.subtract(self.mask, mine), np.ones((GROWN_PX, GROWN_PX), np.uint8))
        return np.asarray(cv2.subtract(rest, mine), np.uint8)


@dataclass(frozen=True)
class DarkPixels:
    """The pixels that are as dark as a shaft, and what the endoscope shows; masks of shape (h, w)."""

    mask: Image
    view: Image

    @classmethod
    def of(cls, shafts: Image, black: Image | None) -> DarkPixels:
        """Find them in the mask of all shafts, shape (h, w), and that of what may be border beside them."""
        mask = np.asarray(cv2.medianBlur(shafts, 3), np.uint8)
        view = field_of_view(mask if black is None else np.asarray(mask | black))
        return cls(mask, view)

    def evidence(self, axis: ShaftAxis) -> float:
        """Log-likelihood ratio of a shaft being there against none, from a line along its axis."""
        along = np.linspace(*RAY_SPAN, RAY_COUNT) * axis.begin_px
        points = np.round(axis.tool_px + along[:, None] * axis.direction).astype(int)
        height, width = self.mask.shape
        inside = np.all((points >= 0) & (points < [width, height]), axis=1)
        x, y = points[inside].T
        seen = self.view[y, x] > 0
        if np.count_nonzero(seen) < MIN_RAY_FRACTION * RAY_COUNT:
            return 0.0
        dark = float(np.mean(self.mask[y[seen], x[seen]] > 0))
        yes, no = np.log(LIKELY_DARK / UNLIKELY_DARK), np.log((1 - LIKELY_DARK) / (1 - UNLIKELY_DARK))
        return float(dark * yes + (1.0 - dark) * no)

    def by_axis(self, axes: Sequence[ShaftAxis | None]) -> NDArray[np.int8]:
        """For every pixel the index of the axis that it is nearest to, shape (h, w); -1 where it is no shaft's."""
        owner = np.full(self.mask.shape, -1, np.int8)
        y, x = np.nonzero(self.mask)
        best = np.full(len(x), SHAFT_REACH)
        found = np.full(len(x), -1, np.int8)
        for index, axis in enumerate(axes):
            if axis is None:
                continue
            dx, dy = x - axis.tool_px[0], y - axis.tool_px[1]
            along = dx * axis.direction[0] + dy * axis.direction[1]
            across = np.abs(dx * axis.direction[1] - dy * axis.direction[0])
            distance = np.where(along > 0.0, across, np.hypot(dx, dy)) / axis.radius_px
            nearer = distance < best
            best[nearer], found[nearer] = distance[nearer], index
        owner[y, x] = found
        return owner


@dataclass(frozen=True)
class NominalInstrument:
    """The nominal pose of a tool in a camera's frame, and the instrument's sizes."""

    pose: ToolPose
    instrument: Instrument | None

    def moved(self, T_other_camera: Array) -> NominalInstrument:
        """The same in the frame of another camera beside this one; covariances stay as they are."""
        T, axis = T_other_camera @ self.pose.T_camera_tool, T_other_camera[:3, :3] @ self.pose.axis
        return replace(self, pose=replace(self.pose, T_camera_tool=T, axis=axis))

    def place(self, camera: Camera) -> NominalPlace:
        """Where the tool is in the image by nominal kinematics, to first order."""
        return self._place(self.pose.position_m, camera)

    def shaft_end(self, camera: Camera) -> NominalPlace:
        """Where the shaft ends, behind a straight wrist, in the same way."""
        sizes = self.instrument
        back_m = 0.0 if sizes is None else _end_behind_tool_m(sizes)
        return self._place(self.pose.position_m - back_m * self.pose.axis, camera)

    def likeness(self, seen: SeenInstrument, camera: Camera) -> float:
        """Log-likelihood, up to a constant, of a seen instrument's direction in the image, were it this one."""
        shaft = self.shaft_from(seen.end_px, 0.5 * seen.width_px, camera)
        back = seen.entry_px - seen.end_px
        if shaft is None or not back.any():
            return 0.0
        turn = float(shaft.direction @ back) / float(np.linalg.norm(back))
        return max(-0.5 * (float(np.arccos(np.clip(turn, -1.0, 1.0))) / TURN_STD_RAD) ** 2, LEAST_LIKENESS)

    def _place(self, at_m: Array, camera: Camera) -> NominalPlace:
        mean, J = camera.project_with_derivative(np.array([*at_m[:2], max(at_m[2], MIN_DEPTH_M)]))
        place = Gaussian(mean, J @ self.pose.position_covariance @ J.T)
        return NominalPlace(place, at_m, float(J[0, 0]))

    def shaft_from(self, tool_px: Array, region_radius_px: float, camera: Camera) -> ShaftAxis | None:
        """The shaft's axis in the image from the tool's pixel (2,), which needs no depth; None towards the camera."""
        if self.instrument is None:
            return None
        fx, fy = float(camera.K[0, 0]), float(camera.K[1, 1])
        back = -self.pose.axis
        slope = (back[:2] - back[2] * camera.rays(tool_px)[0, :2]) * [fx, fy]
        length = float(np.linalg.norm(slope))
        if length < 0.1 * fx:
            return None
        sizes = self.instrument
        px_per_m = region_radius_px / sizes.knuckle_radius_m
        begin_px = _end_behind_tool_m(sizes) * px_per_m * length / fx
        return ShaftAxis(tool_px, slope / length, begin_px, sizes.shaft_radius_m * px_per_m)


def _end_behind_tool_m(sizes: Instrument) -> float:
    end_m = sizes.shaft_end_m or NECK_PER_RADIUS * sizes.wrist_radius_m
    return WRIST_LENGTH_PER_RADIUS * sizes.wrist_radius_m + end_m


def nominal_instrument(arm: Arm, robot: RobotState | Failure) -> NominalInstrument | None:
    """The nominal pose of an instrument; None where the log tells none near the image."""
    if isinstance(robot, Failure) or robot.T_camera_base is None or arm.chain is None:
        return None
    tool = nominal_tool(arm.chain, arm.profile.kinematic_error, robot)
    return NominalInstrument(tool, arm.profile.instrument)
