"""The README's picture of a frame in 3D: instruments as `fused` models them, and the shortest separations.

Everything drawn comes from estimates; the log's truth is not read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import cv2
import matplotlib.patheffects as effects
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from svmdist.camera import Camera
from svmdist.estimation.frame import Frame
from svmdist.geometry.separation import Separation, capsule_separation, separation
from svmdist.geometry.surfaces import Capsules
from svmdist.recording.reader import Recording
from svmdist.results import Distance, FrameResult
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.workflows.replay import replay
from svmdist.workflows.setup import Setup

Align = Literal["left", "center", "right"]
COLOURS = ("#ffd166", "#4cc9f0")
BETWEEN_COLOUR = "#ffffff"
Z95 = 1.96
NEAR_M = 0.03
"""Of a shaft that reaches behind the camera, the part up to so near is drawn."""
AXIS_M = 0.030
NAME_AT_PX = 26.0
PIXELS_PER_PIXEL = 2


@dataclass(frozen=True)
class Shown:
    """One instrument in one frame: its result, the model's capsules, and where the tissue is nearest.

    Behind the first `bare_count` capsules come the rods of the tag's plate.
    """

    result: FrameResult
    body: Capsules
    bare_count: int
    gap: Separation


def shown_in(recording: Recording, setup: Setup, index: int) -> tuple[Image, Camera, list[Shown]]:
    """Estimate up to the frame of an index, and take what the picture shows of it."""
    for number, (replayed,) in enumerate(replay(recording, [setup])):
        if number == index and replayed.frames:
            left = replayed.frames[0].left
            shown = [_shown(*each) for each in zip(replayed.results, replayed.frames, strict=True)]
            return left.context.bgr_as_recorded, left.camera, shown
    raise SystemExit(f"{recording.name} has no frame {index}")


def _shown(result: FrameResult, frame: Frame) -> Shown:
    tool, model, tissue = result.tool, frame.arm.body, frame.scene.tissue
    assert tool is not None
    assert model is not None
    assert tissue is not None
    assert tissue.pose is not None
    body = model.posed(tool.pose, tool.joints, tool.has_plate)
    bare_count = len(model.posed(tool.pose, tool.joints))
    return Shown(result, body, bare_count, separation(body, tissue.pose.surface))


def draw_scene(
    image_bgr: Image, camera: Camera, names: Sequence[str], instruments: Sequence[Shown]
) -> Figure:
    """Draw models, axes and separations over the image; two pixels for each of the image's."""
    height_px, width_px = image_bgr.shape[:2]
    dpi = 160
    figure = Figure(figsize=(PIXELS_PER_PIXEL * width_px / dpi, PIXELS_PER_PIXEL * height_px / dpi), dpi=dpi)
    axes = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    axes.imshow(cv2.cvtColor(image_bgr, cv2.COLOR_BGR2RGB), interpolation="bicubic")
    axes.set_axis_off()
    for name, shown, colour in zip(names, instruments, COLOURS, strict=True):
        _draw_model(axes, camera, shown, colour, (height_px, width_px))
        _draw_axis(axes, camera, name, shown, colour)
    for shown, colour in zip(instruments, COLOURS, strict=True):
        _draw_gap(axes, camera, shown.gap, colour)
    first, second = instruments
    between = capsule_separation(first.body, second.body)
    _draw_gap(axes, camera, between, BETWEEN_COLOUR)
    told = [
        *(
            (f"{name} to tissue", shown.result.distances.clearance)
            for name, shown in zip(names, instruments, strict=True)
        ),
        (" to ".join(names), first.result.distances.to_instrument),
    ]
    _draw_panel(axes, told)
    axes.set_xlim(-0.5, width_px - 0.5)
    axes.set_ylim(height_px - 0.5, -0.5)
    return figure


def _draw_model(axes: Axes, camera: Camera, shown: Shown, colour: str, shape: tuple[int, int]) -> None:
    """The union of the capsules' silhouettes, the plate as a whole, found on a finer grid than the image's."""
    fine, body = 4, shown.body
    outlines = [
        _silhouette_px(camera, start, end, float(radius_m))
        for start, end, radius_m in zip(body.start_m, body.end_m, body.radius_m, strict=True)
    ]
    parts, plate = outlines[: shown.bare_count], outlines[shown.bare_count :]
    mask = np.zeros((shape[0] * fine, shape[1] * fine), np.uint8)
    for part in [*parts, np.concatenate(plate)] if plate else parts:
        hull = cv2.convexHull(part.astype(np.float32))
        cv2.fillPoly(mask, [np.round((hull + 0.5) * fine).astype(np.int32)], 255)
    for contour in cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]:
        xy = contour[:, 0] / fine - 0.5
        axes.fill(xy[:, 0], xy[:, 1], facecolor=colour, alpha=0.22, linewidth=0)
        axes.plot(*np.vstack([xy, xy[:1]]).T, color=colour, linewidth=1.4)


def _silhouette_px(camera: Camera, start: Array, end: Array, radius_m: float) -> Array:
    """Pixels of points all over a capsule's end spheres, shape (n, 2): their hull is its silhouette."""
    if min(start[2], end[2]) < NEAR_M < max(start[2], end[2]):
        cut = start + (NEAR_M - start[2]) / (end[2] - start[2]) * (end - start)
        start, end = (start, cut) if start[2] > end[2] else (cut, end)
    azimuth, polar = np.meshgrid(np.linspace(0, 2 * np.pi, 48), np.linspace(0, np.pi, 25))
    sphere = np.stack(
        [np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)], -1
    ).reshape(-1, 3)
    return camera.project(np.vstack([start + radius_m * sphere, end + radius_m * sphere]))


def _draw_axis(axes: Axes, camera: Camera, name: str, shown: Shown, colour: str) -> None:
    assert shown.result.tool is not None
    pose = shown.result.tool.pose
    tool, along = pose.position_m, pose.axis
    points = camera.project(np.stack([tool - AXIS_M * along, tool]))
    axes.plot(*points.T, color=colour, linewidth=1.6, linestyle=(0, (6, 3)))
    axes.plot(
        *points[1], marker="o", markersize=5, color=colour, markeredgecolor="black", markeredgewidth=0.8
    )
    outward = (points[0] - points[1]) / np.linalg.norm(points[0] - points[1])
    _label(axes, points[0] + NAME_AT_PX * outward, name, colour, "center")


def _draw_gap(axes: Axes, camera: Camera, gap: Separation, colour: str) -> None:
    ends = camera.project(np.stack([gap.on_instrument_m, gap.on_tissue_m]))
    axes.plot(*ends.T, color="black", linewidth=5.0, solid_capstyle="round")
    axes.plot(*ends.T, color=colour, linewidth=2.6, solid_capstyle="round")
    axes.plot(*ends.T, linestyle="", marker="o", markersize=5, color=colour, markeredgecolor="black")


def _draw_panel(axes: Axes, told: Sequence[tuple[str, Distance | None]]) -> None:
    """Every separation's value and 95 % interval, in the colour of its line."""
    _label(axes, np.array([14, 20]), "shortest separations and their 95 % intervals", "#ffffff")
    for line, ((name, distance), colour) in enumerate(zip(told, (*COLOURS, BETWEEN_COLOUR), strict=True)):
        assert distance is not None
        assert distance.std_m is not None
        distance_m, std_m = distance.value_m, distance.std_m
        low_mm, high_mm = (1e3 * (distance_m + side * Z95 * std_m) for side in (-1.0, 1.0))
        cells: tuple[tuple[int, str, Align], ...] = (
            (14, name, "left"),
            (208, f"{distance_m * 1e3:.1f} mm", "right"),
            (344, f"{low_mm:.1f} – {high_mm:.1f} mm", "right"),
        )
        for x_px, text, align in cells:
            _label(axes, np.array([x_px, 44 + 24 * line]), text, colour, align)


def _label(axes: Axes, at_px: Array, text: str, colour: str, align: Align = "left") -> None:
    axes.text(
        float(at_px[0]),
        float(at_px[1]),
        text,
        color=colour,
        ha=align,
        va="center",
        fontsize=12,
        fontweight="bold",
        path_effects=[effects.withStroke(linewidth=3, foreground="#1a1a1a")],
    )


def save_scene_picture(recording: Recording, setup: Setup, index: int, path: Path) -> None:
    """Save the picture of one frame."""
    image_bgr, camera, instruments = shown_in(recording, setup, index)
    draw_scene(image_bgr, camera, recording.instruments, instruments).savefig(
        path, pil_kwargs={"quality": 90}
    )
