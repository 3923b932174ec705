"""The panel of masks: what was segmented as tissue, shaft, distal part and border."""

from __future__ import annotations

import cv2
import numpy as np

from svmdist.report.canvas import Canvas, Colour
from svmdist.report.text import printable
from svmdist.vision.segmentation.segmenter import Masks
from svmdist.workflows.show import ShownFrame

TISSUE: Colour = (120, 220, 120)
SHAFT: Colour = (255, 190, 60)
DISTAL: Colour = (90, 160, 255)
BORDER: Colour = (160, 160, 160)
EDGE: Colour = (0, 255, 255)
TIP: Colour = (255, 120, 255)


def masks_panel(frame: ShownFrame, canvas: Canvas) -> list[tuple[str, Colour] | str]:
    """Draw the masks of a frame at normalised exposure; the lines below say what has which colour, and how much."""
    masks = frame.scene.left.masks
    height, width = frame.scene.left.shape
    parts = [
        ("tissue", TISSUE, masks.tissue),
        ("shaft", SHAFT, masks.shaft),
        ("distal part", DISTAL, masks.instrument),
    ]
    lines: list[tuple[str, Colour] | str] = []
    for name, colour, mask in parts:
        if mask is None:
            lines.append((f"{name}: not in the profile", colour))
            continue
        share = 100.0 * cv2.countNonZero(mask) / (height * width)
        lines.append((f"{name}: {share:.1f} % of the image", colour))
        if name != "tissue":
            canvas.fill(mask, colour, 0.35)
        canvas.contour(mask, colour)
    if masks.black is not None and masks.black.any():
        canvas.contour(masks.black, BORDER)
        lines.append(("border of the picture", BORDER))
    for one in frame.frames:
        own = one.left.masks
        if own.seen is None:
            _name_region(own, one.arm.profile.instrument_name, canvas)
        for seen in own.seen or ():
            for side in seen.sides:
                canvas.line(side[0], side[1], EDGE)
            canvas.cross(seen.end_px, EDGE)
            canvas.cross(seen.tip_px, TIP)
    if masks.seen is not None:
        lines += [("sides of each shaft and its end", EDGE), ("tip", TIP)]
        for at, seen in enumerate(masks.seen):
            names = [
                one.arm.profile.instrument_name
                for one in frame.frames
                if any(np.shares_memory(own.mask, seen.mask) for own in one.left.masks.seen or ())
            ]
            name = printable(names[0]) if len(names) == 1 else f"instrument {at + 1}"
            canvas.label(f"{name}  {seen.evidence:.2f}", 0.5 * (seen.entry_px + seen.end_px), EDGE)
        if not masks.seen:
            lines.append("no instrument")
    return lines


def _name_region(masks: Masks, name: str, canvas: Canvas) -> None:
    y, x = np.nonzero(masks.instrument)
    if len(x):
        canvas.label(printable(name), np.array([float(x.mean()), float(y.mean())]), DISTAL)
