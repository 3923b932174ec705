"""UCL/scikit-surgerycalibration: a tracked stereo laparoscope before a board of ChArUco squares, with the board's pose.

The board is taken for tissue: its plane, by the authors' pose in the left camera, is the truth of the measured surface.
Their hand-eye is of the board in a tracker's frame, not of a tool, and is not comparable with `svmdist hand-eye`.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np

import svmdist
from benchmarks.real import common, peer
from svmdist.transforms import Array

SET = Path("scikit-surgerycalibration", "tests", "data", "precalib")
SCENES, COUNT = ("precalib_base_data", "data_moved_scope"), 3


def measure(folder: Path, out: Path) -> Iterator[common.Line]:
    """Points of the surface that are on the board, by `surface` and by semi-global matching."""
    own_mm: list[Array] = []
    peer_mm: list[Array] = []
    inside: list[Array] = []
    for scene in SCENES:
        root, images = folder / SET / scene, out / scene
        images.mkdir(parents=True, exist_ok=True)
        K, D = zip(*(camera(root, side) for side in ("left", "right")), strict=True)
        T = np.loadtxt(root / "calib.l2r.txt")
        common.write_calibration(out / f"{scene}.yaml", K, D, T)
        paths = {side: [root / f"calib.{side}.images.{n}.png" for n in range(COUNT)] for side in ("left", "right")}
        folders = [common.copied(found, images / side) for side, found in paths.items()]
        calibrated = ("--calibration", out / f"{scene}.yaml", "--unit", "mm", "--rate", 1)
        log, profile = common.make_log(out / f"{scene}.mcap", *folders, *calibrated)
        recording = svmdist.open_recording(log, profile)
        for n in range(COUNT):
            board = np.loadtxt(root / f"calib.left.extrinsics.{n}.txt")
            corners = np.loadtxt(root / f"calib.left.object_points.{n}.txt")
            hull_px = np.asarray(
                cv2.convexHull(common.pixel(corners @ board[:3, :3].T + board[:3, 3], K[0]).astype(np.float32)),
                np.float64,
            )
            seen = svmdist.surface(recording, n)
            on = on_board(seen.points_m, hull_px, K[0])
            off_mm = (1e3 * seen.points_m[on] - board[:3, 3]) @ board[:3, 2]
            along = np.abs(seen.points_m[on] @ board[:3, 2]) / np.linalg.norm(seen.points_m[on], axis=1)
            inside.append(np.abs(off_mm) < 1.96e3 * seen.std_m[on] * along)
            own_mm.append(np.abs(off_mm))
            views = [common.read(found[n]) for found in paths.values()]
            points_mm = peer.surface(views, K, D, T)
            on = on_board(points_mm, hull_px, K[0])
            peer_mm.append(np.abs((points_mm[on] - board[:3, 3]) @ board[:3, 2]))
    other = common.Figures(f"{sum(map(len, peer_mm))} points", "mm", np.concatenate(peer_mm))
    count = f"{sum(map(len, own_mm))} points"
    own = common.Figures(count, "mm", np.concatenate(own_mm), (), np.concatenate(inside))
    yield common.Line("UCL", "`surface`", "board", own, other)


def camera(root: Path, side: str) -> tuple[Array, Array]:
    """Camera matrix (3, 3) and distortion (1, 5) of a side."""
    return np.loadtxt(root / f"calib.{side}.intrinsics.txt"), np.loadtxt(root / f"calib.{side}.distortion.txt")[None]


def on_board(points: Array, hull_px: Array, K: Array) -> Array:
    """Which points (n, 3) the left view shows inside of a hull, (n,)."""
    found_px = common.pixel(points, K).astype(np.float32)
    hull = hull_px.astype(np.float32)
    near = [cv2.pointPolygonTest(hull, (float(x), float(y)), False) > 0 for x, y in found_px]
    return np.array(near, bool)
