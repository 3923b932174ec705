"""The instruments of one image told apart: each estimator gets the image with what is not its own marked.

The coloured regions go to the instruments by `tracker.py`. A dark pixel goes to the shaft whose axis is nearer: where
the region is, and which way the robot believes its shaft to point, tell where the axis runs in the image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.identity.belief import ArmBelief, InstrumentBelief
from svmdist.estimation.identity.regions import ColouredRegions, DarkPixels, ShaftAxis
from svmdist.estimation.identity.tracker import Identity, IdentityTracker
from svmdist.profile import Profile
from svmdist.samples import Image, Observation
from svmdist.transforms import inverse
from svmdist.vision.segmentation.segmenter import Segmenter, make_segmenter

PLACED_FRACTION = 0.05
"""Where a hidden region is expected no surer than this, over the image's width, its shaft is nowhere."""


class Instruments:
    """Tells the instruments of a recording apart; keeps their tracks between images."""

    def __init__(self, profiles: Sequence[Profile], segmenter: Segmenter | None = None) -> None:
        self._gate = profiles[0].segmentation.instrument
        self._segmenter = segmenter or make_segmenter(profiles[0].segmentation)
        self._beliefs = [InstrumentBelief(profile) for profile in profiles]
        self._trackers: dict[str, IdentityTracker] = {}

    def tell_apart(self, observations: Sequence[Observation]) -> tuple[Observation, ...]:
        """The same observations of one image, one an instrument, each with the others' pixels marked as foreign."""
        if len(observations) < 2:
            return tuple(observations)
        first = observations[0]
        arms = [belief.of(o) for belief, o in zip(self._beliefs, observations, strict=True)]
        foreign = self._foreign("left", first.stamp_ns, first.image_bgr, first.camera, arms)
        told = [replace(o, foreign=mask) for o, mask in zip(observations, foreign, strict=True)]
        right = first.right
        if right is not None:
            T_right_left = inverse(right.T_left_right)
            beside = [arm.moved(T_right_left) if arm else None for arm in arms]
            masks = self._foreign("right", first.stamp_ns, right.image_bgr, right.camera, beside)
            told = [replace(o, right=replace(right, foreign=m)) for o, m in zip(told, masks, strict=True)]
        return tuple(told)

    def identities(self, eye: str = "left") -> tuple[Identity, ...]:
        """Who was who in the latest image of a camera, `left` or `right`."""
        return self._trackers[eye].identities

    def _foreign(
        self, eye: str, stamp_ns: int, image_bgr: Image, camera: Camera, arms: Sequence[ArmBelief | None]
    ) -> list[Image]:
        """For each instrument the mask, shape (h, w), of coloured and dark pixels that are not its own."""
        height, width = image_bgr.shape[:2]
        tracker = self._trackers.setdefault(eye, IdentityTracker(len(arms), width, height))
        seen = self._segmenter.masks(image_bgr)
        regions = ColouredRegions.of(seen.instrument, self._gate)
        dark = None if seen.shaft is None else DarkPixels.of(seen.shaft, seen.black)

        # Whose the regions are, by where they are expected and by whose shaft is behind them.
        evidence = np.zeros((len(arms), len(regions.blobs)))
        for i, arm in enumerate(arms):
            for a, blob in enumerate(regions.blobs):
                axis = arm.shaft_from(blob.centre_px, blob.radius_px, camera) if arm else None
                if axis is not None and dark is not None:
                    evidence[i, a] = dark.evidence(axis)
        beliefs = [arm.place(camera) if arm else None for arm in arms]
        identities = tracker.update(stamp_ns, beliefs, regions.blobs, evidence)

        # What is not one's own: the other regions, and the pixels of the other shafts.
        masks = [regions.without(identity.blob) for identity in identities]
        if dark is not None:
            axes = [
                _axis(arm, identity, regions, camera) for arm, identity in zip(arms, identities, strict=True)
            ]
            owner = dark.by_axis(axes)
            masks = [
                np.where((owner >= 0) & (owner != i), 255, mask).astype(np.uint8)
                for i, mask in enumerate(masks)
            ]
        return masks


def _axis(
    arm: ArmBelief | None, identity: Identity, regions: ColouredRegions, camera: Camera
) -> ShaftAxis | None:
    """Where the shaft of an instrument runs: from its region, or from where that is expected."""
    if arm is None:
        return None
    if identity.blob is not None:
        blob = regions.blobs[identity.blob]
        return arm.shaft_from(blob.centre_px, blob.radius_px, camera)
    expected = identity.expected
    if expected is None or identity.radius_px is None or expected.std_px > PLACED_FRACTION * camera.width_px:
        return None
    return arm.shaft_from(expected.mean, identity.radius_px, camera)
