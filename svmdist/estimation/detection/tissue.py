"""The tissue in an image: its region, its completed outline, and its pose on the plane."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from svmdist.camera import Camera
from svmdist.estimation.tissue.pose import TissuePose, require_tissue, tissue_pose
from svmdist.profile import AreaGate, Profile
from svmdist.profile.settings import OutlineSettings
from svmdist.samples import Image
from svmdist.vision.completion import CompletedOutline, complete_outline
from svmdist.vision.regions import Region, find_region
from svmdist.vision.segmentation.segmenter import Masks

RING_PX = 3
"""What lies this close to a part surrounds it."""


@dataclass(frozen=True, slots=True)
class TissueDetection:
    """What an image shows of the tissue; `pose` is None where the outline's rays do not meet the plane."""

    region: Region
    outline: CompletedOutline
    pose: TissuePose | None


def detect_tissue(masks: Masks, profile: Profile, camera: Camera) -> TissueDetection | None:
    """Find the tissue in an image's masks and place it in 3D; None where no region passes the gate.

    Raises ProfileError where the profile knows no plane.
    """
    tissue = require_tissue(profile)
    # The region's own centroid would complete the outline a first time.
    rule = profile.segmentation.tissue.model_copy(update={"occlusion": "hull"})
    mask, settings = masks.tissue, profile.settings.outline
    region = find_region(mask, rule, settings)
    if region is not None and region.part_count > 1 and masks.shaft is not None:
        mask = _without_blood(mask, masks.shaft, region.area_px, settings)
        region = find_region(mask, rule, settings)
    if region is None:
        return None
    outline = complete_outline(mask, region.hull, settings)
    if region.part_count > 1:
        outline = _with_doubt(outline, mask, rule, settings)
    return TissueDetection(region, outline, tissue_pose(outline, camera, tissue, profile.camera_error))


def _with_doubt(
    outline: CompletedOutline, mask: Image, rule: AreaGate, settings: OutlineSettings
) -> CompletedOutline:
    """The outline, as uncertain as its centroid depends on whether the smaller parts belong to it."""
    largest = find_region(mask, rule.model_copy(update={"components": "largest"}), settings)
    if largest is None:
        return outline
    off_px = complete_outline(mask, largest.hull, settings).centroid_px - outline.centroid_px
    return replace(outline, covariance_px2=outline.covariance_px2 + np.outer(off_px, off_px))


def _without_blood(mask: Image, shaft: Image, area_px: int, settings: OutlineSettings) -> Image:
    """The mask, shape (h, w), without small parts that the instrument's dark shaft surrounds.

    Blood on an instrument is as red as tissue, and far from it. What an instrument cuts off the tissue has the shaft on
    one side only.
    """
    count, labels, statistics, _ = cv2.connectedComponentsWithStats(mask, connectivity=8)
    kept = mask.copy()
    for label in range(1, count):
        x, y, width, height, size_px = statistics[label]
        if size_px > settings.blood_fraction * area_px:
            continue
        box = np.s_[max(0, y - RING_PX) : y + height + RING_PX, max(0, x - RING_PX) : x + width + RING_PX]
        part = (labels[box] == label).astype(np.uint8)
        ring = cv2.dilate(part, np.ones((2 * RING_PX + 1, 2 * RING_PX + 1), np.uint8)) - part
        on_shaft = np.count_nonzero(ring & (shaft[box] > 0))
        if on_shaft > settings.blood_ring_fraction * np.count_nonzero(ring):
            kept[box][part > 0] = 0
    return kept
