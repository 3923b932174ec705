"""What the network takes and gives, as the profile's `[segmentation]` says it."""

from __future__ import annotations

from pathlib import Path

from svmdist.profile import ClassRegion, OnnxSegmentation
from tools.segmentation_net.instruments import DISTAL, SHAFT, TISSUE
from tools.segmentation_net.scene import HEIGHT, MIDDLE, WIDTH


def network_rules(model: Path) -> OnnxSegmentation:
    """The profile's rules for a file of `tools.train_segmentation`."""
    return OnnxSegmentation(
        method="onnx",
        model=model,
        width_px=WIDTH,
        height_px=HEIGHT,
        channels="bgr",
        mean=(MIDDLE, MIDDLE, MIDDLE),
        scale=(1 / MIDDLE, 1 / MIDDLE, 1 / MIDDLE),
        tissue=ClassRegion(class_ids=(TISSUE,), min_area_px=2000, occlusion="outline"),
        instrument=ClassRegion(class_ids=(DISTAL,), min_area_px=50),
        shaft=ClassRegion(class_ids=(SHAFT,), min_area_px=200),
    )
