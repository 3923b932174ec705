"""Overlap of masks: what two have in common over what either has."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from training.instruments import DISTAL, Labels


def iou(found: NDArray[np.bool_], truth: NDArray[np.bool_]) -> float:
    """Intersection over union of two masks of one shape; 1 of two that are empty."""
    either = int((found | truth).sum())
    return float((found & truth).sum()) / either if either else 1.0


def union_ious(found: NDArray[np.uint8], labels: Labels) -> NDArray[np.float64]:
    """Overlap of the union of instruments over what either has, of each picture that has an instrument."""
    pairs = zip(found >= DISTAL, labels >= DISTAL, strict=True)
    return np.array([iou(one, two) for one, two in pairs if two.any()], np.float64)
