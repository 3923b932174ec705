"""docs/real-data.md: what each method measures on public images of real instruments, fetched beforehand to a folder.

`uv run python -m benchmarks.real_images FOLDER [--out DIR] [--write]` runs on whatever of the sets is in FOLDER: thrust
(fdheenmo/thrust) and SuPer Deep (ambareeshsrja16/Surgical_Tool_Tracking). Logs and profiles in DIR are made by the
program's own commands.
"""

from __future__ import annotations

import argparse
import csv
import subprocess
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from scipy.io import loadmat
from scipy.optimize import least_squares

import svmdist
from benchmarks import masks
from benchmarks.generated_pages import DOCS, table, write_table
from svmdist.estimation.hand_eye import rigid_fit
from svmdist.kinematics import chain_of, forward_kinematics
from svmdist.profile import Profile, load_profile
from svmdist.results import FrameResult
from svmdist.transforms import Array, quaternion_xyzw_from_rotation, rotation_of, rotation_vector

CHI_95, CHI_5_STD = 7.81, 31.8
"""Squares of normalised errors of 3 degrees of freedom: 95 %, and what five deviations of one are as unlikely as."""
THRUST = Path("thrust", "annotated_50_images_15-Nov-17-59-04")
COUNT = 50
F_PX, CX_PX, CY_PX, FB_PX_M = 572.2249, 378.7735, 239.2915, 35.4475
"""Of the rectified pair, by the set's stereoParams.mat."""
ACROSS_STD_M, ALONG_STD_M = 5e-4, 1.1e-3
"""The reference's own noise, by its residuals after a rigid fit to the recorded poses."""
LOOK_UP_S = (-0.02, 0.0, 0.02)
THRUST_COLUMNS = (
    *("method", "rows", "px, median", "mm, median", "p95", "in 95%", "over 5 deviations"),
    *("mm to the joint's middle, median", "p95", "in 95%"),
    *("mm after a rigid fit to the poses, median", "mean"),
)
SUPER_DEEP = Path("Surgical_Tool_Tracking", masks.SUPER_DEEP)
SUPER_DEEP_COLUMNS = (
    *("method", "rows, left", "rows, right", "both", "px to the wrist, median", "p95"),
    "rows under the other name",
)
LABELS = "CollectedData_Ambar.csv"
WRISTS = {"left": "left_logobody_head_tip", "right": "right_logobody_head_tip"}
"""The label at the distal end of the wrist's body, where the jaws' joint begins, of each instrument."""


def run(*arguments: object) -> None:
    """A command of svmdist, which must succeed."""
    subprocess.run([sys.executable, "-m", "svmdist", *map(str, arguments), "-q"], check=True)


def make_log(path: Path, *arguments: object) -> tuple[Path, Path]:
    """A log by `import`, and its profile by `profile new`."""
    profile = path.with_suffix(".toml")
    path.parent.mkdir(parents=True, exist_ok=True)
    run("import", *arguments, "--force", "-o", path)
    run("profile", "new", path, "--force", "-o", profile)
    return path, profile


def rows_of(log: Path, profile: Path | Profile, method: str) -> tuple[list[FrameResult], int]:
    """The measured rows of a method, and how many rows there are."""
    rows = list(svmdist.estimate(svmdist.open_recording(log, profile), method))
    return [row for row in rows if row.measured and row.tool is not None], len(rows)


def number(values: Any, percentile: float = 50.0, digits: int = 2) -> str:
    """A percentile of values, a dash where there is none."""
    return f"{np.percentile(values, percentile):.{digits}f}" if len(values) else "–"


def share(values: Any) -> str:
    """How many of truth values hold."""
    return f"{100.0 * float(np.mean(values)):.0f}%" if len(values) else "–"


def normalised(rows: Sequence[FrameResult], errors_m: Array, places_m: Array, face_std_m: float) -> Array:
    """Squared errors (n, 3) over the covariance of rows and of the reference, which is less known along its rays."""
    rays = places_m / np.linalg.norm(places_m, axis=1, keepdims=True)
    along = rays[:, :, None] * rays[:, None, :]
    S = ACROSS_STD_M**2 * (np.eye(3) - along) + (ALONG_STD_M**2 + face_std_m**2) * along
    S += np.array([row.tool.pose.position_covariance for row in rows if row.tool])
    return np.asarray(np.einsum("ni,ni->n", errors_m, np.linalg.solve(S, errors_m[..., None])[..., 0]))


def after_rigid_fit(places_m: Array, reference_m: Array) -> Array:
    """Distances in m of places (n, 3) from a reference in another frame, after a rigid fit of least distances."""
    weights, off_m = np.ones(len(places_m)), np.zeros(len(places_m))
    for _ in range(10):
        T = rigid_fit(places_m, reference_m, weights)
        off_m = np.linalg.norm((reference_m @ T[:3, :3].T + T[:3, 3]) - places_m, axis=1)
        weights = 1.0 / np.maximum(off_m, max(float(np.median(off_m)), 1e-6))
    return off_m


def thrust(folder: Path, out: Path) -> Iterator[str]:
    """50 rectified stereo pairs of a dVRK instrument over paper, with the recorded poses of its tool.

    The reference is the red joint about the tool's origin, found in both views and triangulated. Only its face is
    visible; how far its middle is behind it follows from the recorded poses, as the tool turns.
    """
    images = folder / THRUST
    poses = np.array([loadmat(images / f"{n}_P.mat")["P"] for n in range(1, COUNT + 1)])
    out.mkdir(parents=True, exist_ok=True)
    views = (images, "--pattern", "*_L.jpg", "--right-pattern", "*_R.jpg", "--rate", 1)
    camera = ("--camera", f"{F_PX},{F_PX},{CX_PX},{CY_PX}", "--baseline", f"{FB_PX_M / F_PX}m")
    named = ("--poses", f"PSM2={poses_table(poses, out / 'poses.csv')}")
    log, profile = make_log(out / "thrust.mcap", *views, *camera, *named)
    joints = ("--joints", f"PSM2={joints_table(poses, out / 'joints.csv')}")
    jointed, robot = make_log(out / "thrust-joints.mcap", *views, *camera, *named, *joints)
    options = ("--profile", robot, "--method", "shaft", "--instrument", "PSM2", "--force")
    run("hand-eye", jointed, *options, "-o", out / "hand-eye.toml")
    robot.write_text('hand_eye = "hand-eye.toml"\n' + robot.read_text("utf-8"), "utf-8")
    joint_px, joint_m = red_joints(images)
    middle_m, face_m, face_std_m = joint_middles(joint_m, poses)
    table_rows = []
    for method in ("shaft", "stereo", "fused"):
        rows, total = rows_of(jointed, robot, method) if method == "fused" else rows_of(log, profile, method)
        at = np.array([round(row.stamp_ns / 1e9) for row in rows], np.intp)
        places_m = np.array([row.tool.pose.position_m for row in rows if row.tool])
        off_px = np.linalg.norm(np.array([row.image.tool_px for row in rows]) - joint_px[at], axis=1)
        cells = [f"`{method}`", f"{len(rows)} of {total}", number(off_px, digits=1)]
        for reference_m, std_m in ((joint_m, 0.0), (middle_m, face_std_m)):
            errors_m = places_m - reference_m[at]
            off_mm = 1e3 * np.linalg.norm(errors_m, axis=1)
            square = normalised(rows, errors_m, joint_m[at], std_m)
            cells += [number(off_mm), number(off_mm, 95.0), share(square < CHI_95)]
            cells += [share(square > CHI_5_STD)] if reference_m is joint_m else []
        fitted_mm = 1e3 * after_rigid_fit(places_m, poses[at, :3, 3])
        table_rows.append((*cells, number(fitted_mm), f"{fitted_mm.mean():.2f}"))
    yield "### thrust: a dVRK instrument over paper, 50 stereo pairs of 640x480\n\n"
    yield table(THRUST_COLUMNS, table_rows)
    own_mm = 1e3 * after_rigid_fit(joint_m, poses[:, :3, 3])
    yield (
        f"\nThe red joint itself, triangulated, is {number(own_mm)} mm (median) from the poses after a rigid fit:"
        " the reference's own noise. By the poses its red face stands"
        f" {1e3 * face_m:.1f} ± {1e3 * face_std_m:.1f} mm before its middle, along the line of sight.\n\n"
    )


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


def joint_middles(face_m: Array, poses: Array) -> tuple[Array, float, float]:
    """The joint's middles, (n, 3) in m, how far the red face is before them along the line of sight, and its deviation.

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
    return face_m - offset, -float(np.mean(np.sum(offset * rays, 1))), float(np.sqrt(towards @ C @ towards))


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


def super_deep(folder: Path, out: Path) -> Iterator[str]:
    """20 stereo frames of two da Vinci instruments over tissue, keypoints labelled in the left view.

    No calibration comes with it: f = 800 px is assumed, so that figures are pixels.
    """
    views = (folder / SUPER_DEEP, "--side-by-side", "--rate", 1, "--camera", "800,800,359.5,287.5")
    log, path = make_log(out / "superdeep.mcap", *views)
    profile = load_profile(path)
    sides = {profile.instrument_name: profile.entry or "left"}
    sides |= {other.name: other.entry or "right" for other in profile.other_instruments}
    rows, total = rows_of(log, profile, "shaft")
    frames = {side: {row.stamp_ns for row in rows if sides[row.instrument] == side} for side in WRISTS}
    wrists = labelled_wrists(folder / SUPER_DEEP)
    off_px, swapped = [], 0
    for row in rows:
        found = wrists.get(round(row.stamp_ns / 1e9), {})
        at, own = np.array(row.image.tool_px), sides[row.instrument]
        away_px = {side: float(np.linalg.norm(at - px)) for side, px in found.items()}
        if own in away_px:
            off_px.append(away_px[own])
            swapped += min(away_px, key=lambda side: away_px[side]) != own
    counts = (frames["left"], frames["right"], frames["left"] & frames["right"])
    cells = (f"{len(stamps)} of {total // len(sides)}" for stamps in counts)
    both = (number(off_px, digits=1), number(off_px, 95.0, digits=1))
    yield "### SuPer Deep: two da Vinci instruments over tissue, 20 frames of 720x576\n\n"
    yield table(SUPER_DEEP_COLUMNS, [("`shaft`", *cells, *both, f"{swapped} of {len(off_px)}")]) + "\n"


def labelled_wrists(folder: Path) -> dict[int, dict[str, Array]]:
    """Wrists by the image's place in the log, in px of the left view; frames without labels are left out."""
    images = sorted(folder.glob("img*.png"), key=lambda path: int("".join(filter(str.isdigit, path.stem))))
    places = {path.name: place for place, path in enumerate(images)}
    with (folder / LABELS).open(newline="", encoding="utf-8") as file:
        _, parts, axes, *rows = list(csv.reader(file))
    found: dict[int, dict[str, Array]] = {}
    for row in rows:
        name = row[0].replace("\\", "/").rpartition("/")[2]
        cells = {(part, axis): value for part, axis, value in zip(parts, axes, row, strict=True)}
        for side, part in WRISTS.items():
            px = [float(cells[part, axis] or np.nan) for axis in "xy"]
            if name in places and np.isfinite(px).all():
                found.setdefault(places[name], {})[side] = np.array(px)
    return found


SETS = {THRUST: thrust, SUPER_DEEP: super_deep}


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("real-images"))
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()
    text = ""
    for place, measure in SETS.items():
        if (given.folder / place).is_dir():
            text += "".join(measure(given.folder, given.out / measure.__name__))
        else:
            print(f"{given.folder / place}: not there", file=sys.stderr)
    print(text)
    if given.write and text:
        write_table(DOCS / "real-data.md", "real-images", text)
