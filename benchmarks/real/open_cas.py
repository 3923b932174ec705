"""UCL/scikit-surgerysurfacematch: a pair of a stereo laparoscope over a liver of silicone, and the liver's CT.

The pair is one of OpenCAS (Maier-Hein et al. 2014, IEEE TMI). The CT is in the left camera's frame, and its part inside
of the authors' mask is the truth. The lens is given twice: with eight coefficients, and with the first five of them,
whose rows bend by some px.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import trimesh

import svmdist
from benchmarks.real import common, peer
from svmdist.transforms import Array

SET = Path("scikit-surgerysurfacematch", "tests", "data", "open_cas_tmi", "Stereo_SD_d_complete_22")
NAME = "Stereo_SD_d_complete_22_{}"
SIDES = ("left", "right")
COEFFICIENTS = slice(11, 19)  # of a camera's numbers in the authors' file
COUNT, NUMBERS = 3, 31  # copies of the pair, as a log needs more than one; and numbers of a camera
NEAR_PX = 5  # side of what a point covers: they are 4 px apart


def measure(folder: Path, out: Path) -> Iterator[common.Line]:
    """Points of the surface inside of the mask, by `surface` and by semi-global matching, against the CT."""
    root = folder / SET
    given = [float(word) for word in (root / NAME.format("Calibration.txt")).read_text("utf-8").split()[2:]]
    K = [np.loadtxt(root / f"calib.{side}.intrinsics.txt") for side in SIDES]
    whole = [np.array(given[at * NUMBERS :][COEFFICIENTS])[None] for at in (0, 1)]
    first = [np.loadtxt(root / f"calib.{side}.distortion.txt")[None] for side in SIDES]
    paths = [root / NAME.format(f"IMG_{side}.bmp") for side in SIDES]
    T = np.loadtxt(root / "calib.l2r.txt")
    liver: Any = trimesh.load(root / NAME.format("CT_cut.stl"))
    mask = common.read(root / NAME.format("MASK_eval.png"))[..., 0] == 0
    images = [common.copied([path] * COUNT, out / side) for path, side in zip(paths, SIDES, strict=True)]
    for name, D in (("CT", whole), ("CT, half a lens", first)):
        calibration = out / f"{len(D[0][0])}.yaml"
        common.write_calibration(calibration, K, D, T)
        options = ("--calibration", calibration, "--unit", "mm", "--rate", 1)
        log, profile = common.make_log(calibration.with_suffix(".mcap"), *images, *options)
        seen = svmdist.surface(svmdist.open_recording(log, profile), 0)
        on, covered = inside(1e3 * seen.points_m, K[0], D[0], mask)
        off_mm = distances(liver, 1e3 * seen.points_m[on])
        in_95 = off_mm < 1.96e3 * seen.std_m[on]
        points_mm = peer.surface([common.read(path) for path in paths], K, D, T)
        by_peer_mm = distances(liver, points_mm[inside(points_mm, K[0], D[0], mask)[0]])
        counts = f"{len(off_mm)} points, {covered:.0%}", f"{len(by_peer_mm)} points"
        own = common.Figures(counts[0], "mm", off_mm, (), in_95)
        yield common.Line("liver", "`surface`", name, own, common.Figures(counts[1], "mm", by_peer_mm))


def inside(points: Array, K: Array, D: Array, mask: common.Mask) -> tuple[common.Mask, float]:
    """Which points, (n, 3), a view shows inside of a mask, (h, w), and how much of that is near one."""
    seen = np.zeros(mask.shape, np.uint8)
    if not len(points):
        return np.zeros(0, bool), 0.0
    pixels = cv2.projectPoints(points[:, None], np.zeros(3), np.zeros(3), K, D)[0][:, 0]
    x, y = np.rint(pixels.clip(-1e6, 1e6)).astype(int).T
    height, width = mask.shape
    is_there = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    x, y = x.clip(0, width - 1), y.clip(0, height - 1)
    seen[y[is_there], x[is_there]] = 1
    near = cv2.dilate(seen, np.ones((NEAR_PX, NEAR_PX), np.uint8)) > 0
    return np.asarray(is_there & mask[y, x]), float(near[mask].mean())


def distances(surface: Any, points: Array) -> Array:
    """Of points, (n, 3), from a surface."""
    return np.asarray(surface.nearest.on_surface(points)[1] if len(points) else np.zeros(0))
