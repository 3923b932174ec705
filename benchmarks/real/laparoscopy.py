"""MahBadran93/Laparoscopic-Tools-Processing: five laparoscopic frames of 1920x1080 with the shaft's mid-line and end.

The labels are those of Art-Net: masks of the whole instrument, of the shaft's mid-line and of where its insulation
ends. No calibration comes with it: f = 1100 px is assumed, so that figures are pixels.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.real import common, peer
from svmdist.profile import load_profile
from svmdist.transforms import Array
from svmdist.vision.instruments.evidence import picture_of

SET = Path("Laparoscopic-Tools-Processing", "Art-Net", "AnnotationFullData", "TestAnnotation")
K = common.K_of(1100.0, 1100.0, 959.5, 539.5)
SHOWN_M = 0.05
"""How much of the shaft, from its end, is compared with the labelled mid-line."""


def measure(folder: Path, out: Path) -> Iterator[common.Line]:
    """Rows of `shaft` against the mid-line, its direction, and the shaft's end."""
    paths = sorted((folder / SET / "PositiveImage").glob("*.png"))
    views = (common.copied(paths, out / "images"), "--rate", 1, "--camera", "1100,1100,959.5,539.5")
    log, path = common.make_log(out / "laparoscopy.mcap", *views, instrument="laparoscopic-5mm")
    profile = load_profile(path)
    assert profile.instrument is not None
    rows, total = common.rows_of(log, profile, "shaft")
    pictures = [common.read(one) for one in paths]
    masks = {kind: [labelled(folder, kind, one) for one in paths] for kind in ("toolmask", "MidLine", "Tooltip")}
    labelled_end_px = [np.argwhere(mask).mean(0)[::-1] for mask in masks["Tooltip"]]
    end_m = profile.instrument.shaft_end_m or 0.0
    beside_px, turned_deg, end_px, on = [], [], [], []
    for row in rows:
        pose, n = common.pose_of(row), row.number
        middle, along = line_through(masks["MidLine"][n])
        hinge_m = pose.position_m if pose.hinge is None else pose.hinge.position_m
        back_m = end_m + SHOWN_M * np.linspace(0.0, 1.0, 20)[:, None]
        shown = common.pixel(hinge_m - back_m * pose.axis, K)
        beside_px.append(float(np.abs((shown - middle) @ [-along[1], along[0]]).mean()))
        cosine = abs(float((shown[-1] - shown[0]) @ along)) / float(np.linalg.norm(shown[-1] - shown[0]))
        turned_deg.append(float(np.degrees(np.arccos(min(1.0, cosine)))))
        end_px.append(float(np.linalg.norm(shown[0] - labelled_end_px[n])))
        seen, lit = masks["toolmask"][n], picture_of(pictures[n]) > 0
        on.append(common.on_instrument(pose, K, seen, profile.instrument.shaft_radius_m, lit | seen))
    found = peer.found(pictures, K, profile.instrument.shaft_radius_m)
    ends = [float(np.linalg.norm(rod.end_px - labelled_end_px[n])) for n, rod in found]
    count = f"{len(rows)}/{total}"
    yield common.Line("laparoscopy", "`shaft`", "mid-line", common.Figures(count, "px", beside_px, on))
    yield common.Line("laparoscopy", "`shaft`", "its direction", common.Figures(count, "°", turned_deg))
    other = peer.figures(found, masks["toolmask"], "px", ends)
    yield common.Line("laparoscopy", "`shaft`", "shaft's end", common.Figures(count, "px", end_px), other)


def labelled(folder: Path, kind: str, path: Path) -> common.Mask:
    """Where an image's label of a kind is, shape (h, w)."""
    return np.asarray(common.read(folder / SET / kind / path.name)[..., 0] > 127)


def line_through(mask: common.Mask) -> tuple[Array, Array]:
    """The middle of a line that a mask shows, and its unit direction, (2,) each, in px."""
    places = np.argwhere(mask)[:, ::-1].astype(float)
    middle = places.mean(0)
    return middle, np.linalg.svd(places - middle, full_matrices=False)[2][0]
