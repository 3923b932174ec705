"""A frame's drawing on its image, as pixels: what pictures, reports and videos show."""

from __future__ import annotations

from collections.abc import Collection, Sequence

import cv2
import numpy as np

from svmdist.drawing import ALARM_COLOUR, COLOURS, Form, FrameDrawing, Part, Rgb, Shape
from svmdist.report.canvas import DARK, FONT
from svmdist.report.text import printable
from svmdist.samples import Image
from svmdist.transforms import Array

SUBPIXEL_BITS = 4
Box = tuple[int, int, int, int]
LIMIT_PX = 20_000.0
"""OpenCV's drawing wraps around far outside of the image."""


def draw_on(
    image_bgr: Image, drawing: FrameDrawing, *, parts: Collection[Part] | None = None, lines: bool = True
) -> Image:
    """A copy of an image, shape (h, w, 3) in BGR, with a drawing on it; `parts` leaves out the others.

    The status lines stand at the top left, on dark ground.
    """
    pixels = np.array(image_bgr, order="C")
    unit_px = max(1, pixels.shape[1] // 640)
    for shape in drawing.shapes:
        if parts is None or shape.part in parts:
            _draw(pixels, shape, unit_px)
    written: list[Box] = []
    for label in drawing.labels:
        if parts is None or label.part in parts:
            written.append(
                _write(pixels, printable(label.text), label.place_px, COLOURS[label.part], written)
            )
    if lines:
        for row, line in enumerate(drawing.lines):
            colour = ALARM_COLOUR if line.alarm or not line.measured else (255, 255, 255)
            _write_row(pixels, printable(line.text), row, colour)
    return pixels


def bgr(colour: Rgb) -> tuple[int, int, int]:
    """The colour as OpenCV has it."""
    return colour[2], colour[1], colour[0]


def _draw(pixels: Image, shape: Shape, unit_px: int) -> None:
    colour = bgr(COLOURS[shape.part])
    points = _fixed(shape.points_px)
    if shape.form is Form.POINTS:
        radius = (2 if shape.part in (Part.INLIER, Part.MATCH) else 4) * unit_px << SUBPIXEL_BITS
        for point in points:
            place = int(point[0]), int(point[1])
            if shape.part not in (Part.INLIER, Part.MATCH):
                grown = radius + (unit_px << SUBPIXEL_BITS)
                cv2.circle(pixels, place, grown, DARK, cv2.FILLED, cv2.LINE_AA, SUBPIXEL_BITS)
            cv2.circle(pixels, place, radius, colour, cv2.FILLED, cv2.LINE_AA, SUBPIXEL_BITS)
        return
    is_closed = shape.form is Form.LOOP
    is_measured = shape.part in (Part.DISTANCE, Part.BETWEEN)
    if is_measured:
        cv2.polylines(pixels, [points], is_closed, DARK, 4 * unit_px, cv2.LINE_AA, SUBPIXEL_BITS)
    width = 2 * unit_px
    cv2.polylines(pixels, [points], is_closed, colour, width, cv2.LINE_AA, SUBPIXEL_BITS)


def _fixed(points_px: Array) -> Array:
    """Points as OpenCV takes them with a fraction of a pixel."""
    near = np.clip(np.nan_to_num(points_px, nan=-LIMIT_PX), -LIMIT_PX, LIMIT_PX)
    return np.asarray(np.round(near * (1 << SUBPIXEL_BITS)), np.int32)


def _letters(pixels: Image) -> tuple[float, int]:
    scale = max(0.35, pixels.shape[1] / 1500.0)
    return scale, max(1, round(1.6 * scale))


def _write(pixels: Image, text: str, place_px: Array, colour: Rgb, written: Sequence[Box]) -> Box:
    """Write beside a place, shape (2,), and inside of the image, on dark ground, below what stands there already.

    Gives the box (left, top, right, bottom) that is covered.
    """
    scale, thickness = _letters(pixels)
    (width, height), below = cv2.getTextSize(text, FONT, scale, thickness)
    place = np.clip(np.nan_to_num(place_px), -LIMIT_PX, LIMIT_PX)
    x = int(np.clip(place[0] + 6, 2, max(2, pixels.shape[1] - width - 4)))
    y = int(np.clip(place[1] - 6, height + 4, max(height + 4, pixels.shape[0] - below - 3)))
    for left, top, right, bottom in sorted(written, key=lambda box: box[1]):
        if x - 2 < right and left < x + width + 2 and y - height - 3 < bottom and top < y + below:
            y = bottom + height + 4
    cv2.rectangle(pixels, (x - 2, y - height - 3), (x + width + 2, y + below), DARK, cv2.FILLED)
    cv2.putText(pixels, text, (x, y), FONT, scale, bgr(colour), thickness, cv2.LINE_AA)
    return x - 2, y - height - 3, x + width + 2, y + below


def _write_row(pixels: Image, text: str, row: int, colour: Rgb) -> None:
    """Write a line at the top left, as much of it as the image is wide."""
    scale, thickness = _letters(pixels)
    (width, _), _ = cv2.getTextSize(text, FONT, scale, thickness)
    (_, height), below = cv2.getTextSize(
        "Mg", FONT, scale, thickness
    )  # rows are alike, whatever their letters
    room = pixels.shape[1] - 8
    if width > room:
        text = text[: max(1, len(text) * room // width - 3)] + "..."
        width = room
    top = row * (height + below + 6)
    cv2.rectangle(pixels, (0, top), (width + 8, top + height + below + 6), DARK, cv2.FILLED)
    cv2.putText(pixels, text, (4, top + height + 3), FONT, scale, bgr(colour), thickness, cv2.LINE_AA)
