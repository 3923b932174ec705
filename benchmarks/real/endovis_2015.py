"""EndoVis 2015 (Warlord437/Surgical-Image-Segmentation): 71 images of six operations with masks drawn by people.

No row may lie beside an instrument, and a shaft is as wide as its mask: what its width is off, its depth is. No
calibration comes with it: f = 512 px, 0.8 of the width, is assumed.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks import masks
from benchmarks.real import common, peer
from svmdist.camera import Camera
from svmdist.estimation.instrument.model import shaft_sections
from svmdist.geometry import Capsules
from svmdist.profile import load_profile
from svmdist.results import Z_95, ToolPose

SET = Path("Surgical-Image-Segmentation")
SIZE_PX = (640, 480)
K = common.K_of(512.0, 512.0, 319.5, 239.5)
LABEL_STD = 0.03
"""Of a mask's width over a shaft's: one or two px of 60."""
NEXT_TO_END = 0.35
"""Of the visible shaft: the part next to its end, whose depth is the tool's."""
LEAST_SECTIONS = 4
"""Whose sides both are in the picture and at the mask's border."""


def measure(folder: Path, out: Path) -> Iterator[common.Line]:
    """Rows of `shaft`, one an image at most, and how many of them lie on an instrument."""
    pictures, seen = zip(*masks.SETS["EndoVis 2015"][2](folder / SET), strict=True)
    images = common.copied(sorted((folder / SET).glob(masks.ENDOVIS_2015)), out / "images")
    numbers = ("--rate", 0.1, "--camera", "512,512,319.5,239.5")
    log, path = common.make_log(out / "endovis-2015.mcap", images, *numbers, instrument="laparoscopic-5mm")
    instrument = load_profile(path).instrument
    assert instrument is not None
    rows, total = common.rows_of(log, path, "shaft")
    radius_m = instrument.shaft_radius_m
    on = common.on_instruments(rows, K, pictures, seen, radius_m)
    camera = Camera(*SIZE_PX, K)
    widths = [_width_over_mask(common.pose_of(row), camera, seen[row.number], radius_m) for row in rows]
    known = [(common.pose_of(row), width) for row, width in zip(rows, widths, strict=True) if width is not None]
    deviations = [np.hypot(LABEL_STD, np.sqrt(pose.covariance[2, 2]) / pose.position_m[2]) for pose, _ in known]
    off = np.abs(np.log([width for _, width in known]))
    inside = off <= Z_95 * np.array(deviations)
    other = peer.figures(peer.found(pictures, K, radius_m), seen)
    figures = common.Figures(f"{len(rows)}/{total}", "%", 100.0 * off, on, inside)
    yield common.Line("EndoVis 2015", "`shaft`", "masks; width", figures, other)


def _width_over_mask(pose: ToolPose, camera: Camera, mask: common.Mask, radius_m: float) -> float | None:
    """The projected shaft's width next to its end over that of the mask, (h, w); None where few sections show it."""
    end_m = pose.position_m if pose.hinge is None else pose.hinge.position_m
    body = Capsules(end_m[None], (end_m - 0.2 * pose.axis)[None], np.array([radius_m]))
    sections = shaft_sections(camera, body)
    if sections is None:
        return None
    away = np.arange(0.0, 2.5, 0.01)  # from the middle, in half widths
    ratios = []
    for middle, across, half_px in zip(sections.middles_px, sections.across, sections.half_px, strict=True):
        ends = []
        for outward in (-across, across):
            at = np.rint(middle + half_px * away[:, None] * outward).astype(int)
            if not ((at >= 0) & (at < SIZE_PX)).all():
                break
            is_shown = mask[at[:, 1], at[:, 0]]
            if not is_shown[0] or is_shown.all():
                break
            ends.append(away[int(np.argmin(is_shown))])
        ratios += [0.5 * sum(ends)] if len(ends) == 2 else []
    near = ratios[: max(LEAST_SECTIONS, round(NEXT_TO_END * len(ratios)))]
    return 1.0 / float(np.median(near)) if len(near) >= LEAST_SECTIONS else None
