"""fdheenmo/thrust: 50 rectified stereo pairs of a dVRK instrument over paper, with the recorded poses of its tool.

The reference is the red joint about the tool's origin, found in both views and triangulated. Only its face is visible;
how far its middle is behind it follows from the recorded poses, as the tool turns.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
from scipy.io import loadmat
from scipy.optimize import least_squares

from benchmarks.real import common, peer
from svmdist.estimation.alignment import rigid_fit
from svmdist.kinematics import chain_of, forward_kinematics
from svmdist.profile import load_profile
from svmdist.transforms import Array, quaternion_xyzw_from_rotation, rotation_of, rotation_vector

SET = Path("thrust", "annotated_50_images_15-Nov-17-59-04")
COUNT = 50
F_PX, CX_PX, CY_PX, FB_PX_M = 572.2249, 378.7735, 239.2915, 35.4475
"""Of the rectified pair, by the set's stereoParams.mat."""
K = common.K_of(F_PX, F_PX, CX_PX, CY_PX)
RADIUS_M = 0.00415
"""Of the shaft, for what OpenCV and the projection need; svmdist has its own of the profile."""
ACROSS_STD_M, ALONG_STD_M = 5e-4, 1.1e-3
"""The reference's own noise, by its residuals after a rigid fit to the recorded poses."""
LOOK_UP_S = (-0.02, 0.0, 0.02)


def measure(folder: Path, out: Path) -> Iterator[common.Line]:
    """Rows of `shaft`, `stereo` and `fused` against the joint's middle, and against the poses."""
    images = folder / SET
    poses = np.array([loadmat(images / f"{n}_P.mat")["P"] for n in range(1, COUNT + 1)])
    out.mkdir(parents=True, exist_ok=True)
    views = (images, "--pattern", "*_L.jpg", "--right-pattern", "*_R.jpg", "--rate", 1)
    camera = ("--camera", f"{F_PX},{F_PX},{CX_PX},{CY_PX}", "--baseline", f"{FB_PX_M / F_PX}m")
    named = ("--poses", f"PSM2={poses_table(poses, out / 'poses.csv')}")
    log, profile = common.make_log(out / "thrust.mcap", *views, *camera, *named)
    joints = ("--joints", f"PSM2={joints_table(poses, out / 'joints.csv')}")
    jointed, robot = common.make_log(out / "thrust-joints.mcap", *views, *camera, *named, *joints)
    options = ("--profile", robot, "--method", "shaft", "--instrument", "PSM2", "--force")
    common.run("hand-eye", jointed, *options, "-o", out / "hand-eye.toml")
    robot.write_text('hand_eye = "hand-eye.toml"\n' + robot.read_text("utf-8"), "utf-8")
    _, joint_m = red_joints(images)
    middle_m, face_std_m = joint_middles(joint_m, poses)
    pictures = [common.read(images / f"{n}_L.jpg") for n in range(1, COUNT + 1)]
    seen = [common.by_network(bgr) for bgr in pictures]
    rods = peer.found(pictures, K, RADIUS_M)
    off_mm = [1e3 * float(np.linalg.norm(rod.place_m - middle_m[n])) for n, rod in rods]
    other = peer.figures(rods, seen, "mm", off_mm)
    for method in ("shaft", "stereo", "fused"):
        rows, total = (
            common.rows_of(jointed, robot, method) if method == "fused" else common.rows_of(log, profile, method)
        )
        at = np.array([round(row.stamp_ns / 1e9) for row in rows], np.intp)
        places_m = np.array([common.pose_of(row).position_m for row in rows])
        errors_m, rays = (
            places_m - middle_m[at],
            joint_m[at] / np.linalg.norm(joint_m[at], axis=1, keepdims=True),
        )
        along = rays[:, :, None] * rays[:, None, :]
        S = ACROSS_STD_M**2 * (np.eye(3) - along) + (ALONG_STD_M**2 + face_std_m**2) * along
        S += np.array([common.pose_of(row).position_covariance for row in rows])
        square = np.einsum("ni,ni->n", errors_m, np.linalg.solve(S, errors_m[..., None])[..., 0])
        on = [common.on_instrument(common.pose_of(row), K, seen[n], RADIUS_M) for row, n in zip(rows, at, strict=True)]
        off_mm = 1e3 * np.linalg.norm(errors_m, axis=1)
        count = f"{len(rows)}/{total}"
        shared = ("thrust", f"`{method}`")
        yield common.Line(
            *shared, "red joint", common.Figures(count, "mm", off_mm, on, square < common.CHI_95[3]), other
        )
        T = common.robust_fit(places_m, poses[at, :3, 3])
        off_mm = 1e3 * np.linalg.norm(poses[at, :3, 3] @ T[:3, :3].T + T[:3, 3] - places_m, axis=1)
        yield common.Line(*shared, "robot, fitted", common.Figures(count, "mm", off_mm))


def red_joints(images: Path) -> tuple[Array, Array]:
    """Centroids of the red joint in the left images, (n, 2) in px, and its places, (n, 3) in m."""
    numbers = range(1, COUNT + 1)
    left, right = (np.array([red_centroid(images / f"{n}_{side}.jpg") for n in numbers]) for side in "LR")
    z = FB_PX_M / (left[:, 0] - right[:, 0])
    rows = 0.5 * (left[:, 1] + right[:, 1])
    return left, np.column_stack([(left[:, 0] - CX_PX) * z / F_PX, (rows - CY_PX) * z / F_PX, z])


def red_centroid(path: Path) -> Array:
    """The middle of the largest red blob: redder than the paper by half of what the reddest pixels are."""
    smooth = cv2.GaussianBlur(np.asarray(cv2.imread(str(path))), (3, 3), 0).astype(np.float64)
    red = (smooth[..., 2] - smooth[..., 1]) / (smooth.sum(axis=2) + 30.0)
    red -= np.median(red)
    mask = (red > 0.45 * np.percentile(red, 99.97)).astype(np.uint8)
    mask = np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)), np.uint8)
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(mask)
    y, x = np.nonzero(labels == 1 + int(np.argmax(statistics[1:, cv2.CC_STAT_AREA])))
    weight = red[y, x]
    return np.array([float(weight @ x), float(weight @ y)]) / float(weight.sum())


def joint_middles(face_m: Array, poses: Array) -> tuple[Array, float]:
    """The joint's middles, (n, 3) in m, and the deviation of how far its red face is before them.

    A point of the tool that is off the poses' own turns with the tool: seen = R (p + R_pose o) + t, with o unknown.
    """
    T = rigid_fit(face_m, poses[:, :3, 3])

    def residual(x: Array) -> Array:
        places = (poses[:, :3, 3] + poses[:, :3, :3] @ x[6:]) @ rotation_of(x[:3]).T + x[3:6]
        return np.asarray((places - face_m) / ACROSS_STD_M).ravel()

    start = [*rotation_vector(T[:3, :3]), *T[:3, 3], 0.0, 0.0, 0.0]
    solved = least_squares(residual, start, loss="soft_l1")
    turned = rotation_of(solved.x[:3]) @ poses[:, :3, :3]
    offset = turned @ solved.x[6:]
    rays = face_m / np.linalg.norm(face_m, axis=1, keepdims=True)
    C = float(np.mean(residual(solved.x) ** 2)) * np.linalg.inv(solved.jac.T @ solved.jac)[6:, 6:]
    towards = np.mean(np.swapaxes(turned, 1, 2) @ rays[..., None], 0)[:, 0]
    return face_m - offset, float(np.sqrt(towards @ C @ towards))


def poses_table(poses: Array, path: Path) -> Path:
    """A row for each image, as `svmdist import --poses` reads it."""
    q_xyzw = quaternion_xyzw_from_rotation(poses[:, :3, :3])
    rows = np.column_stack([np.arange(COUNT) + 1, poses[:, :3, 3], q_xyzw])
    head = "image,x_m,y_m,z_m,qx,qy,qz,qw"
    np.savetxt(path, rows, ["%d_L.jpg"] + ["%.12g"] * 7, ",", header=head, comments="")
    return path


def joints_table(poses: Array, path: Path) -> Path:
    """Joints of the poses by inverse kinematics, still about each image: the set has none of its own."""
    robot = load_profile("dvrk-psm").robot
    assert robot is not None
    chain = chain_of(robot)
    limits = np.array([[-1.6, -0.94, 0.0, -4.6, -1.6, -1.6], [1.6, 0.94, 0.26, 4.6, 1.6, 1.6]])
    rng = np.random.default_rng(0)
    q = np.array([0.0, 0.0, 0.17, 0.0, 0.0, 0.0])
    rows: list[list[float]] = []
    for at, T in enumerate(poses):

        def residual(x: Array, T: Array = T) -> Array:
            found = forward_kinematics(chain, x)
            return np.concatenate([(found - T)[:3, 3] * 1e3, (found - T)[:3, :3].ravel() * 100.0])

        starts = [np.clip(q, limits[0] + 1e-6, limits[1] - 1e-6), *rng.uniform(limits[0], limits[1], (12, 6))]
        for start in starts:  # from the pose before, and where that fails from random ones
            q = np.asarray(least_squares(residual, start, bounds=limits).x)
            if np.abs(residual(q)).max() < 1e-3:
                break
        rows += [[at + offset_s, *q] for offset_s in LOOK_UP_S if at + offset_s >= 0]
    head = ",".join(("timestamp", *chain.joint_names))
    np.savetxt(path, rows, ["%.3f"] + ["%.12g"] * len(q), ",", header=head, comments="")
    return path
