"""The first steps that the paper's estimators share: where tissue and instrument are in the image."""

from __future__ import annotations

from svmdist.profile import Segmentation
from svmdist.vision.regions import Region, find_region
from svmdist.vision.segmentation.segmenter import Masks


def locate_tissue(masks: Masks, segmentation: Segmentation) -> Region | None:
    """First loop: the tissue's region, if larger than its gate of 50 px (eqs. 1, 2)."""
    return find_region(masks.tissue, segmentation.tissue)


def locate_instrument(masks: Masks, segmentation: Segmentation) -> Region | None:
    """Second loop: the instrument's region, if larger than its gate of 100 px (eqs. 7, 8)."""
    return find_region(masks.instrument, segmentation.instrument)


def locate_both(masks: Masks, segmentation: Segmentation) -> tuple[Region | None, Region | None]:
    """Tissue and instrument of one image."""
    return locate_tissue(masks, segmentation), locate_instrument(masks, segmentation)
