"""A frame's drawing as pixels: on its image, and the phases of a method in panels."""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from svmdist.drawing import ALARM_COLOUR, COLOURS, Form, FrameDrawing, Part, Rgb, Shape
from svmdist.errors import OutputError
from svmdist.estimation.methods import REGISTRY, Phase
from svmdist.files import atomic_file
from svmdist.report.tables import printable
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.marker import EDGE_MARGIN_PX, padded_template
from svmdist.vision.segmentation import Masks
from svmdist.workflows.annotate import DrawnFrame
from svmdist.workflows.frame_drawing import virtual_marker
from svmdist.workflows.show import ShownFrame

Colour = tuple[int, int, int]
FONT = cv2.FONT_HERSHEY_SIMPLEX
LEAST_WIDTH_PX = 900
"""Smaller images are enlarged by a whole number, so that letters stay smaller than what they name."""
DARK: Colour = (20, 20, 20)
WHITE: Colour = (240, 240, 240)


@dataclass
class Canvas:
    """An enlarged copy of an image, shape (h, w, 3) in BGR; places are given in pixels of the image."""

    pixels: Image
    enlarged: int

    @classmethod
    def of(cls, bgr: Image) -> Canvas:
        """A canvas with an image, shape (h, w, 3), on it."""
        times = max(1, -(-LEAST_WIDTH_PX // bgr.shape[1]))
        size = (bgr.shape[1] * times, bgr.shape[0] * times)
        return cls(np.ascontiguousarray(cv2.resize(bgr, size, interpolation=cv2.INTER_NEAREST)), times)

    @property
    def unit_px(self) -> int:
        """The width of a line on the canvas."""
        return max(2, int(self.pixels.shape[1]) // 500)

    def fill(self, mask: Image, colour: Colour, strength: float) -> None:
        """Tint what is under a mask, shape (h, w), of the image."""
        height, width = self.pixels.shape[:2]
        under = cv2.resize(mask, (width, height), interpolation=cv2.INTER_NEAREST) > 0
        tinted = (1.0 - strength) * self.pixels[under] + strength * np.array(colour, np.float64)
        self.pixels[under] = tinted.astype(np.uint8)

    def contour(self, mask: Image, colour: Colour, thickness: int = 1) -> None:
        """Draw the borders of a mask, shape (h, w), of the image."""
        height, width = self.pixels.shape[:2]
        large = cv2.resize(mask, (width, height), interpolation=cv2.INTER_NEAREST)
        contours, _ = cv2.findContours(large, cv2.RETR_CCOMP, cv2.CHAIN_APPROX_SIMPLE)
        cv2.drawContours(self.pixels, contours, -1, colour, thickness * self.unit_px, cv2.LINE_AA)

    def line(self, start_px: Array, end_px: Array, colour: Colour) -> None:
        """Draw a line between two places, shape (2,) each."""
        start, end = self._on(start_px), self._on(end_px)
        cv2.line(self.pixels, start, end, DARK, 3 * self.unit_px, cv2.LINE_AA)
        cv2.line(self.pixels, start, end, colour, self.unit_px, cv2.LINE_AA)

    def cross(self, place_px: Array, colour: Colour) -> None:
        """Mark a place, shape (2,)."""
        at, size = self._on(place_px), 8 * self.unit_px
        cv2.drawMarker(self.pixels, at, DARK, cv2.MARKER_CROSS, size + 4, 3 * self.unit_px)
        cv2.drawMarker(self.pixels, at, colour, cv2.MARKER_CROSS, size, self.unit_px)

    def label(self, text: str, place_px: Array, colour: Colour) -> None:
        """Write beside a place, shape (2,), and inside of the image."""
        scale, thickness = self._letters
        (width, height), below = cv2.getTextSize(text, FONT, scale, thickness)
        x, y = self._on(place_px)
        x = int(np.clip(x + 6 * self.unit_px, 2, max(2, self.pixels.shape[1] - width - 6)))
        y = int(np.clip(y - 4 * self.unit_px, height + 4, self.pixels.shape[0] - below - 4))
        cv2.rectangle(self.pixels, (x - 3, y - height - 3), (x + width + 3, y + below + 1), DARK, cv2.FILLED)
        cv2.putText(self.pixels, text, (x, y), FONT, scale, colour, thickness, cv2.LINE_AA)

    def with_caption(self, lines: Sequence[tuple[str, Colour] | str]) -> Image:
        """The canvas with lines of text below it, each in its colour."""
        scale, thickness = self._letters
        (_, height), below = cv2.getTextSize("Mg", FONT, scale, thickness)
        step = height + below + 8
        strip = np.full((step * len(lines) + 8, self.pixels.shape[1], 3), DARK, np.uint8)
        for at, line in enumerate(lines):
            text, colour = line if isinstance(line, tuple) else (line, WHITE)
            cv2.putText(strip, text, (8, at * step + height + 6), FONT, scale, colour, thickness, cv2.LINE_AA)
        return np.vstack([self.pixels, strip])

    @property
    def _letters(self) -> tuple[float, int]:
        scale = max(0.55, self.pixels.shape[1] / 1700.0)
        return scale, max(1, round(1.4 * scale))

    def _on(self, place_px: Array) -> tuple[int, int]:
        x, y = (np.asarray(place_px, np.float64) + 0.5) * self.enlarged
        limit = 1 << 20
        return int(np.clip(x, -limit, limit)), int(np.clip(y, -limit, limit))


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


COLUMNS = 3
TINT = 0.45
NEAR_FAR_PERCENT = (5.0, 95.0)


def phases_picture(frame: DrawnFrame, method: str, title: str) -> Image:
    """All phases of a method on a frame in a grid, shape (h, w, 3) in BGR, under a line that says what it is.

    A phase whose detection this frame lacks is shown too: that it found nothing is what one wants to know. A frame
    that could not be read has its status only.
    """
    lines = [title, *(line.text for line in frame.drawing.lines)]
    if not frame.replayed.frames or frame.replayed.image_bgr is None:
        return _under(lines, np.zeros((40, 960, 3), np.uint8))
    panels = [_titled(name, _PHASES[name](frame)) for name in phases_of(method)]
    return _under(lines, _grid(panels))


def phases_of(method: str) -> Sequence[str]:
    """The names of a method's phases, in order."""
    return REGISTRY[method].draws


def _image(frame: DrawnFrame) -> Image:
    image = frame.replayed.image_bgr
    assert image is not None  # the caller looked
    return image


def _only(*parts: Part) -> Callable[[DrawnFrame], Image]:
    return lambda frame: draw_on(_image(frame), frame.drawing, parts=parts, lines=False)


def _segmentation(frame: DrawnFrame) -> Image:
    """Masks as tints on the image that was segmented, which has no distortion."""
    first = frame.replayed.frames[0]
    pixels = np.array(first.scene.observation.image_bgr)
    recorded = "regions_as_recorded" in first.left.found
    tissue = first.left.masks_as_recorded.tissue if recorded else first.left.masks.tissue
    parts = [(Part.TISSUE, tissue)]
    for one in frame.replayed.frames:
        masks = one.left.masks_as_recorded if recorded else one.left.masks
        parts.append((Part.INSTRUMENT, masks.instrument))
        if masks.shaft is not None and not recorded:
            parts.append((Part.SHAFT, masks.shaft))
    for part, mask in parts:
        under = mask > 0
        tint = np.array(bgr(COLOURS[part]), np.float64)
        pixels[under] = ((1.0 - TINT) * pixels[under] + TINT * tint).astype(np.uint8)
    return pixels


def _marker(frame: DrawnFrame) -> Image:
    """The image with the virtual marker pasted on it."""
    pixels = np.array(_image(frame))
    for one in frame.replayed.frames:
        found = virtual_marker(one, one.arm.profile)
        if found is None:
            continue
        x0, y0 = found.window.origin_px
        window = found.window.window_bgr
        rows = np.arange(window.shape[0]) + y0
        columns = np.arange(window.shape[1]) + x0
        r = (rows >= 0) & (rows < pixels.shape[0])
        c = (columns >= 0) & (columns < pixels.shape[1])
        pixels[np.ix_(rows[r], columns[c])] = window[np.ix_(r, c)]
        for x, y in found.keypoints_px:
            cv2.circle(pixels, (round(x), round(y)), 2, bgr(COLOURS[Part.MATCH]), 1, cv2.LINE_AA)
    return pixels


def _matches(frame: DrawnFrame) -> Image:
    """The template beside the marked window, with lines between matched points: inliers apart from the others."""
    height, width = _image(frame).shape[:2]
    sheet = np.full((height, width, 3), DARK, np.uint8)
    one = frame.replayed.frames[0]
    found = virtual_marker(one, one.arm.profile)
    if found is None:
        return sheet
    template = padded_template(one.arm.profile.marker.size_px, EDGE_MARGIN_PX)
    left = cv2.cvtColor(template, cv2.COLOR_GRAY2BGR)
    right = found.window.window_bgr
    both = np.hstack([left, np.full((left.shape[0], 20, 3), DARK, np.uint8), right[: left.shape[0]]])
    times = max(1, min(width // both.shape[1], height // both.shape[0]))
    large = cv2.resize(both, None, fx=times, fy=times, interpolation=cv2.INTER_NEAREST)
    offset = np.array([left.shape[1] + 20.0, 0.0]) - np.array(found.window.origin_px, np.float64)
    for is_inlier, part in ((False, Part.MATCH), (True, Part.INLIER)):
        for a, b in zip(
            found.template_px[found.inliers == is_inlier] + EDGE_MARGIN_PX,
            found.matched_px[found.inliers == is_inlier] + offset,
            strict=True,
        ):
            start, end = ((round((x + 0.5) * times), round((y + 0.5) * times)) for x, y in (a, b))
            cv2.line(large, start, end, bgr(COLOURS[part]), 1, cv2.LINE_AA)
    top, at = (height - large.shape[0]) // 2, (width - large.shape[1]) // 2
    if top < 0 or at < 0:
        return np.asarray(cv2.resize(large, (width, height)), np.uint8)
    sheet[top : top + large.shape[0], at : at + large.shape[1]] = large
    return sheet


def _surface(frame: DrawnFrame) -> Image:
    """Points of the stereo surface, coloured by depth: yellow is near, violet far."""
    pixels = np.array(_image(frame))
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


def _result(frame: DrawnFrame) -> Image:
    parts = (Part.TIP, Part.TISSUE, Part.MARKER, Part.DISTANCE, Part.BETWEEN)
    return draw_on(_image(frame), frame.drawing, parts=parts, lines=False)


_PHASES: dict[Phase, Callable[[DrawnFrame], Image]] = {
    "segmentation": _segmentation,
    "contours": _only(Part.TISSUE, Part.INSTRUMENT),
    "marker": _marker,
    "matches": _matches,
    "outline and distance": _result,
    "edges": _only(Part.SHAFT),
    "tip": _only(Part.MARKER, Part.TIP),
    "tag": _only(Part.TAG),
    "surface": _surface,
    "distance": _result,
}


def _titled(name: str, pixels: Image) -> Image:
    scale = max(0.6, pixels.shape[1] / 1100.0)
    (_, height), below = cv2.getTextSize("Mg", FONT, scale, 1)
    bar = np.full((height + below + 12, pixels.shape[1], 3), DARK, np.uint8)
    cv2.putText(bar, name, (8, height + 6), FONT, scale, WHITE, 1, cv2.LINE_AA)
    return np.vstack([bar, pixels])


def _grid(panels: Sequence[Image]) -> Image:
    columns = min(len(panels), 2 if len(panels) in (2, 4) else COLUMNS)
    height, width = panels[0].shape[:2]
    rows = -(-len(panels) // columns)
    sheet = np.full((rows * height, columns * (width + 4), 3), DARK, np.uint8)
    for at, panel in enumerate(panels):
        y, x = at // columns * height, at % columns * (width + 4)
        sheet[y : y + height, x : x + width] = panel
    return sheet


def _under(lines: Sequence[str], pixels: Image) -> Image:
    scale = 0.7
    (_, height), below = cv2.getTextSize("Mg", FONT, scale, 1)
    step = height + below + 8
    bar = np.full((step * len(lines) + 8, pixels.shape[1], 3), DARK, np.uint8)
    for at, line in enumerate(lines):
        place = (8, at * step + height + 6)
        cv2.putText(bar, printable(line), place, FONT, scale, WHITE, 1, cv2.LINE_AA)
    return np.vstack([bar, pixels])
