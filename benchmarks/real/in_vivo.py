"""thesidjway/Assistive-surgery-project: in-vivo frames of 384x288, with the jaws' joint, length and direction by hand.

The labels are row, column, length and angle: the tip is a length from the joint, against the angle. No calibration
comes with it: f = 400 px is assumed, so that figures are pixels. Some frames have a label for one of two instruments
only: a row whose tool points elsewhere than each label is on the other one, and has no truth.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.real import common, peer
from svmdist.profile import load_profile
from svmdist.transforms import Array

SET = Path("Assistive-surgery-project", "laparoscopy_dataset")
K = common.K_of(400.0, 400.0, 191.5, 143.5)
RADIUS_M = 0.0025
TIP_PX = 15.0
SAME_WAY = 0.5  # cosine between a row's tool and a label: instruments come in from different sides


def labels(folder: Path) -> dict[int, Array]:
    """Joints and tips (n, 2, 2) in px by the number of the image."""
    frames = re.findall(
        r"<PositionIndex>(.*?)</PositionIndex>(.*?)</frame>", (folder / "train.xml").read_text("utf-8"), re.S
    )
    found = {}
    for number, tools in frames:
        row, column, length, angle = np.array(
            [tool.split() for tool in re.findall("<tool>(.*?)</tool>", tools)], float
        ).T
        joints = np.column_stack([column, row])
        tips = joints - length[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
        found[int(number)] = np.stack([joints, tips], 1)
    return found


def measure(folder: Path, out: Path) -> Iterator[common.Line]:
    """Rows of `shaft`: their tip against the nearest labelled one, and the tool's origin against the joint."""
    named, given = labels(folder / SET), common.FRAMES["in_vivo"]
    numbers = range(given["first"], given["last"] + 1, given["every"])
    paths = [folder / SET / "trainData" / f"{number:06d}.png" for number in numbers]
    views = (common.copied(paths, out / "images"), "--rate", 5, "--camera", "400,400,191.5,143.5")
    log, path = common.make_log(out / "in-vivo.mcap", *views, instrument="laparoscopic-5mm")
    profile = load_profile(path)
    assert profile.instrument is not None
    rows, _ = common.rows_of(log, profile, "shaft")
    pictures = [common.read(path) for path in paths]
    seen = [common.by_network(bgr) for bgr in pictures]
    tip_px, joint_px, on = [], [], []
    for row in rows:
        pose, (joints, tips) = common.pose_of(row), np.swapaxes(named[numbers[row.number]], 0, 1)
        on.append(common.on_instrument(pose, K, seen[row.number], profile.instrument.shaft_radius_m))
        length_m = pose.jaw_scale * profile.instrument.jaw_length_m
        tip_m = pose.T_camera_tool[:3, :3] @ [length_m, 0.0, 0.0] + pose.position_m
        joint, tip = common.pixel(pose.position_m, K), common.pixel(tip_m, K)
        along, lengths = (tips - joints) @ (tip - joint), np.linalg.norm(tips - joints, axis=1)
        same = along > SAME_WAY * lengths * np.linalg.norm(tip - joint)
        if same.any():
            tip_px.append(float(np.min(np.linalg.norm(tips[same] - tip, axis=1))))
            joint_px.append(float(np.min(np.linalg.norm(joints[same] - joint, axis=1))))
    found = peer.found(pictures, K, RADIUS_M, 2)
    near = [float(np.min(np.linalg.norm(named[numbers[n]][:, 1] - rod.end_px, axis=1))) for n, rod in found]
    other = peer.figures(found, seen, "px", near)
    count = f"{len(rows)}/{sum(len(named[number]) for number in numbers)}"
    unit = f"px; {common.share(np.array(tip_px) < TIP_PX)} of {len(tip_px)} in {TIP_PX:g} px"
    yield common.Line("in vivo", "`shaft`", "tip", common.Figures(count, unit, tip_px, on), other)
    yield common.Line("in vivo", "`shaft`", "joint", common.Figures(count, "px", joint_px))
