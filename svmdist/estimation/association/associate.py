"""Association: which coloured regions and dark pixels of an image belong to which instrument.

Coloured regions go to the instruments by `tracker.py`. A dark pixel goes to the shaft whose axis is nearer. Where the
region is, and which way the nominal shaft points, tell where the axis runs in the image.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.arm import Arm
from svmdist.estimation.association.entries import EntryTracker
from svmdist.estimation.association.nominal import NominalInstrument, nominal_instrument
from svmdist.estimation.association.regions import ColouredRegions, DarkPixels, ShaftAxis
from svmdist.estimation.association.tracker import Identity, RegionTracker
from svmdist.estimation.detection.scene import Scene
from svmdist.estimation.frame import Frame, OtherMasks, frames_of
from svmdist.kinematics.robot_state import RobotState
from svmdist.results import Failure
from svmdist.samples import Image, Observation
from svmdist.transforms import inverse
from svmdist.vision.frame_context import FrameContext


class Association:
    """Tells the instruments of a recording apart; keeps their tracks between images."""

    def __init__(self, arms: Sequence[Arm]) -> None:
        self._arms = tuple(arms)
        self._gate = arms[0].profile.segmentation.instrument
        self._settings = arms[0].profile.settings.association
        self._trackers: dict[str, RegionTracker] = {}
        self._entries: dict[str, EntryTracker] = {}

    def frames(self, scene: Scene, observations: Sequence[Observation]) -> list[Frame]:
        """The frame of each instrument, with the others' pixels marked; `observations` are one per instrument."""
        robots = [arm.state_at(seen) for arm, seen in zip(self._arms, observations, strict=True)]
        nominal = [nominal_instrument(arm, robot) for arm, robot in zip(self._arms, robots, strict=True)]
        if scene.left.masks.seen is not None and not any(nominal):
            return self._by_entries(scene, observations, robots)
        others: Sequence[OtherMasks] = [(None, None)]
        if len(self._arms) > 1:
            others = self._others(scene, nominal)
        return frames_of(scene, self._arms, observations, robots, others)

    def _by_entries(
        self, scene: Scene, observations: Sequence[Observation], robots: Sequence[RobotState | Failure]
    ) -> list[Frame]:
        """Where no robot tells where its instrument is: by the sides they come in from."""
        left, doubts = self._named("left", scene.observation.stamp_ns, scene.left)
        right: list[Image | None] = [None] * len(self._arms)
        if scene.right is not None:
            right, right_doubts = self._named("right", scene.observation.stamp_ns, scene.right)
            doubts = [doubt or other for doubt, other in zip(doubts, right_doubts, strict=True)]
        others = list(zip(left, right, strict=True))
        return frames_of(scene, self._arms, observations, robots, others, doubts)

    def _named(self, name: str, stamp_ns: int, context: FrameContext) -> tuple[list[Image | None], list[str]]:
        """For each instrument the mask, shape (h, w), of the others seen, and why its name is in doubt."""
        seen = context.masks.seen or ()
        if name not in self._entries:
            profiles = [arm.profile for arm in self._arms]
            names, sides = [one.instrument_name for one in profiles], [one.entry for one in profiles]
            self._entries[name] = EntryTracker(names, sides, context.shape, self._settings)
        masks: list[Image | None] = []
        doubts = []
        for named in self._entries[name].update(stamp_ns, seen):
            rest = [one.mask for at, one in enumerate(seen) if at != named.seen]
            others = np.zeros(context.shape, np.uint8)
            for mask in rest:
                others |= mask
            if named.seen is not None:
                others &= ~seen[named.seen].mask
            masks.append(others if rest else None)
            doubts.append(named.doubt)
        return masks, doubts

    def identities(self, camera: str = "left") -> tuple[Identity, ...]:
        """Which region was which instrument's in the latest image of a camera, `left` or `right`."""
        return self._trackers[camera].identities

    def _others(self, scene: Scene, nominal: Sequence[NominalInstrument | None]) -> list[OtherMasks]:
        seen = scene.observation
        left = self._other_masks("left", seen.stamp_ns, scene.left, seen.camera, nominal)
        if seen.right is None or scene.right is None:
            return [(mask, None) for mask in left]
        T_right_left = inverse(seen.right.T_left_right)
        beside = [tool.moved(T_right_left) if tool else None for tool in nominal]
        right = self._other_masks("right", seen.stamp_ns, scene.right, seen.right.camera, beside)
        return list(zip(left, right, strict=True))

    def _other_masks(
        self,
        name: str,
        stamp_ns: int,
        context: FrameContext,
        camera: Camera,
        nominal: Sequence[NominalInstrument | None],
    ) -> list[Image]:
        """For each instrument the mask, shape (h, w), of coloured and dark pixels that are not its own."""
        height, width = context.shape
        tracker = self._trackers.setdefault(name, RegionTracker(len(nominal), width, height, self._settings))
        regions = ColouredRegions.of(context.masks.instrument, self._gate, self._settings)
        shafts = context.masks.shaft
        dark = None if shafts is None else DarkPixels.of(shafts, context.masks.black, self._settings)

        # Whose the regions are, by where they are expected and by whose shaft is behind them.
        evidence = np.zeros((len(nominal), len(regions.blobs)))
        for i, tool in enumerate(nominal):
            for a, blob in enumerate(regions.blobs):
                axis = tool.shaft_from(blob.centre_px, blob.radius_px, camera) if tool else None
                if axis is not None and dark is not None:
                    evidence[i, a] = dark.evidence(axis)
        places = [tool.place(camera) if tool else None for tool in nominal]
        identities = tracker.update(stamp_ns, places, regions.blobs, evidence)

        # What is not one's own: the other regions, and the pixels of the other shafts.
        masks = [regions.without(identity.blob) for identity in identities]
        if dark is not None:
            axes = [
                self._axis(tool, identity, regions, camera)
                for tool, identity in zip(nominal, identities, strict=True)
            ]
            owner = dark.by_axis(axes)
            masks = [
                np.where((owner >= 0) & (owner != i), 255, mask).astype(np.uint8)
                for i, mask in enumerate(masks)
            ]
        return masks

    def _axis(
        self, tool: NominalInstrument | None, identity: Identity, regions: ColouredRegions, camera: Camera
    ) -> ShaftAxis | None:
        """Where the shaft of an instrument runs: from its region, or from where that is expected."""
        if tool is None:
            return None
        if identity.blob is not None:
            blob = regions.blobs[identity.blob]
            return tool.shaft_from(blob.centre_px, blob.radius_px, camera)
        expected = identity.expected
        if expected is None or identity.radius_px is None:
            return None
        if expected.std_px > self._settings.placed_fraction * camera.width_px:
            return None
        return tool.shaft_from(expected.mean, identity.radius_px, camera)
