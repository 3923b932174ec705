"""The phases of a method on one frame, each as a panel: the picture that explains a figure."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np

from svmdist.drawing import COLOURS, Part
from svmdist.report.canvas import DARK, FONT, WHITE
from svmdist.report.frame_picture import bgr, draw_on
from svmdist.report.text import printable
from svmdist.samples import Image
from svmdist.vision.marker.features import EDGE_MARGIN_PX
from svmdist.vision.marker.pattern import padded_template
from svmdist.workflows.annotate import DrawnFrame
from svmdist.workflows.drawing.virtual_marker import virtual_marker

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
    return METHOD_PHASES[method]


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
    recorded = "regions_as_recorded" in first.tool.found
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


_PHASES: dict[str, Callable[[DrawnFrame], Image]] = {
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
METHOD_PHASES: dict[str, tuple[str, ...]] = {
    "overlay": ("segmentation", "contours", "marker", "matches", "outline and distance"),
    "centroid": ("segmentation", "contours", "distance"),
    "fiducial": ("segmentation", "tag", "distance"),
    "shaft": ("segmentation", "edges", "tip", "distance"),
    "stereo": ("segmentation", "tip", "surface", "distance"),
    "kinematic": ("segmentation", "distance"),
    "fused": ("segmentation", "edges", "tip", "tag", "surface", "distance"),
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
