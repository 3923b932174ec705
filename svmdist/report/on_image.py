"""A frame's drawing as pixels on its image: shapes, labels that hide nothing measured, and lines of text above."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.drawing import COLOURS, Form, FrameDrawing, Label, Part, Rgb, Shape
from svmdist.errors import printable
from svmdist.files import atomic_file
from svmdist.samples import Image
from svmdist.transforms import Array

FONT, SUBPIXEL_BITS = cv2.FONT_HERSHEY_SIMPLEX, 4
DARK = (20, 20, 20)
LIMIT_PX = 20_000.0  # OpenCV's drawing wraps around far outside of the image
SMALL, MEASURED = (Part.INLIER, Part.MATCH), (Part.DISTANCE, Part.BETWEEN)
FILLED = (Part.SHAFT, Part.WRIST, Part.POSE, Part.TAG)
Pixels = NDArray[np.int32]
NEAR, HIDDEN = 1e3, 1e6
"""What a pixel beside something measured costs a label, and one of what is measured or a label, in other pixels."""
LABEL_ANGLES = np.radians([0, 180, -30, 30, -150, 150, -90, 90, -60, 60, -120, 120])
LABEL_REACHES = np.array([0.8, 1.6, 2.8, 4.5, 7.0, 10.0])
NEAR_LETTERS = 2.0  # of their height: a label so near to what it names needs no line
LETTERS, LEAST_LETTER_PX = 1 / 44, 9.0
"""Height of a capital letter over the picture's width, and the least one that can be read."""


def bgr(colour: Rgb) -> tuple[int, int, int]:
    """The colour as OpenCV has it."""
    return colour[2], colour[1], colour[0]


def write_picture(path: Path, picture: Image) -> None:
    """Write a PNG; raises OutputError where that fails."""
    with atomic_file(path) as file:
        file.write(cv2.imencode(".png", picture)[1].tobytes())


def draw_on(
    image_bgr: Image,
    drawing: FrameDrawing,
    *,
    parts: Collection[Part] | None = None,
    lines: bool = True,
    least_px: int = 0,
    letters: float = LETTERS,
) -> Image:
    """A copy of an image, shape (h, w, 3) in BGR, with a drawing on it, or some of its `parts`; `lines` at the top.

    It is enlarged to `least_px`. Labels, with letters of that share of its width, hide no measured line, tip or label,
    and as little of instruments and outlines as they can.
    """
    ground = enlarged(image_bgr, least_px)
    pixels = ground.copy()
    times, unit_px = pixels.shape[1] / image_bgr.shape[1], max(1, pixels.shape[1] // 640)
    scaled = [replace(one, points_px=(one.points_px + 0.5) * times - 0.5) for one in drawing.shapes]
    shapes = [one for one in scaled if parts is None or one.part in parts]
    for shape in sorted(shapes, key=lambda one: one.part in MEASURED):  # what is measured lies on top
        _draw(pixels, shape, unit_px)
    letter_px = max(LEAST_LETTER_PX, letters * pixels.shape[1])
    measured = [whole(one.points_px) for one in shapes if one.part in MEASURED]
    measured += [whole(tip[None].repeat(2, 0)) for one in shapes if one.part is Part.TIP for tip in one.points_px]
    cost = (cv2.cvtColor(cv2.absdiff(pixels, ground), cv2.COLOR_BGR2GRAY) > 0).astype(np.float32)
    instruments = (one for one in scaled if one.form is Form.LOOP and one.part in FILLED)
    cv2.fillPoly(cost, [whole(one.points_px) for one in instruments], 1.0)
    for price, width_px in ((NEAR, round(letter_px)), (HIDDEN, 2 * unit_px)):
        cv2.polylines(cost, measured, False, price, width_px)
    if lines and drawing.lines:
        bar, width = _bar([(one.text, one.colour) for one in drawing.lines], pixels.shape[1], letter_px)
        is_hiding = any((ends[:, 1] < bar.shape[0] + letter_px).any() for ends in measured)
        top = max(0, pixels.shape[0] - bar.shape[0]) if is_hiding else 0
        bar = bar[: pixels.shape[0], :width]
        pixels[top : top + bar.shape[0], :width] = bar
        cost[top : top + bar.shape[0], :width] = HIDDEN
    for label in sorted(drawing.labels, key=lambda one: one.part is Part.BETWEEN):  # it has most room
        if parts is None or label.part in parts:
            _write_beside(pixels, label, (label.place_px + 0.5) * times - 0.5, cost, letter_px)
    return pixels


def enlarged(image: Image, least_px: int) -> Image:
    """A copy of an image as many whole times as large as it takes to be so wide."""
    times = max(1, -(-least_px // image.shape[1]))
    return np.array(image.repeat(times, 0).repeat(times, 1), order="C")


def _within_reach(points_px: Array) -> Array:
    return np.clip(np.nan_to_num(points_px, nan=-LIMIT_PX), -LIMIT_PX, LIMIT_PX)


def whole(points_px: Array) -> Pixels:
    """Points in px that OpenCV can draw; those without a place are far outside."""
    return np.rint(_within_reach(points_px)).astype(np.int32)


def _draw(pixels: Image, shape: Shape, unit_px: int) -> None:
    colour = bgr(COLOURS[shape.part])
    points = np.asarray(np.round(_within_reach(shape.points_px) * (1 << SUBPIXEL_BITS)), np.int32)
    is_dots, is_measured = shape.form is Form.POINTS, shape.part in MEASURED
    if not is_dots:
        for tone, width in ((DARK, 4), (colour, 2)) if is_measured else ((colour, 2),):
            cv2.polylines(pixels, [points], shape.form is Form.LOOP, tone, width * unit_px, cv2.LINE_AA, SUBPIXEL_BITS)
    radius = 2 if shape.part in SMALL else 3 if is_measured else 4
    for x, y in points.tolist() if is_dots or is_measured else ():
        for tone, reach in ((DARK, radius + 1), (colour, radius))[shape.part in SMALL :]:
            grown = reach * unit_px << SUBPIXEL_BITS
            cv2.circle(pixels, (x, y), grown, tone, cv2.FILLED, cv2.LINE_AA, SUBPIXEL_BITS)


def text_size(text: str, letter_px: float) -> tuple[float, int, int]:
    """Scale and thickness of letters of a height, and a text's width."""
    scale = letter_px / 21.0  # of the font
    thickness = max(1, round(scale))
    (width, _), _ = cv2.getTextSize(text, FONT, scale, thickness)
    return scale, thickness, width


def write_text(pixels: Image, text: str, place: tuple[float, float], letter_px: float, colour: Rgb) -> None:
    """Write a text whose line begins at a place (x, y)."""
    scale, thickness, _ = text_size(text, letter_px)
    cv2.putText(pixels, text, (round(place[0]), round(place[1])), FONT, scale, bgr(colour), thickness, cv2.LINE_AA)


def _write_beside(pixels: Image, label: Label, place: Array, cost: NDArray[np.float32], letter_px: float) -> None:
    """Write a label on dark ground at the cheapest of the nearest places, with a line to what it names unless at it."""
    text, place = printable(label.text), _within_reach(place)
    half = np.array([0.5 * text_size(text, letter_px)[2] + 0.4 * letter_px, 0.95 * letter_px])
    high, low = half + 1, np.maximum(half + 1, np.array(pixels.shape[1::-1]) - half - 1)
    # Around what it names, ever farther.
    around = np.column_stack([np.cos(LABEL_ANGLES), np.sin(LABEL_ANGLES)])
    offsets = around * (half + letter_px * LABEL_REACHES[:, None, None])
    middles = np.clip(place + offsets.reshape(-1, 2), high, low)
    boxes = np.stack([whole(middles - half), whole(middles + half)], 1)
    # What a box hides and how long its line is, all at once; what the line hides, of the cheapest only.
    last, total = np.array(cost.shape[::-1]) - 1, cv2.integral(cost)
    left, top, right, bottom = np.clip(boxes + np.array([[0], [1]]), 0, last + 1).reshape(-1, 4).T
    nearest = np.clip(place, boxes[:, 0], boxes[:, 1])
    counts = 2 + np.rint(np.linalg.norm(nearest - place, axis=1)).astype(int)
    prices = total[bottom, right] - total[top, right] - total[bottom, left] + total[top, left]
    prices += letter_px * counts

    def leader(at: int) -> Pixels:  # the line between a box and a letter before the place
        gap_px = float(np.linalg.norm(nearest[at] - place))
        end = place + (nearest[at] - place) * letter_px / max(gap_px, letter_px)
        return whole(np.linspace(nearest[at], end, counts[at]))

    best, at = np.inf, 0
    for one in np.argsort(prices, kind="stable").tolist():
        if prices[one] > best:
            break
        x, y = np.clip(leader(one), 0, last).T
        best, at = min((best, at), (prices[one] + float(cost[y, x].sum()), one))
    (left, top), (right, bottom) = boxes[at]
    if np.linalg.norm(nearest[at] - place) > NEAR_LETTERS * letter_px:
        line, width_px = leader(at), max(1, pixels.shape[1] // 900)
        cv2.polylines(pixels, [line], False, bgr(COLOURS[label.part]), width_px, cv2.LINE_AA)
        cv2.polylines(cost, [line], False, HIDDEN)
    for canvas, value in ((pixels, DARK), (cost, HIDDEN)):
        canvas[top : bottom + 1, left : right + 1] = value
    write_text(pixels, text, (left + 0.4 * letter_px, bottom - 0.45 * letter_px), letter_px, COLOURS[label.part])


def _bar(lines: Sequence[tuple[str, Rgb]], width_px: int, letter_px: float) -> tuple[Image, int]:
    """Lines on dark ground, wrapped where they are longer than the picture is wide; and how wide they are."""
    rows = list[tuple[str, Rgb]]()
    for text, colour in lines:
        words = printable(text).split(" ")
        row = words[0]
        for word in words[1:]:
            longer = f"{row} {word}"
            if text_size(longer, letter_px)[2] + letter_px > width_px:
                rows.append((row, colour))
                longer = f"  {word}"
            row = longer
        rows.append((row, colour))
    step_px = round(1.9 * letter_px)
    bar = np.full((step_px * len(rows) + round(0.4 * letter_px), width_px, 3), DARK, np.uint8)
    for at, (text, colour) in enumerate(rows):
        write_text(bar, text, (0.5 * letter_px, (at + 1) * step_px - 0.4 * letter_px), letter_px, colour)
    longest = max((text_size(text, letter_px)[2] for text, _ in rows), default=0)
    return bar, min(width_px, round(longest + letter_px))


def under(lines: Sequence[tuple[str, Rgb]], pixels: Image, letters: float = LETTERS) -> Image:
    """A picture under a bar with lines of text."""
    bar, _ = _bar(lines, pixels.shape[1], max(LEAST_LETTER_PX, letters * pixels.shape[1]))
    return np.vstack([bar, pixels])
