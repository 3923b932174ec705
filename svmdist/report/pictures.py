"""Pictures of what the methods see: one panel for each thing that can be shown, side by side in one image."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

from svmdist.errors import OutputError
from svmdist.files import atomic_file
from svmdist.report.canvas import Canvas
from svmdist.report.masks_panel import masks_panel
from svmdist.report.text import printable
from svmdist.samples import Image
from svmdist.workflows.show import ShownFrame

PANELS = {"masks": masks_panel}
"""What can be shown, by the name of its option: each draws one frame on a canvas of its image."""


def picture_of(frame: ShownFrame, panels: Sequence[str], log: str) -> Image:
    """The named panels of a frame side by side, shape (h, w, 3) in BGR, under a line that says what it is."""
    drawn = []
    for name in panels:
        canvas = Canvas.of(frame.scene.observation.image_bgr)
        remarks = PANELS[name](frame, canvas)
        title = f"{printable(log)}  frame {frame.number}  {frame.seconds:.2f} s  {name}"
        drawn.append(canvas.with_caption([title, *remarks]))
    height = max(panel.shape[0] for panel in drawn)
    padded = [
        cv2.copyMakeBorder(panel, 0, height - panel.shape[0], 0, 0, cv2.BORDER_CONSTANT) for panel in drawn
    ]
    return np.ascontiguousarray(np.hstack(padded), np.uint8)


def write_picture(path: Path, picture: Image) -> None:
    """Write a PNG; raises OutputError where that fails."""
    good, encoded = cv2.imencode(".png", picture)
    if not good:
        raise OutputError(f"{path}: cannot write: OpenCV cannot encode {picture.shape} as PNG")
    with atomic_file(path) as target:
        target.write_bytes(encoded.tobytes())
