"""ImperialCollegeLondon/ReCoDE-HandEyeCalibration: a dVRK instrument with two red balls on its shaft, 50 places.

The reference is the wrist's hinge, which the authors find by the balls in a depth camera's point cloud (0.6 mm from
the robot's after a rigid fit). The cloud covers the balls only: there is no tissue to be far from.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from benchmarks.real import common, peer
from svmdist.profile.hand_eye import FORMAT, HandEye, HandEyeFile, save_hand_eye
from svmdist.transforms import Array, skew

SET = Path("ReCoDE-HandEyeCalibration", "input")
COUNT, REFERENCE_STD_M, RADIUS_M, WRIST_M = 50, 6e-4, 0.0042, 0.0091
KINEMATIC_STDS = {"joint_std_rad": 3e-3, "joint_std_m": 5e-4, "length_std_m": 5e-4}
"""By the residuals of the fit: 0.6 mm at 0.2 m from the base."""
NAMES = "timestamp,yaw,pitch,insertion,roll,wrist_pitch,wrist_yaw"


def measure(folder: Path, out: Path) -> Iterator[common.Line]:
    """Rows of `shaft` against the hinge."""
    root = folder / SET
    K, hinges_m, numbers = _camera_and_hinges(root)
    log, profile = common.make_log(out / "recode.mcap", root / "RGB", "--rate", 1, "--camera", numbers)
    pictures = [common.read(root / "RGB" / f"frame{n}.jpg") for n in range(COUNT)]
    seen = [common.by_network(bgr) for bgr in pictures]
    rods = peer.found(pictures, K, RADIUS_M)
    off_mm = [1e3 * float(np.linalg.norm(rod.place_m - hinges_m[n])) for n, rod in rods]
    other = peer.figures(rods, seen, "mm", off_mm)
    rows, total = common.rows_of(log, profile, "shaft")
    errors, inside = [], []
    for row in rows:
        hinge = common.pose_of(row).hinge
        if hinge is not None:
            off_m = hinge.position_m - hinges_m[row.number]
            errors.append(1e3 * float(np.linalg.norm(off_m)))
            S = hinge.covariance + REFERENCE_STD_M**2 * np.eye(3)
            inside.append(float(off_m @ np.linalg.solve(S, off_m)) < common.CHI_95[3])
    on = [common.on_instrument(common.pose_of(row), K, seen[row.number], RADIUS_M) for row in rows]
    yield common.Line(
        "ReCoDE", "`shaft`", "hinge", common.Figures(f"{len(rows)}/{total}", "mm", errors, on, inside), other
    )
    log, profile = log_with_joints(folder, out)
    rows, total = common.rows_of(log, profile, "kinematic")
    errors, inside, on = [], [], []
    for row in rows:
        pose = common.pose_of(row)
        on.append(common.on_instrument(pose, K, seen[row.number], RADIUS_M))
        if row.number % 2:
            off_m = pose.position_m - WRIST_M * pose.axis - hinges_m[row.number]
            errors.append(1e3 * float(np.linalg.norm(off_m)))
            S = pose.position_covariance + REFERENCE_STD_M**2 * np.eye(3)
            inside.append(float(off_m @ np.linalg.solve(S, off_m)) < common.CHI_95[3])
    yield common.Line(
        "ReCoDE",
        "`kinematic`",
        "hinge, fitted",
        common.Figures(f"{len(rows)}/{total}", "mm", errors, on, inside),
    )


def _camera_and_hinges(root: Path) -> tuple[Array, Array, str]:
    """The camera's K, the hinges (50, 3) in its frame, and K as `import` takes it."""
    K = np.loadtxt(root / "Acusense_RGB_K.txt")
    T = np.loadtxt(root / "ExtrinsicMat.txt")  # from the depth camera, mm
    hinges_m = np.loadtxt(root / "pos_act.txt") @ T[:3, :3].T + 1e-3 * T[:3, 3]
    return K, hinges_m, ",".join(str(K[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))


def log_with_joints(folder: Path, out: Path) -> tuple[Path, Path]:
    """The log of images and joints, and its profile with the fitted hand-eye and the profile's plane."""
    root = folder / SET
    _, hinges_m, numbers = _camera_and_hinges(root)
    out.mkdir(parents=True, exist_ok=True)
    given = ("--rate", 1, "--start", 1, "--camera", numbers)
    joints = np.pad(np.repeat(np.loadtxt(root / "q_history.txt"), 2, axis=0), ((0, 0), (0, 3)))
    times = np.repeat(np.arange(COUNT) + 1.0, 2) + np.tile([-0.02, 0.02], COUNT)
    np.savetxt(out / "joints.csv", np.column_stack([times, joints]), "%.12g", ",", header=NAMES, comments="")
    log = out / "recode-joints.mcap"
    log, profile = common.make_log(log, root / "RGB", *given, "--joints", f"PSM1={out / 'joints.csv'}")
    fit_hand_eye(np.loadtxt(root / "pos_des.txt"), hinges_m, profile)
    return log, profile


def fit_hand_eye(base_m: Array, camera_m: Array, profile: Path) -> None:
    """Puts the transform of even places, with its covariance, and the profile's plane, into a profile."""
    T = common.robust_fit(camera_m[::2], base_m[::2])
    J = np.concatenate([np.hstack([np.eye(3), -skew(T[:3, :3] @ b)]) for b in base_m[::2]])
    covariance = REFERENCE_STD_M**2 * np.linalg.inv(J.T @ J)
    found = {
        "rotation": T[:3, :3].tolist(),
        "translation_m": T[:3, 3].tolist(),
        "covariance": covariance.tolist(),
    }
    fitted = HandEye.model_validate({"instrument": "PSM1", "camera": "camera", "base": "PSM1_base"} | found)
    save_hand_eye(profile.with_name("hand-eye.toml"), HandEyeFile(format=FORMAT, transforms=(fitted,)))
    up = T[:3, 2]
    plane = f"plane_normal = {up.tolist()}\nplane_distance_m = {0.06 - float(np.min(camera_m @ up))}\n"
    plane += "plane_distance_std_m = 0.02\nplane_tilt_std_rad = 0.05\nsurface_std_m = 2e-3\n"
    text = profile.read_text("utf-8")
    for key, value in KINEMATIC_STDS.items():
        text = re.sub(rf"^{key} = [^ ]*", f"{key} = {value}", text, flags=re.M)
    profile.write_text('hand_eye = "hand-eye.toml"\n' + text.partition("[tissue]")[0] + "[tissue]\n" + plane, "utf-8")
