"""A frame in panels, one for each phase of a method, or its masks, and the nearest clearance from the side."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import cv2
import numpy as np

from svmdist.drawing import COLOURS, WHITE, Form, FrameDrawing, Label, Part, Shape
from svmdist.estimation.methods import REGISTRY, Phase
from svmdist.geometry import Mesh, Plane
from svmdist.report.on_image import DARK, bgr, draw_on, enlarged, text_size, under, whole, write_text
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.marker import EDGE_MARGIN_PX, padded_template
from svmdist.workflows.frame_drawing import DrawnFrame, contours_of, virtual_marker

COLUMNS, TINT = 2, 0.6
PANEL_LETTERS = 1 / 34  # two panels stand side by side on a page
PANEL_PX, MASKS_PX = 600, 900
"""Least widths of a panel and of a picture of masks: smaller images are enlarged, so that letters hide less of them."""
NEAR_FAR_PERCENT = (5.0, 95.0)
SIDE_REACH_M, SLANT = 0.009, 0.3
"""Half of the least height of a side view; and the slope over which a clearance runs across the depth, too."""
CUT_REACH_M = 0.001  # points of a surface so near to a cut are shown in it
BAR_LENGTHS_MM = (1, 2, 5, 10, 20, 50, 100)


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
    lines = [(title, WHITE)]
    shapes, labels = list[Shape](), list[Label]()
    named = {"tissue": (Part.TISSUE, masks.tissue), "shaft": (Part.SHAFT, masks.shaft),
             "distal part": (Part.WRIST, masks.instrument)}  # fmt: skip
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
                labels.append(Label(Part.WRIST, places.mean(0), one.arm.profile.instrument_name))
    else:
        owners = [_owner(frame, seen.mask) for seen in masks.seen]
        lines += [] if masks.seen else [("no instrument", WHITE)]
        lines.append(("lines: sides of each shaft", COLOURS[Part.SHAFT]))
        lines.append(("dots: its end, and the tip", COLOURS[Part.TIP]))
        lines += [("other instruments", COLOURS[Part.OTHER])] if any(owners) and not all(owners) else []
        for at, (seen, owner) in enumerate(zip(masks.seen, owners, strict=True)):
            part = Part.SHAFT if owner or not any(owners) else Part.OTHER
            shapes += [Shape(part, Form.LINE, np.asarray(side)) for side in seen.sides]
            shapes.append(Shape(Part.TIP, Form.POINTS, np.stack([seen.end_px, seen.tip_px])))
            place_px = 0.5 * (seen.entry_px + seen.end_px)
            labels.append(Label(part, place_px, f"{owner or f'instrument {at + 1}'}  {seen.evidence:.2f}"))
    drawing = FrameDrawing(frame.drawing.stamp_ns, tuple(shapes), tuple(labels))
    return under(lines, draw_on(_tinted(image, list(named.values())), drawing, least_px=MASKS_PX))


def _owner(frame: DrawnFrame, mask: Image) -> str:
    """The instrument whose masks have this one; empty where it is none, or several."""
    found = ((one.arm.profile.instrument_name, one.left.masks.seen or ()) for one in frame.replayed.frames)
    owners = [name for name, seen in found if any(np.shares_memory(own.mask, mask) for own in seen)]
    return owners[0] if len(owners) == 1 else ""


def phases_picture(frame: DrawnFrame, title: str, method: str = "") -> Image:
    """All phases of a method in a grid, shape (h, w, 3) in BGR; of a frame that could not be read its status only."""
    lines = [(title, WHITE), *((one.text, one.colour) for one in frame.drawing.lines)]
    image = frame.replayed.image_bgr
    if image is None or not frame.replayed.frames:
        return under(lines, np.zeros((40, 960, 3), np.uint8))
    panels = []
    for name in REGISTRY[method].draws:
        phase, scale = _PHASES[name], None
        if isinstance(phase, tuple):
            panel = draw_on(image, frame.drawing, parts=phase, lines=False, least_px=PANEL_PX, letters=PANEL_LETTERS)
            depths_m = [one.start_m[2] for one in frame.drawing.segments]
            if phase is _RESULT and depths_m:
                fx = frame.replayed.frames[0].scene.lens.K[0, 0] * panel.shape[1] / image.shape[1]
                scale = fx / float(np.mean(depths_m)), "at the tip's depth"
        elif phase is not _side_view:
            panel = enlarged(phase(frame, np.array(image)), PANEL_PX)
        elif (seen := _side_view(frame, image)) is not None:
            panel, scale = seen[0], (seen[1], "(camera above)")
        else:
            continue
        panel = under([(name, WHITE)], panel, PANEL_LETTERS)
        panels.append(panel if scale is None else _with_scale(panel, *scale))
    columns = min(len(panels), COLUMNS)
    height, width = panels[0].shape[:2]
    sheet = np.full((-(-len(panels) // columns) * height, columns * (width + 4), 3), DARK, np.uint8)
    for at, panel in enumerate(panels):
        y, x = at // columns * height, at % columns * (width + 4)
        sheet[y : y + height, x : x + width] = panel
    return under(lines, sheet, 1.15 * PANEL_LETTERS / columns)


def _segmentation(frame: DrawnFrame, _: Image) -> Image:
    first = frame.replayed.frames[0]
    recorded = "regions_as_recorded" in vars(first.left)
    parts: list[tuple[Part, Image | None]] = []
    for one in frame.replayed.frames:
        masks = one.left.masks_as_recorded if recorded else one.left.masks
        parts += [] if parts else [(Part.TISSUE, masks.tissue)]
        parts += [(Part.WRIST, masks.instrument), (Part.SHAFT, None if recorded else masks.shaft)]
    return _tinted(first.scene.observation.image_bgr, parts)


def _marker(frame: DrawnFrame, pixels: Image) -> Image:
    for found in filter(None, map(virtual_marker, frame.replayed.frames)):
        x, y = found.origin_px
        shift, border = np.array([[1.0, 0.0, x], [0.0, 1.0, y]]), cv2.BORDER_TRANSPARENT  # what is beside it stays
        cv2.warpAffine(found.window_bgr, shift, pixels.shape[1::-1], pixels, cv2.INTER_NEAREST, border)
        for x_px, y_px in np.add(found.features.points_px, (x, y)):
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
    left, right = cv2.cvtColor(template, cv2.COLOR_GRAY2BGR), found.window_bgr
    both = np.hstack([left, np.full((left.shape[0], 20, 3), DARK, np.uint8), right[: left.shape[0]]])
    times = max(1, min(width // both.shape[1], height // both.shape[0]))
    large = cv2.resize(both, None, fx=times, fy=times, interpolation=cv2.INTER_NEAREST)
    matches, offset = found.matches, [left.shape[1] + 20.0, 0.0]
    starts, ends = matches.template_px + EDGE_MARGIN_PX, matches.frame_px + offset
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
    if (cloud_m := frame.drawing.cloud_m) is None:
        return pixels
    depth_m, lens = cloud_m[:, 2], frame.replayed.frames[0].scene.lens
    near_m, far_m = np.percentile(depth_m, NEAR_FAR_PERCENT)
    share = np.clip((far_m - depth_m) / max(far_m - near_m, 1e-9), 0.0, 1.0)
    colours = cv2.applyColorMap((255 * share).astype(np.uint8)[:, None], cv2.COLORMAP_VIRIDIS)[:, 0]
    for place, colour in zip(lens.project(cloud_m), colours.tolist(), strict=True):
        cv2.circle(pixels, (round(place[0]), round(place[1])), 2, colour, cv2.FILLED)
    return pixels


def _side_view(frame: DrawnFrame, pixels: Image) -> tuple[Image, float] | None:
    """The nearest clearance from the side, cut along it or the shaft, and the scale in px per m; None without any."""
    drawing = frame.drawing
    bodies = {f"{name} {Part.DISTANCE}": body for name, body in drawing.bodies.items()}
    pairs = [(one, bodies[one.name]) for one in drawing.segments if one.name in bodies]
    if not pairs:
        return None
    segment, body = min(pairs, key=lambda one: float(np.linalg.norm(one[0].end_m - one[0].start_m)))
    along_m, middle_m = segment.end_m - segment.start_m, 0.5 * (segment.start_m + segment.end_m)
    length_m, shaft_m = float(np.linalg.norm(along_m)), body.end_m[0] - body.start_m[0]
    across = along_m if np.linalg.norm(along_m[:2]) > SLANT * length_m else shaft_m
    right = np.array([across[0], across[1], 0.0]) / max(float(np.linalg.norm(across[:2])), 1e-9)
    right *= 1.0 if right[0] >= 0.0 else -1.0
    canvas = np.full_like(enlarged(pixels, PANEL_PX), DARK)
    height, width = canvas.shape[:2]
    px_per_m = 0.5 * height / max(SIDE_REACH_M, 1.5 * length_m)
    axes = np.stack([right, [0.0, 0.0, 1.0]], 1) * px_per_m  # depth runs down
    # The contact stands aside, so that there is room for its label.
    place_px = np.array([(0.64 if shaft_m @ right < 0.0 else 0.36) * width, 0.5 * height])

    def seen(points_m: Array) -> Array:
        return np.asarray((points_m - middle_m) @ axes + place_px)

    normal = np.cross(right, [0.0, 0.0, 1.0])
    shapes = [Shape(Part.TISSUE, Form.LINE, seen(cut)) for cut in _cut(drawing, middle_m, normal)]
    if drawing.cloud_m is not None:
        is_near = np.abs((drawing.cloud_m - middle_m) @ normal) < CUT_REACH_M
        shapes.append(Shape(Part.TISSUE, Form.POINTS, seen(drawing.cloud_m[is_near])))
    filled = {part: np.zeros((height, width), np.uint8) for part in (Part.SHAFT, Part.WRIST)}
    circle = np.array(cv2.ellipse2Poly((0, 0), (1000, 1000), 0, 0, 360, 12)) * 1e-3
    around = px_per_m * body.radius_m[:, None, None] * circle
    outlines_px = np.concatenate([seen(one)[:, None] + around for one in (body.start_m, body.end_m)], 1)
    capsules = np.column_stack([body.end_m - body.start_m, body.radius_m])
    for at in range(len(body)):
        # Equal capsules side by side model a plate or a blade: the gap between two of them is filled, too.
        first = at - 1 if at and np.allclose(capsules[at], capsules[at - 1]) else at
        hull = cv2.convexHull(whole(np.concatenate(outlines_px[first : at + 1])))
        cv2.fillConvexPoly(filled[Part.WRIST if at else Part.SHAFT], hull, 255)
    filled[Part.WRIST][filled[Part.SHAFT] > 0] = 0
    shapes += [outline for part, mask in filled.items() for outline in contours_of(mask, part)]
    canvas = _tinted(canvas, list(filled.items()))
    ends_px = seen(np.stack([segment.start_m, segment.end_m]))
    shapes.append(Shape(Part.DISTANCE, Form.LINE, ends_px))
    label = Label(Part.DISTANCE, ends_px.mean(0), f"{segment.name.removesuffix(Part.DISTANCE)}{segment.text}")
    return draw_on(canvas, FrameDrawing(drawing.stamp_ns, tuple(shapes), (label,)), letters=PANEL_LETTERS), px_per_m


def _cut(drawing: FrameDrawing, through_m: Array, normal: Array) -> list[Array]:
    """Where a plane through a point (3,) with a normal (3,) cuts the tissue: lines, shape (2, 3) each, in m."""
    surface = drawing.tissue
    if isinstance(surface, Plane):
        along = np.cross(surface.normal, normal)
        foot_m = through_m + (surface.offset_m - surface.normal @ through_m) * surface.normal
        return [np.stack([foot_m - along, foot_m + along])]
    if not isinstance(surface, Mesh):
        return []
    a_m = surface.triangles_m
    b_m = np.roll(a_m, -1, axis=1)
    off_a, off_b = (a_m - through_m) @ normal, (b_m - through_m) @ normal
    is_cut = (off_a < 0.0) != (off_b < 0.0)  # two edges of a face, or none
    share = (off_a / np.where(is_cut, off_a - off_b, 1.0))[..., None]
    return list((a_m + share * (b_m - a_m))[is_cut].reshape(-1, 2, 3))


def _with_scale(panel: Image, px_per_m: float, where: str) -> Image:
    """A panel with a scale bar in its title, and what it holds for."""
    letter_px, width = PANEL_LETTERS * panel.shape[1], panel.shape[1]
    length_mm = max((mm for mm in BAR_LENGTHS_MM if mm * 1e-3 * px_per_m <= 0.25 * width), default=BAR_LENGTHS_MM[0])
    text = f"{length_mm} mm {where}"
    left = round(width - text_size(text, letter_px)[2] - letter_px)
    write_text(panel, text, (left, 1.5 * letter_px), letter_px, WHITE)
    right, middle = round(left - letter_px), round(letter_px)
    begin = round(right - length_mm * 1e-3 * px_per_m)
    cv2.line(panel, (begin, middle), (right, middle), WHITE, max(2, round(0.3 * letter_px)))
    return panel


_RESULT = (Part.TIP, Part.TISSUE, Part.MARKER, Part.DISTAL_MARKER, Part.POSE, Part.DISTANCE, Part.BETWEEN)
_PHASES: dict[Phase, Callable[[DrawnFrame, Image], Any] | tuple[Part, ...]] = {
    "segmentation": _segmentation,
    "contours": (Part.TISSUE, Part.WRIST),
    "marker": _marker,
    "matches": _matches,
    "outline and distance": _RESULT,
    "edges and tip": (Part.SHAFT, Part.DISTAL_MARKER, Part.TIP),
    "tip": (Part.DISTAL_MARKER, Part.TIP),
    "tag": (Part.TAG,),
    "surface": _surface,
    "distance": _RESULT,
    "side view": _side_view,
}
"""What each phase draws on a copy of the image: a function's picture, or these parts of the drawing."""
