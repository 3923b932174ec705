"""A frame's drawing as pixels: on its image, and in panels, one for each phase of a method or for its masks."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from svmdist.drawing import ALARM_COLOUR, COLOURS, Form, FrameDrawing, Label, Part, Rgb, Shape
from svmdist.errors import printable
from svmdist.estimation.methods import REGISTRY, Phase
from svmdist.files import atomic_file
from svmdist.samples import Image
from svmdist.vision.marker import EDGE_MARGIN_PX, padded_template
from svmdist.workflows.frame_drawing import DrawnFrame, contours_of, virtual_marker

FONT = cv2.FONT_HERSHEY_SIMPLEX
WHITE: Rgb = (255, 255, 255)
DARK = (20, 20, 20)
SUBPIXEL_BITS = 4
LIMIT_PX = 20_000.0  # OpenCV's drawing wraps around far outside of the image
SMALL = (Part.INLIER, Part.MATCH)
COLUMNS = 3
TINT = 0.45
LEAST_WIDTH_PX = 900
"""Smaller images are enlarged for masks, so that letters stay smaller than what they name."""
NEAR_FAR_PERCENT = (5.0, 95.0)
Box = tuple[int, int, int, int]


def bgr(colour: Rgb) -> tuple[int, int, int]:
    """The colour as OpenCV has it."""
    return colour[2], colour[1], colour[0]


def write_picture(path: Path, picture: Image) -> None:
    """Write a PNG; raises OutputError where that fails."""
    with atomic_file(path) as file:
        file.write(cv2.imencode(".png", picture)[1].tobytes())


def draw_on(
    image_bgr: Image, drawing: FrameDrawing, *, parts: Collection[Part] | None = None, lines: bool = True
) -> Image:
    """A copy of an image, shape (h, w, 3) in BGR, with a drawing on it, or some of its `parts`; `lines` at the top."""
    pixels = np.array(image_bgr, order="C")
    unit_px = max(1, pixels.shape[1] // 640)
    for shape in drawing.shapes:
        if parts is None or shape.part in parts:
            _draw(pixels, shape, unit_px)
    written: list[Box] = []
    for label in drawing.labels:
        if parts is None or label.part in parts:
            written.append(_write_beside(pixels, label, written))
    if lines:
        for row, line in enumerate(drawing.lines):
            colour = ALARM_COLOUR if line.alarm or not line.measured else WHITE
            _write_row(pixels, printable(line.text), row, colour)
    return pixels


def _draw(pixels: Image, shape: Shape, unit_px: int) -> None:
    colour = bgr(COLOURS[shape.part])
    near = np.clip(np.nan_to_num(shape.points_px, nan=-LIMIT_PX), -LIMIT_PX, LIMIT_PX)
    points = np.asarray(np.round(near * (1 << SUBPIXEL_BITS)), np.int32)
    if shape.form is Form.POINTS:
        radius = (2 if shape.part in SMALL else 4) * unit_px << SUBPIXEL_BITS
        for x, y in points.tolist():
            if shape.part not in SMALL:
                grown = radius + (unit_px << SUBPIXEL_BITS)
                cv2.circle(pixels, (x, y), grown, DARK, cv2.FILLED, cv2.LINE_AA, SUBPIXEL_BITS)
            cv2.circle(pixels, (x, y), radius, colour, cv2.FILLED, cv2.LINE_AA, SUBPIXEL_BITS)
        return
    is_closed = shape.form is Form.LOOP
    if shape.part in (Part.DISTANCE, Part.BETWEEN):
        cv2.polylines(pixels, [points], is_closed, DARK, 4 * unit_px, cv2.LINE_AA, SUBPIXEL_BITS)
    cv2.polylines(pixels, [points], is_closed, colour, 2 * unit_px, cv2.LINE_AA, SUBPIXEL_BITS)


def _letters(pixels: Image) -> tuple[float, int]:
    scale = max(0.35, pixels.shape[1] / 1500.0)
    return scale, max(1, round(1.6 * scale))


def _write_beside(pixels: Image, label: Label, written: Sequence[Box]) -> Box:
    """Write a label inside of the image, on dark ground, below what stands there already; gives the box it covers."""
    text, (scale, thickness) = printable(label.text), _letters(pixels)
    (width, height), below = cv2.getTextSize(text, FONT, scale, thickness)
    place = np.clip(np.nan_to_num(label.place_px), -LIMIT_PX, LIMIT_PX)
    x = int(np.clip(place[0] + 6, 2, max(2, pixels.shape[1] - width - 4)))
    y = int(np.clip(place[1] - 6, height + 4, max(height + 4, pixels.shape[0] - below - 3)))
    for left, top, right, bottom in sorted(written, key=lambda box: box[1]):
        if x - 2 < right and left < x + width + 2 and y - height - 3 < bottom and top < y + below:
            y = bottom + height + 4
    cv2.rectangle(pixels, (x - 2, y - height - 3), (x + width + 2, y + below), DARK, cv2.FILLED)
    cv2.putText(pixels, text, (x, y), FONT, scale, bgr(COLOURS[label.part]), thickness, cv2.LINE_AA)
    return x - 2, y - height - 3, x + width + 2, y + below


def _write_row(pixels: Image, text: str, row: int, colour: Rgb) -> None:
    """Write a line at the top left, as much of it as the image is wide."""
    scale, thickness = _letters(pixels)
    (width, _), _ = cv2.getTextSize(text, FONT, scale, thickness)
    # Rows are alike, whatever their letters.
    (_, height), below = cv2.getTextSize("Mg", FONT, scale, thickness)
    room = pixels.shape[1] - 8
    if width > room:
        text, width = text[: max(1, len(text) * room // width - 3)] + "...", room
    top = row * (height + below + 6)
    cv2.rectangle(pixels, (0, top), (width + 8, top + height + below + 6), DARK, cv2.FILLED)
    cv2.putText(pixels, text, (4, top + height + 3), FONT, scale, bgr(colour), thickness, cv2.LINE_AA)


def _under(lines: Sequence[tuple[str, Rgb] | str], pixels: Image, scale: float = 0.7) -> Image:
    (_, height), below = cv2.getTextSize("Mg", FONT, scale, 1)
    step = height + below + 8
    bar = np.full((step * len(lines) + 8, pixels.shape[1], 3), DARK, np.uint8)
    for at, line in enumerate(lines):
        text, colour = line if isinstance(line, tuple) else (line, WHITE)
        place = (8, at * step + height + 6)
        cv2.putText(bar, printable(text), place, FONT, scale, bgr(colour), 1, cv2.LINE_AA)
    return np.vstack([bar, pixels])


def _tinted(pixels: Image, parts: Sequence[tuple[Part, Image | None]]) -> Image:
    pixels = np.array(pixels)
    for part, mask in parts:
        if mask is not None:
            tint = TINT * np.array(bgr(COLOURS[part]), np.float64)
            pixels[mask > 0] = ((1.0 - TINT) * pixels[mask > 0] + tint).astype(np.uint8)
    return pixels


def masks_picture(frame: DrawnFrame, title: str) -> Image:
    """What was segmented, shape (h, w, 3) in BGR, under lines that name it; only the status of an unreadable frame."""
    frames = frame.replayed.frames
    if not frames:
        return phases_picture(frame, title)
    masks, image = frames[0].scene.left.masks, frames[0].scene.observation.image_bgr
    lines: list[tuple[str, Rgb] | str] = [title]
    shapes, labels = list[Shape](), []
    named = {"tissue": (Part.TISSUE, masks.tissue), "shaft": (Part.SHAFT, masks.shaft),
             "distal part": (Part.INSTRUMENT, masks.instrument)}  # fmt: skip
    for name, (part, mask) in named.items():
        share = "not in the profile" if mask is None else f"{100.0 * np.mean(mask > 0):.1f} % of the image"
        lines.append((f"{name}: {share}", COLOURS[part]))
        shapes += [] if mask is None else contours_of(mask, part)
    if masks.black is not None and masks.black.any():
        shapes += contours_of(masks.black, Part.MATCH)
        lines.append(("border of the picture", COLOURS[Part.MATCH]))
    if masks.seen is None:
        for one in frames:
            places = np.argwhere(one.left.masks.instrument)[:, ::-1]
            if len(places):
                labels.append(Label(Part.INSTRUMENT, places.mean(0), one.arm.profile.instrument_name))
    else:
        lines += [("sides of each shaft", COLOURS[Part.MARKER]), ("its end, and the tip", COLOURS[Part.TIP])]
        lines += [] if masks.seen else ["no instrument"]
        for at, seen in enumerate(masks.seen):
            shapes += [Shape(Part.MARKER, Form.LINE, np.asarray(side)) for side in seen.sides]
            shapes.append(Shape(Part.TIP, Form.POINTS, np.stack([seen.end_px, seen.tip_px])))
            name = _owner(frame, seen.mask) or f"instrument {at + 1}"
            place_px = 0.5 * (seen.entry_px + seen.end_px)
            labels.append(Label(Part.MARKER, place_px, f"{name}  {seen.evidence:.2f}"))
    tinted = _tinted(image, [(part, mask) for part, mask in named.values() if part is not Part.TISSUE])
    times = max(1, -(-LEAST_WIDTH_PX // image.shape[1]))
    large = cv2.resize(tinted, None, fx=times, fy=times, interpolation=cv2.INTER_NEAREST)
    drawing = FrameDrawing(
        frame.drawing.stamp_ns,
        tuple(replace(one, points_px=(one.points_px + 0.5) * times - 0.5) for one in shapes),
        tuple(replace(one, place_px=(one.place_px + 0.5) * times - 0.5) for one in labels),
    )
    return _under(lines, draw_on(np.asarray(large, np.uint8), drawing, lines=False))


def _owner(frame: DrawnFrame, mask: Image) -> str:
    """The instrument whose masks have this one; empty where it is none, or several."""
    found = ((one.arm.profile.instrument_name, one.left.masks.seen or ()) for one in frame.replayed.frames)
    owners = [name for name, seen in found if any(np.shares_memory(own.mask, mask) for own in seen)]
    return owners[0] if len(owners) == 1 else ""


def phases_picture(frame: DrawnFrame, title: str, method: str = "") -> Image:
    """All phases of a method in a grid, shape (h, w, 3) in BGR; of a frame that could not be read its status only."""
    lines, image = [title, *(line.text for line in frame.drawing.lines)], frame.replayed.image_bgr
    if image is None or not frame.replayed.frames:
        return _under(lines, np.zeros((40, 960, 3), np.uint8))
    panels = []
    for name in REGISTRY[method].draws:
        phase = _PHASES[name]
        if isinstance(phase, tuple):
            panel = draw_on(image, frame.drawing, parts=phase, lines=False)
        else:
            panel = phase(frame, np.array(image))
        panels.append(_under([name], panel, max(0.6, panel.shape[1] / 1100.0)))
    columns = min(len(panels), 2 if len(panels) in (2, 4) else COLUMNS)
    height, width = panels[0].shape[:2]
    sheet = np.full((-(-len(panels) // columns) * height, columns * (width + 4), 3), DARK, np.uint8)
    for at, panel in enumerate(panels):
        y, x = at // columns * height, at % columns * (width + 4)
        sheet[y : y + height, x : x + width] = panel
    return _under(lines, sheet)


def _segmentation(frame: DrawnFrame, _: Image) -> Image:
    first = frame.replayed.frames[0]
    recorded = "regions_as_recorded" in first.left.found
    parts: list[tuple[Part, Image | None]] = []
    for one in frame.replayed.frames:
        masks = one.left.masks_as_recorded if recorded else one.left.masks
        parts += [] if parts else [(Part.TISSUE, masks.tissue)]
        parts += [(Part.INSTRUMENT, masks.instrument), (Part.SHAFT, None if recorded else masks.shaft)]
    return _tinted(first.scene.observation.image_bgr, parts)


def _marker(frame: DrawnFrame, pixels: Image) -> Image:
    for found in filter(None, map(virtual_marker, frame.replayed.frames)):
        (x, y), window = found.window.origin_px, found.window.window_bgr
        rows, columns = (np.arange(length) for length in window.shape[:2])
        r = (rows + y >= 0) & (rows + y < pixels.shape[0])
        c = (columns + x >= 0) & (columns + x < pixels.shape[1])
        pixels[np.ix_(rows[r] + y, columns[c] + x)] = window[np.ix_(r, c)]
        for x_px, y_px in found.keypoints_px:
            cv2.circle(pixels, (round(x_px), round(y_px)), 2, bgr(COLOURS[Part.MATCH]), 1, cv2.LINE_AA)
    return pixels


def _matches(frame: DrawnFrame, sheet: Image) -> Image:
    """The template beside the marked window, with lines between matched points: inliers apart from the others."""
    sheet[:] = DARK
    height, width = sheet.shape[:2]
    one = frame.replayed.frames[0]
    if (found := virtual_marker(one)) is None:
        return sheet
    template = padded_template(one.arm.profile.marker.size_px, EDGE_MARGIN_PX)
    left, right = cv2.cvtColor(template, cv2.COLOR_GRAY2BGR), found.window.window_bgr
    both = np.hstack([left, np.full((left.shape[0], 20, 3), DARK, np.uint8), right[: left.shape[0]]])
    times = max(1, min(width // both.shape[1], height // both.shape[0]))
    large = cv2.resize(both, None, fx=times, fy=times, interpolation=cv2.INTER_NEAREST)
    offset = np.array([left.shape[1] + 20.0, 0.0]) - np.array(found.window.origin_px, np.float64)
    starts, ends = found.template_px + EDGE_MARGIN_PX, found.matched_px + offset
    for at in np.argsort(found.inliers, kind="stable"):  # the others first: inliers lie on top
        start, end = ((round((x + 0.5) * times), round((y + 0.5) * times)) for x, y in (starts[at], ends[at]))
        colour = COLOURS[Part.INLIER if found.inliers[at] else Part.MATCH]
        cv2.line(large, start, end, bgr(colour), 1, cv2.LINE_AA)
    top, at = (height - large.shape[0]) // 2, (width - large.shape[1]) // 2
    if top < 0 or at < 0:
        return np.asarray(cv2.resize(large, (width, height)), np.uint8)
    sheet[top : top + large.shape[0], at : at + large.shape[1]] = large
    return sheet


def _surface(frame: DrawnFrame, pixels: Image) -> Image:
    """Points of the stereo surface, coloured by depth: yellow is near, violet far."""
    scene = frame.replayed.frames[0].scene
    surface = scene.found.get("stereo_surface")
    if surface is None or len(surface.points_m) == 0:
        return pixels
    depth_m = surface.points_m[:, 2]
    near_m, far_m = np.percentile(depth_m, NEAR_FAR_PERCENT)
    share = np.clip((far_m - depth_m) / max(far_m - near_m, 1e-9), 0.0, 1.0)
    colours = cv2.applyColorMap((255 * share).astype(np.uint8)[:, None], cv2.COLORMAP_VIRIDIS)[:, 0]
    for place, colour in zip(scene.lens.project(surface.points_m), colours.tolist(), strict=True):
        cv2.circle(pixels, (round(place[0]), round(place[1])), 2, colour, cv2.FILLED)
    return pixels


_RESULT = (Part.TIP, Part.TISSUE, Part.MARKER, Part.POSE, Part.DISTANCE, Part.BETWEEN)
_PHASES: dict[Phase, Callable[[DrawnFrame, Image], Image] | tuple[Part, ...]] = {
    "segmentation": _segmentation,
    "contours": (Part.TISSUE, Part.INSTRUMENT),
    "marker": _marker,
    "matches": _matches,
    "outline and distance": _RESULT,
    "edges": (Part.SHAFT,),
    "tip": (Part.MARKER, Part.TIP),
    "tag": (Part.TAG,),
    "surface": _surface,
    "distance": _RESULT,
}
"""What each phase draws on a copy of the image: a function's picture, or these parts of the drawing."""
