"""utsavrai/Vision-Based-Pose-Estimation: a da Vinci instrument over a phantom of an organ, with its 6D pose.

The object is the wrist's body: its origin is at the hinge, its x axis points back along it, and the jaws' joint is
9.1 mm before the hinge. Only one view of the frame is public. The tissue's place is unknown to the profile.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.real import common, peer

SET = Path(
    "Vision-Based-Pose-Estimation-of-Surgical-Instruments-in-Robotic-Surgery",
    *("Data_Generation_Preparation", "example_bop_dataset", "test", "000001"),
)
NUMBER = 153
WRIST_M, RADIUS_M = 0.0091, 0.0042


def measure(folder: Path, out: Path) -> Iterator[common.Line]:
    """The row of `shaft` against the pose."""
    root = folder / SET
    camera = json.loads((root / "scene_camera.json").read_text("utf-8"))[str(NUMBER)]["cam_K"]
    truth = json.loads((root / "scene_gt.json").read_text("utf-8"))[str(NUMBER)][0]
    R, t = np.reshape(truth["cam_R_m2c"], (3, 3)), 1e-3 * np.array(truth["cam_t_m2c"])
    joint_m, K = t - WRIST_M * R[:, 0], common.K_of(camera[0], camera[4], camera[2], camera[5])
    image = root / "rgb" / f"{NUMBER:06d}.png"
    numbers = ",".join(str(camera[at]) for at in (0, 4, 2, 5))
    views = (common.copied([image], out / "images"), "--rate", 1, "--camera", numbers)
    log, profile = common.make_log(out / "bop.mcap", *views, instrument="large-needle-driver")
    bgr = common.read(image)
    seen = common.by_network(bgr) | (common.read(root / "mask" / f"{NUMBER:06d}_000000.png")[..., 0] > 0)
    rods = peer.found([bgr], K, RADIUS_M)
    off = [1e3 * float(np.linalg.norm(rod.place_m - joint_m)) for _, rod in rods]
    other = peer.figures(rods, [seen], "mm", off)
    rows, total = common.rows_of(log, profile, "shaft")
    count, errors = f"{len(rows)}/{total}", [common.pose_of(row).position_m - joint_m for row in rows]
    inside = [
        float(e @ np.linalg.solve(common.pose_of(r).position_covariance, e)) < common.CHI_95[3]
        for e, r in zip(errors, rows, strict=True)
    ]
    on = [common.on_instrument(common.pose_of(row), K, seen, RADIUS_M) for row in rows]
    off = [1e3 * float(np.linalg.norm(e)) for e in errors]
    yield common.Line("BOP", "`shaft`", "joint", common.Figures(count, "mm", off, on, inside), other)
    px = [
        float(np.linalg.norm(common.pixel(common.pose_of(row).position_m, K) - common.pixel(joint_m, K)))
        for row in rows
    ]
    other = peer.figures(
        rods, [seen], "px", [float(np.linalg.norm(rod.end_px - common.pixel(joint_m, K))) for _, rod in rods]
    )
    yield common.Line("BOP", "`shaft`", "joint", common.Figures(count, "px", px), other)
