"""The set `thrust`: 50 rectified stereo pairs of a dVRK instrument over paper, with the recorded poses of its tool.

The reference is the red joint about the tool's origin, whose centroid is found in both views and triangulated. What is
red of it is its face; where the joint's middle is behind it is told by the recorded poses, as the tool turns.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
from scipy.io import loadmat

from benchmarks.real_sets.figures import (
    CHI_5_STD,
    CHI_95,
    SetFigures,
    after_rigid_fit,
    draw_overlays,
    measured,
    normalised,
    number,
    share,
)
from benchmarks.real_sets.making import make_hand_eye, make_log, make_profile, run
from svmdist.estimation.hand_eye import rigid_fit
from svmdist.importing.calibration import CalibrationOptions
from svmdist.kinematics.dh import DHChain, chain_of, forward_kinematics
from svmdist.profile import Limits, load_profile
from svmdist.recording.images import decode_file
from svmdist.recording.log import open_recording
from svmdist.transforms import (
    Array,
    quaternion_xyzw_from_rotation,
    rotation_angle,
    rotation_of,
    rotation_vector,
)
from svmdist.workflows.import_log import ImportOptions, ViewOptions

NAME, KEY, REPOSITORY = "thrust", "thrust", "fdheenmo/thrust"
IMAGES = Path("thrust", "annotated_50_images_15-Nov-17-59-04")
COUNT = 50
F_PX, CX_PX, CY_PX, FB_PX_M = 572.2249, 378.7735, 239.2915, 35.4475
"""Of the rectified pair, by the set's stereoParams.mat."""
ACROSS_STD_M, ALONG_STD_M = 5e-4, 1.1e-3
"""The reference's own noise, by its residuals after a rigid fit to the recorded poses."""
LOOK_UP_S = (-0.02, 0.0, 0.02)


def is_in(folder: Path) -> bool:
    """Whether the set has been fetched."""
    return (folder / IMAGES).is_dir()


def measure(folder: Path, out: Path, methods: Sequence[str]) -> SetFigures:
    """All methods against the red joint and the recorded poses."""
    images = folder / IMAGES
    out.mkdir(parents=True, exist_ok=True)
    poses = np.array([loadmat(images / f"{n}_P.mat")["P"] for n in range(1, COUNT + 1)])
    views = ViewOptions(images, pattern="*_L.jpg", right_pattern="*_R.jpg", rate_hz=1.0)
    calibration = CalibrationOptions(intrinsics=((F_PX, F_PX, CX_PX, CY_PX), None), baseline_m=FB_PX_M / F_PX)
    tables = {"PSM2": _poses_table(poses, out / "poses.csv")}
    log = make_log(ImportOptions(views, calibration, poses=tables), out / "thrust.mcap")
    joints = {"PSM2": _joints_table(poses, out / "joints.csv")}
    jointed = make_log(
        ImportOptions(views, calibration, poses=tables, joints=joints), out / "thrust-joints.mcap"
    )
    joint_px, joint_m = red_joints(images)
    middle_m, face_m, face_std_m = joint_middles(joint_m, poses)
    figures = SetFigures(
        "thrust: a dVRK instrument over paper, 50 stereo pairs of 640x480",
        (
            *("method", "rows", "px, median", "mm, median", "p95"),
            *("in 95 %", "over 5 deviations", "mm to the joint's middle, median", "p95", "in 95 %"),
            *("mm after a rigid fit to the poses, median", "mean"),
        ),
    )
    for method in methods:
        source, hand_eye = log, None
        profile = make_profile(log)
        if method in ("fused", "kinematic"):
            source, profile = jointed, make_profile(jointed)
            found = make_hand_eye(jointed, profile, "shaft", "PSM2")
            if isinstance(found, str):
                figures.rows.append((f"`{method}`", f"no hand-eye: {found}", *[""] * 10))
                continue
            hand_eye = found
        answer = run(source, profile, method, hand_eye)
        if isinstance(answer, str):
            figures.rows.append((f"`{method}`", answer, *[""] * 10))
            continue
        rows, loaded = answer
        good = measured(rows)
        at = np.array([round(row.stamp_ns / 1e9) for row in good], np.intp)
        places = np.reshape([row.tool.pose.position_m for row in good if row.tool], (-1, 3))
        pixels = np.reshape([row.image.tool_px for row in good], (-1, 2))
        errors = places - joint_m[at]
        square = normalised(good, errors, _noise(joint_m[at]))
        fitted = after_rigid_fit(places, poses[at, :3, 3]) if len(good) > 3 else np.zeros(0)
        off_m = np.linalg.norm(errors, axis=1)
        from_middle = places - middle_m[at]
        middle_square = normalised(good, from_middle, _noise(joint_m[at], face_std_m))
        from_middle_m = np.linalg.norm(from_middle, axis=1)
        figures.rows.append(
            (
                f"`{method}`",
                f"{len(good)} of {len(rows)}",
                number(np.linalg.norm(pixels - joint_px[at], axis=1), digits=1),
                number(1e3 * off_m),
                number(1e3 * off_m, 95.0),
                share(square < CHI_95),
                share(square > CHI_5_STD),
                number(1e3 * from_middle_m),
                number(1e3 * from_middle_m, 95.0),
                share(middle_square < CHI_95),
                number(1e3 * fitted),
                f"{1e3 * fitted.mean():.2f}" if len(fitted) else "–",
            )
        )
        references = {n * 10**9: [joint_px[n]] for n in range(COUNT)}
        draw_overlays(open_recording(source, loaded), rows, references, out / "overlays" / method, 5)
    own = after_rigid_fit(joint_m, poses[:, :3, 3])
    figures.notes.append(
        f"The red joint itself, triangulated, is {1e3 * float(np.median(own)):.2f} mm (median) from the poses after a"
        " rigid fit: the reference's own noise. By the poses its red face stands"
        f" {1e3 * face_m:.1f} ± {1e3 * face_std_m:.1f} mm before its middle, along the line of sight."
    )
    return figures


def red_joints(images: Path) -> tuple[Array, Array]:
    """Centroids of the red joint in the left images, (n, 2) in px, and its places, (n, 3) in m."""
    left, right = (
        np.array([_red_centroid(images / f"{n}_{side}.jpg") for n in range(1, COUNT + 1)]) for side in "LR"
    )
    z = FB_PX_M / (left[:, 0] - right[:, 0])
    rows = 0.5 * (left[:, 1] + right[:, 1])
    return left, np.column_stack([(left[:, 0] - CX_PX) * z / F_PX, (rows - CY_PX) * z / F_PX, z])


def joint_middles(face_m: Array, poses: Array) -> tuple[Array, float, float]:
    """The joint's middles, (n, 3) in m, how far the red face is before them along the line of sight, and its deviation.

    A point of the tool that is off the poses' own turns with the tool: seen = R (p + R_pose o) + t, with o unknown.
    """
    from scipy.optimize import least_squares

    T = rigid_fit(face_m, poses[:, :3, 3])
    start = np.concatenate([rotation_vector(T[:3, :3]), T[:3, 3], np.zeros(3)])

    def residual(x: Array) -> Array:
        places = (poses[:, :3, 3] + poses[:, :3, :3] @ x[6:]) @ rotation_of(x[:3]).T + x[3:6]
        return np.asarray((places - face_m) / ACROSS_STD_M).ravel()

    solved = least_squares(residual, start, loss="soft_l1")
    offset = rotation_of(solved.x[:3]) @ poses[:, :3, :3] @ solved.x[6:]
    rays = face_m / np.linalg.norm(face_m, axis=1, keepdims=True)
    scatter = float(np.mean(residual(solved.x) ** 2))
    C = scatter * np.linalg.inv(solved.jac.T @ solved.jac)[6:, 6:]
    towards = np.mean(np.swapaxes(rotation_of(solved.x[:3]) @ poses[:, :3, :3], 1, 2) @ rays[..., None], 0)[
        :, 0
    ]
    return face_m - offset, -float(np.mean(np.sum(offset * rays, 1))), float(np.sqrt(towards @ C @ towards))


def _red_centroid(path: Path) -> Array:
    """The middle of the largest red blob: redder than the paper by half of what the reddest pixels are."""
    smooth = cv2.GaussianBlur(decode_file(path.read_bytes(), path.name, Limits()), (3, 3), 0).astype(
        np.float64
    )
    red = (smooth[..., 2] - smooth[..., 1]) / (smooth.sum(axis=2) + 30.0)
    red -= np.median(red)
    mask = (red > 0.45 * np.percentile(red, 99.97)).astype(np.uint8)
    mask = np.asarray(cv2.morphologyEx(mask, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8)), np.uint8)
    _, labels, statistics, _ = cv2.connectedComponentsWithStats(mask)
    y, x = np.nonzero(labels == 1 + int(np.argmax(statistics[1:, cv2.CC_STAT_AREA])))
    weight = red[y, x]
    return np.array([float(weight @ x), float(weight @ y)]) / float(weight.sum())


def _noise(places_m: Array, face_std_m: float = 0.0) -> Array:
    """Covariance of the reference, (n, 3, 3): more along the line of sight than across it."""
    along_m2 = ALONG_STD_M**2 + face_std_m**2
    rays = places_m / np.linalg.norm(places_m, axis=1, keepdims=True)
    along = rays[:, :, None] * rays[:, None, :]
    return np.asarray(ACROSS_STD_M**2 * (np.eye(3) - along) + along_m2 * along)


def _poses_table(poses: Array, path: Path) -> Path:
    """A row for each image, as `svmdist import --poses` reads it."""
    q = quaternion_xyzw_from_rotation(poses[:, :3, :3])
    rows = np.column_stack([poses[:, :3, 3], q]).tolist()
    lines = (f"{n}_L.jpg," + ",".join(f"{value:.12g}" for value in row) for n, row in enumerate(rows, 1))
    path.write_text("\n".join(["image,x_m,y_m,z_m,qx,qy,qz,qw", *lines]) + "\n", "utf-8")
    return path


def _joints_table(poses: Array, path: Path) -> Path:
    """Joints of the poses by inverse kinematics, still about each image: the set has none of its own."""
    robot = load_profile("dvrk-psm").robot
    assert robot is not None
    chain = chain_of(robot)
    lines = ["timestamp," + ",".join(chain.joint_names)]
    q = np.array([0.0, 0.0, 0.17, 0.0, 0.0, 0.0])
    for number_, T in enumerate(poses):
        q = _inverse(chain, T, q)
        cells = ",".join(f"{value:.12g}" for value in q)
        lines += [f"{number_ + offset_s:.3f},{cells}" for offset_s in LOOK_UP_S if number_ + offset_s >= 0]
    path.write_text("\n".join(lines) + "\n", "utf-8")
    return path


def _inverse(chain: DHChain, T: Array, start: Array) -> Array:
    """Joints of a pose, from a start and where that fails from random ones."""
    from scipy.optimize import least_squares

    limits = np.array([[-1.6, -0.94, 0.0, -4.6, -1.6, -1.6], [1.6, 0.94, 0.26, 4.6, 1.6, 1.6]])
    rng = np.random.default_rng(0)

    def residual(q: Array) -> Array:
        found = forward_kinematics(chain, q)
        place, turn = (found[:3, 3] - T[:3, 3]) * 1e3, (found[:3, :3] - T[:3, :3]).ravel() * 100.0
        return np.concatenate([place, turn])

    best = start
    for trial in range(12):
        begin = start if trial == 0 else rng.uniform(limits[0], limits[1])
        solved = least_squares(residual, np.clip(begin, limits[0] + 1e-6, limits[1] - 1e-6), bounds=limits)
        if trial == 0 or solved.cost < 0.5 * float(residual(best) @ residual(best)):
            best = solved.x
        found = forward_kinematics(chain, best)
        if np.linalg.norm(found[:3, 3] - T[:3, 3]) < 1e-6 and rotation_angle(found[:3, :3], T[:3, :3]) < 1e-5:
            break
    return np.asarray(best)
