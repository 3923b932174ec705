"""The first steps that the paper's estimators share: where tissue and instrument are in the image."""

from __future__ import annotations

from svmdist.profile import Segmentation
from svmdist.samples import Image
from svmdist.vision.regions import Region, find_region
from svmdist.vision.segmentation import colour_mask, to_hsv


def locate_tissue(image_hsv: Image, segmentation: Segmentation) -> Region | None:
    """First loop: the tissue's region, if larger than its gate of 50 px (eqs. 1, 2)."""
    return find_region(colour_mask(image_hsv, segmentation.tissue), segmentation.tissue)


def locate_instrument(image_hsv: Image, segmentation: Segmentation) -> Region | None:
    """Second loop: the instrument's region, if larger than its gate of 100 px (eqs. 7, 8)."""
    return find_region(colour_mask(image_hsv, segmentation.instrument), segmentation.instrument)


def locate_both(image_bgr: Image, segmentation: Segmentation) -> tuple[Region | None, Region | None]:
    """Tissue and instrument of one image."""
    image_hsv = to_hsv(image_bgr)
    return locate_tissue(image_hsv, segmentation), locate_instrument(image_hsv, segmentation)
