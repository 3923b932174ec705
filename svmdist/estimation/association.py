"""Association: which coloured regions, dark pixels and shapes of an image belong to which instrument."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.estimation.entries import EntryAssociation, other_than
from svmdist.estimation.frame import Arm, Frame, Scene, View
from svmdist.estimation.instrument.model import SHAFT_END_PER_RADIUS, WRIST_LENGTH_PER_RADIUS
from svmdist.estimation.region_tracking import Blob, Gaussian, Identity, NominalPlace, RegionTracker
from svmdist.profile.robot import Instrument
from svmdist.profile.segmentation import AreaGate
from svmdist.results import Failure, ToolPose
from svmdist.samples import Image, Observation
from svmdist.transforms import Array
from svmdist.vision.colour import field_of_view
from svmdist.vision.instruments.find_instruments import SeenInstrument

PLACED_FRACTION = 0.05  # of the width: a hidden region less certain than this assigns no shaft
MIN_DEPTH_M = 0.02  # a tool's nominal depth is taken to be at least this, since its pixel diverges towards the camera
RAY_COUNT = 12  # points along a shaft's expected axis at which the image is asked whether it is dark
RAY_SPAN = (1.25, 2.2)  # where along the axis they lie, over the distance from the region to the shaft's end
LIKELY_DARK = 0.85  # how much of the line where its shaft should be is dark, for the right instrument
UNLIKELY_DARK = 0.3  # the same for another instrument
MIN_RAY_FRACTION = 0.4  # a line of which less is inside the picture is not used
SHAFT_REACH = 2.5  # a dark pixel farther from an axis than so many radii is not that shaft's
GROWN_PX = 5  # side of the dilation of other masks: borders differ between detectors
TURN_STD_RAD, LEAST_LIKENESS = 0.3, -8.0  # of a shaft in the image against nominal kinematics
BESIDE_STD = 0.03  # over the width, by which nominal places are off by more in one view than in the other
UNPLACED = "no joints with transforms from camera to base say where one is"
FRAGMENT_REACH = 2.5  # radii within which coloured fragments belong to an instrument's region


class Association:
    """Tells the instruments of a recording apart; keeps their tracks between images."""

    def __init__(self, arms: Sequence[Arm]) -> None:
        self._arms = tuple(arms)
        self._gate = arms[0].profile.segmentation.instrument
        self._settings = arms[0].profile.settings.association
        self._trackers: dict[str, RegionTracker] = {}
        self._entries = EntryAssociation(arms)

    def frames(self, scene: Scene, observations: Sequence[Observation]) -> list[Frame]:
        """The frame of each instrument, with the others' pixels marked; `observations` are one per instrument."""
        frames = [Frame.of(scene, *one) for one in zip(self._arms, observations, strict=True)]
        seen, unclear = scene.left.masks.seen, [""] * len(frames)
        is_placed = not all(isinstance(frame.robot_in_camera, Failure) for frame in frames)
        if seen is not None and not is_placed:
            unclear = self._entries.mark_others(scene, frames)
        elif len(frames) > 1 or (seen is not None and len(seen) > 1):
            offsets = self._mark_others("left", frames, [frame.left for frame in frames], [None] * len(frames))
            if scene.right is not None:
                self._mark_others("right", frames, [frame.right for frame in frames if frame.right], offsets)
            if seen is None and not is_placed:
                names = [arm.profile.instrument_name for arm in self._arms]
                unclear = [f"cannot tell which instrument is {name}: {UNPLACED}" for name in names]
        return [replace(frame, ambiguity=why) for frame, why in zip(frames, unclear, strict=True)]

    def _mark_others(
        self, name: str, frames: Sequence[Frame], views: Sequence[View], offsets: Sequence[Array | None]
    ) -> list[Array | None]:
        """Mark in each instrument's view the coloured and dark pixels that are not its own.

        Gives by how much it is seen off its nominal place, (2,) in px, None where it is not named. `offsets` are those
        of another view, which sees the same robot's error.
        """
        context, nominal = views[0].context, [nominal_in(*one) for one in zip(frames, views, strict=True)]
        height, width = context.bgr_as_recorded.shape[:2]
        tracker = self._trackers.setdefault(name, RegionTracker(len(nominal), width, height, self._settings))
        seen, shafts, dark = context.masks.seen, context.masks.shaft, None
        if seen is not None:
            blobs = [Blob(one.end_px, 0.25 * np.pi * one.width_px**2) for one in seen]
        else:
            regions = ColouredRegions(context.masks.instrument, self._gate)
            blobs = regions.blobs
            dark = None if shafts is None else DarkPixels(shafts, context.masks.black)

        # Whose the regions are: by where they are expected, by whose shaft is behind them, and by another view.
        places: list[NominalPlace | None] = [None] * len(nominal)
        evidence = np.zeros((len(nominal), len(blobs)))
        for i, tool in enumerate(nominal):
            if tool is None:
                continue
            place = places[i] = tool.place(0.0 if seen is None else tool.end_behind_m)
            for a, blob in enumerate(blobs):
                if seen is not None:
                    evidence[i, a] = tool.likeness(seen[a])
                elif dark is not None and (axis := tool.shaft_from(blob.centre_px, blob.radius_px)) is not None:
                    evidence[i, a] = dark.evidence(axis)
                if (offset := offsets[i]) is not None:
                    off_px = blob.centre_px - place.place.mean - offset
                    square = (off_px**2).sum() / (BESIDE_STD * width) ** 2
                    evidence[i, a] += max(-0.5 * square, LEAST_LIKENESS)
        identities = tracker.update(frames[0].stamp_ns, places, blobs, evidence)

        # What is not one's own: the other regions or shapes, and the pixels of the other shafts.
        axes = [_axis(tool, own, blobs) for tool, own in zip(nominal, identities, strict=True)]
        owner = None if dark is None else dark.by_axis(axes)
        for i, (view, own) in enumerate(zip(views, identities, strict=True)):
            if seen is not None:
                view.others = other_than(own.blob, seen)
                continue
            view.others = mask = regions.without(own.blob)
            if owner is not None and shafts is not None:
                mask[(owner >= 0) & (owner != i)] = 255
                is_open = None in nominal and axes.count(None) > 1  # whose the other shafts are, nothing tells
                if is_open and axes[i] is None and own.blob is None:
                    mask[shafts > 0] = 255
        return [
            None if place is None or own.blob is None else blobs[own.blob].centre_px - place.place.mean
            for own, place in zip(identities, places, strict=True)
        ]


@dataclass(frozen=True)
class ShaftAxis:
    """A shaft in the image: the tool's pixel (2,), unit direction (2,) away from the tip, where it begins, radius."""

    tool_px: Array
    direction: Array
    begin_px: float
    radius_px: float


class ColouredRegions:
    """The coloured parts of a mask of all instruments, shape (h, w); `blobs` are those above the area gate."""

    def __init__(self, mask: Image, rule: AreaGate) -> None:
        count, labels, stats, centres = cv2.connectedComponentsWithStats(mask, connectivity=8)
        areas = stats[:, cv2.CC_STAT_AREA]
        parts = {at: Blob(np.asarray(centres[at]), float(areas[at])) for at in range(1, count)}
        self._mask, self._labels = mask, np.asarray(labels)
        self._whole = [at for at, part in parts.items() if part.area_px > rule.min_area_px]
        self.blobs = [parts.pop(at) for at in self._whole]
        self._fragments = parts

    def without(self, index: int | None) -> Image:
        """Mask of everything coloured but one region and the fragments about it; of everything for None."""
        mine = np.zeros_like(self._mask)
        if index is not None:
            own_px, reach_px = self.blobs[index].centre_px, FRAGMENT_REACH * self.blobs[index].radius_px
            near = [at for at, part in self._fragments.items() if np.linalg.norm(part.centre_px - own_px) < reach_px]
            mine[np.isin(self._labels, [self._whole[index], *near])] = 255
            mine &= self._mask
        rest = cv2.dilate(cv2.subtract(self._mask, mine), np.ones((GROWN_PX, GROWN_PX), np.uint8))
        return np.asarray(cv2.subtract(rest, mine), np.uint8)


class DarkPixels:
    """The pixels that are as dark as a shaft; by the masks, shape (h, w), of all shafts and of what may be border."""

    def __init__(self, shafts: Image, black: Image | None) -> None:
        self._mask = np.asarray(cv2.medianBlur(shafts, 3), np.uint8)
        self._view = field_of_view(self._mask if black is None else np.asarray(self._mask | black))

    def evidence(self, axis: ShaftAxis) -> float:
        """Log-likelihood ratio of a shaft being there against none, from a line along its axis."""
        along = np.linspace(*RAY_SPAN, RAY_COUNT) * axis.begin_px
        points = np.round(axis.tool_px + along[:, None] * axis.direction).astype(int)
        height, width = self._mask.shape
        inside = np.all((points >= 0) & (points < [width, height]), axis=1)
        x, y = points[inside].T
        seen = self._view[y, x] > 0
        if np.count_nonzero(seen) < MIN_RAY_FRACTION * RAY_COUNT:
            return 0.0
        dark = float(np.mean(self._mask[y[seen], x[seen]] > 0))
        yes, no = np.log(LIKELY_DARK / UNLIKELY_DARK), np.log((1 - LIKELY_DARK) / (1 - UNLIKELY_DARK))
        return float(dark * yes + (1.0 - dark) * no)

    def by_axis(self, axes: Sequence[ShaftAxis | None]) -> NDArray[np.int8]:
        """For every pixel the index of the axis that it is nearest to, shape (h, w); -1 where it is no shaft's."""
        owner = np.full(self._mask.shape, -1, np.int8)
        y, x = np.nonzero(self._mask)
        radii = np.full((len(axes), len(x)), np.inf)  # how far from each axis
        for at, axis in enumerate(axes):
            if axis is not None:
                dx, dy = x - axis.tool_px[0], y - axis.tool_px[1]
                along = dx * axis.direction[0] + dy * axis.direction[1]
                across = np.abs(dx * axis.direction[1] - dy * axis.direction[0])
                radii[at] = np.where(along > 0.0, across, np.hypot(dx, dy)) / axis.radius_px
        owner[y, x] = np.where(radii.min(0) < SHAFT_REACH, radii.argmin(0), -1)
        return owner


def nominal_in(frame: Frame, view: View) -> NominalInstrument | None:
    """The instrument in a view; None where the log has no nominal pose near the image."""
    robot = frame.robot
    if isinstance(robot, Failure) or robot.T_camera_base is None:
        return None
    tool = frame.arm.nominal_tool(replace(robot, T_camera_base=view.T_view_left @ robot.T_camera_base))
    return NominalInstrument(tool, frame.arm.profile.instrument, view.camera)


@dataclass(frozen=True)
class NominalInstrument:
    """The nominal pose of a tool in a camera's frame, the instrument's sizes, and the camera."""

    pose: ToolPose
    instrument: Instrument | None
    camera: Camera

    @property
    def end_behind_m(self) -> float:
        """How far behind the tool the shaft of a straight wrist ends."""
        if (sizes := self.instrument) is None:
            return 0.0
        end_m = sizes.shaft_end_m or SHAFT_END_PER_RADIUS * sizes.wrist_radius_m
        return WRIST_LENGTH_PER_RADIUS * sizes.wrist_radius_m + end_m

    def place(self, behind_m: float) -> NominalPlace:
        """Where what is so far behind the tool is in the image by nominal kinematics, to first order."""
        at_m = self.pose.position_m - behind_m * self.pose.axis
        mean, J = self.camera.project_with_derivative(np.array([*at_m[:2], max(at_m[2], MIN_DEPTH_M)]))
        return NominalPlace(Gaussian(mean, J @ self.pose.position_covariance @ J.T), at_m, float(J[0, 0]))

    def likeness(self, seen: SeenInstrument) -> float:
        """Log-likelihood, up to a constant, of a seen instrument's direction in the image, were it this one."""
        shaft, back = self.shaft_from(seen.end_px, 0.5 * seen.width_px), seen.entry_px - seen.end_px
        if shaft is None or not back.any():
            return 0.0
        turn = float(shaft.direction @ back) / float(np.linalg.norm(back))
        return max(-0.5 * (float(np.arccos(np.clip(turn, -1.0, 1.0))) / TURN_STD_RAD) ** 2, LEAST_LIKENESS)

    def shaft_from(self, tool_px: Array, region_radius_px: float) -> ShaftAxis | None:
        """The shaft's axis in the image from the tool's pixel (2,), which needs no depth; None towards the camera."""
        sizes, K, back = self.instrument, self.camera.K, -self.pose.axis
        if sizes is None:
            return None
        slope = (back[:2] - back[2] * self.camera.rays(tool_px)[0, :2]) * np.diag(K)[:2]
        length = float(np.linalg.norm(slope))
        if length < 0.1 * K[0, 0]:
            return None
        px_per_m = region_radius_px / sizes.knuckle_radius_m
        begin_px = self.end_behind_m * px_per_m * length / float(K[0, 0])
        return ShaftAxis(tool_px, slope / length, begin_px, sizes.shaft_radius_m * px_per_m)


def _axis(tool: NominalInstrument | None, identity: Identity, blobs: Sequence[Blob]) -> ShaftAxis | None:
    """The shaft behind an instrument's region, or behind where a hidden one surely is."""
    if tool is None:
        return None
    expected, radius_px = identity.expected, identity.radius_px
    if identity.blob is not None:
        blob = blobs[identity.blob]
        return tool.shaft_from(blob.centre_px, blob.radius_px)
    if expected is None or radius_px is None or expected.std_px > PLACED_FRACTION * tool.camera.width_px:
        return None
    return tool.shaft_from(expected.mean, radius_px)
