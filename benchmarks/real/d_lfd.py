"""imanlab/d-lfd: two arms of a da Vinci Research Kit pierce foam, three stereo pairs, joints and poses of both arms.

The published 3D targets and hand-eye are unusable (17 mm off), so the references are the other pairs, whose extrinsics
are fitted to even trials and tried on odd ones, and the robot's own poses, fitted in the same way.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from scipy.io import loadmat
from scipy.optimize import least_squares

from benchmarks.real import common, peer
from svmdist.transforms import Array, rotation_of, rotation_vector

SET = Path("d-lfd")
SIZE_PX, SHOWN_PX = (640, 480), (310, 243)
"""Videos are screenshots of a plot, of 310x244 px, whose last row is beside the image: its ticks show the scale."""
ARMS = {"PSM1": 0, "PSM2": 1}
"""Arm 1 drives the needle, from the right; arm 2 holds the foam, from above."""
SIDES = {"PSM1": "right", "PSM2": "above"}
SPACING_S = 10.0
PAIRS = (1, 2, 3)
RADIUS_M, LEAST_FITTED = 0.0042, 6
AT = common.FRAMES["d_lfd"]["at"]
JOINTS = "timestamp,yaw,pitch,insertion,roll,wrist_pitch,wrist_yaw"


def matrices(path: Path) -> list[Array]:
    """The real arrays of a MATLAB object, which SciPy leaves as bytes, in the order of its properties."""
    data = loadmat(path)["__function_workspace__"].tobytes()
    found = []
    for at in range(0, len(data) - 64, 8):
        element, flags, dimensions, size = (struct.unpack_from("<2I", data, at + of) for of in (0, 8, 24, 24))
        if element[0] != 14 or flags != (6, 8) or dimensions[0] != 5 or size[1] not in (8, 12):
            continue
        shape = struct.unpack_from(f"<{size[1] // 4}i", data, at + 32)
        values = at + 32 + (size[1] + 7) // 8 * 8 + 8  # behind the dimensions and the empty name
        if struct.unpack_from("<2I", data, values) == (9, 8 * int(np.prod(shape))):
            found.append(np.frombuffer(data, "<f8", int(np.prod(shape)), values + 8).reshape(shape, order="F"))
    return found


def calibration(root: Path, pair: int, path: Path) -> str:
    """Writes a pair's calibration in OpenCV's form, of the images as shown; returns `[camera_error]` of the profile.

    It is the authors', refitted to their own boards, whose residuals give the deviations. The boards cover the middle
    of the images only: a second radial term, fitted to them, has no effect there and 20 px in the corners of pair 3.
    """
    values = matrices(root / "Data" / f"stereoParamsP{pair}.mat")
    board, (R, T) = np.pad(values[3], ((0, 0), (0, 1))), values[-6:-4]
    one = np.array([[0.0, 0.0, 1.0], [0.0, 0.0, 1.0], [0.0, 0.0, 0.0]])  # MATLAB counts pixels from 1
    K = [values[at].T - one for at in (8, 17)]
    radial, turns, places, residuals = ([values[at + n] for at in (0, 9)] for n in (0, 5, 6, 7))
    corners_px = []  # of both cameras, (boards, corners, 2)
    for n in (0, 1):
        D = np.append(radial[n], [0.0, 0.0])
        poses = zip(turns[n], places[n], strict=True)
        seen = [cv2.projectPoints(board, r, t, K[n], D)[0][:, 0] for r, t in poses]
        corners_px.append(np.array(seen, np.float64) - np.moveaxis(residuals[n], 2, 0))
    start = [np.array([*K[n][[0, 1, 0, 1], [0, 1, 2, 2]], radial[n][0, 0]]) for n in (0, 1)]
    start += [rotation_vector(R.T), T[0], turns[0].ravel(), places[0].ravel()]
    ends = np.cumsum([part.size for part in start])[:-1]

    def residual(x: Array) -> Array:
        left, right, turn, place, *boards = np.split(x, ends)
        off = []
        for r, t, *seen in zip(*(part.reshape(-1, 3) for part in boards), *corners_px, strict=True):
            moved = board @ rotation_of(r).T + t
            for points, camera, px in (
                (moved, left, seen[0]),
                (moved @ rotation_of(turn).T + place, right, seen[1]),
            ):
                xy = points[:, :2] / points[:, 2:]
                xy = xy * (1.0 + camera[4] * np.sum(xy**2, 1, keepdims=True))
                off.append(camera[:2] * xy + camera[2:4] - px)
        return np.concatenate(off).ravel()

    solved = least_squares(residual, np.concatenate(start), x_scale="jac")
    spare = solved.fun.size - solved.x.size
    std = np.sqrt(np.diag(np.linalg.inv(solved.jac.T @ solved.jac)) * (solved.fun @ solved.fun) / spare)
    left, right, turn, place, *_ = np.split(solved.x, ends)
    x, y = (shown / size for shown, size in zip(SHOWN_PX, SIZE_PX, strict=True))
    to_shown = np.array([[x, 0.0, 0.5 * x - 0.5], [0.0, y, 0.5 * y - 0.5], [0.0, 0.0, 1.0]])
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    for n, (fx, fy, cx, cy, k1) in enumerate((left, right), 1):
        file.write(f"M{n}", to_shown @ np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]))
        file.write(f"D{n}", np.array([[k1, 0.0, 0.0, 0.0]]))
    file.write("R", rotation_of(turn))
    file.write("T", place[:, None])
    file.release()
    return (
        f"focal_std_fraction = {np.max(std[[0, 5]] / solved.x[[0, 5]]):.2g}\n"
        f"centre_std_px = {x * np.max(std[[2, 3, 7, 8]]):.2g}\n"
        f"baseline_std_fraction = {std[13] / abs(place[0]):.2g}\n"
        f"right_rotation_std_rad = {np.max(std[10:13]):.2g}\n"
    )


def robot(root: Path, trial: int) -> tuple[Array, Array, Array]:
    """Times in s of a trial's video, (n,), joints (n, 2, 6) and poses (n, 2, 4, 4) of both arms.

    The robot's samples are evenly spread from the time at which the authors' script begins to the video's end.
    """
    script = (root / "preprocessing" / "imgdataset.py").read_text("utf-8")
    starts = re.findall(r"[\d.]+", script.partition("start_imaging = np.array([")[2].partition("]")[0])
    video = cv2.VideoCapture(str(root / "Data" / str(trial) / "p1_left.mp4"))
    end_s = video.get(cv2.CAP_PROP_FRAME_COUNT) / video.get(cv2.CAP_PROP_FPS)
    samples = [cell[0] for cell in loadmat(root / "Data" / str(trial) / "Data.mat")["Data"][0]]
    times = np.linspace(float(starts[trial - 1]), end_s, len(samples), endpoint=False)
    joints = np.array([[sample[arm][:, 0] for arm in ARMS.values()] for sample in samples])
    return times, joints, np.array([[sample[2 + arm] for arm in ARMS.values()] for sample in samples])


def log_of(root: Path, pair: int, trials: Sequence[int], out: Path) -> tuple[Path, Path]:
    """A log of one image pair of each trial, at a share AT of the robot's samples, SPACING_S apart, and its profile."""
    folder = out / f"p{pair}"
    left, right = (common.copied([], folder / side) for side in ("left", "right"))
    rows: dict[str, list[list[float]]] = {name: [] for name in ARMS}
    for number, trial in enumerate(trials):
        times, joints, _ = robot(root, trial)
        at = round(25 * float(times[int(AT * len(times))]))
        for side in ("left", "right"):
            video = cv2.VideoCapture(str(root / "Data" / str(trial) / f"p{pair}_{side}.mp4"))
            for _ in range(at + 1):
                video.grab()
            cv2.imwrite(str(folder / side / f"{trial:02d}.png"), video.retrieve()[1][: SHOWN_PX[1]])
        near = np.abs(times - at / 25) < 0.2
        for name, arm in ARMS.items():
            stamps = times[near] - at / 25 + SPACING_S * (number + 1)
            rows[name] += np.column_stack([stamps, joints[near, arm]]).tolist()
    options: list[object] = []
    for name in ARMS:
        np.savetxt(out / f"{name}.csv", rows[name], "%.9g", ",", header=JOINTS, comments="")
        options += ["--joints", f"{name}={out / f'{name}.csv'}"]
    camera_error = calibration(root, pair, out / f"p{pair}.yaml")
    views = (left, right, "--rate", 1 / SPACING_S, "--start", SPACING_S)
    calibrated = ("--calibration", out / f"p{pair}.yaml", "--unit", "mm")
    log, profile = common.make_log(out / f"p{pair}.mcap", *views, *calibrated, *options)
    common.with_camera_error(profile, camera_error)
    text = re.sub("(?m)^entry = .*\n", "", profile.read_text("utf-8"))
    for name, side in SIDES.items():
        text = re.sub(rf'^((instrument_)?name = "{name}")$', rf'\1\nentry = "{side}"', text, flags=re.M)
    profile.write_text(text, "utf-8")
    return log, profile


Places = dict[tuple[str, int], Array]
"""Places (3,) in m in a pair's left camera by arm and number of the trial."""


def apart(places: Mapping[int, Places], robots: Places) -> tuple[list[float], list[float]]:
    """In mm, of odd trials: depths from those in another pair, places from the robot's, each fitted to even trials."""
    depths, motions = [], []
    pairs = [(one, other) for one in places for other in places if one < other]
    for one, other in pairs:
        shared = sorted(places[one].keys() & places[other].keys())
        off = off_m(shared, places[one], places[other])
        depths += [abs(float(x @ places[one][key])) / float(np.linalg.norm(places[one][key])) for key, x in off.items()]
    for own in places.values():
        for arm in ARMS:
            off = off_m(sorted(key for key in own if key[0] == arm), own, robots)
            motions += [float(np.linalg.norm(x)) for x in off.values()]
    return [1e3 * x for x in depths], [1e3 * x for x in motions]


def off_m(keys: Sequence[tuple[str, int]], places: Places, others: Places) -> Places:
    """What others of odd trials are off, in the first ones' frame, after a fit to those of even ones."""
    even = [key for key in keys if key[1] % 2 == 0]
    if len(even) < LEAST_FITTED:
        return {}
    T = common.robust_fit(np.array([places[key] for key in even]), np.array([others[key] for key in even]))
    return {key: T[:3, :3] @ others[key] + T[:3, 3] - places[key] for key in keys if key[1] % 2}


def measure(folder: Path, out: Path) -> Iterator[common.Line]:
    """Rows of `shaft` and `stereo` of each pair, and how pairs and robot agree with them."""
    root, trials = folder / SET, common.FRAMES["d_lfd"]["trials"]
    out.mkdir(parents=True, exist_ok=True)
    logs = {pair: log_of(root, pair, trials, out) for pair in PAIRS}
    K, pictures, seen, rods = {}, {}, {}, dict[int, Places]()
    for pair in PAIRS:
        file = cv2.FileStorage(str(out / f"p{pair}.yaml"), cv2.FILE_STORAGE_READ)
        K[pair] = np.asarray(file.getNode("M1").mat(), np.float64)
        pictures[pair] = [common.read(out / f"p{pair}" / "left" / f"{trial:02d}.png") for trial in trials]
        seen[pair] = [common.by_network(bgr) for bgr in pictures[pair]]
    robots: Places = {}
    for number, trial in enumerate(trials):
        poses = robot(root, trial)[2]
        robots |= {(name, number): poses[int(AT * len(poses)), arm, :3, 3] for name, arm in ARMS.items()}
    beside: list[float] = []
    for pair in PAIRS:
        found = peer.found(pictures[pair], K[pair], RADIUS_M, 2)
        beside += peer.figures(found, seen[pair]).on
        rods[pair] = {("PSM1" if rod.mask[:, -3:].any() else "PSM2", n): rod.place_m for n, rod in found}
    peers = [common.Figures(str(len(beside)), "mm", off, beside) for off in apart(rods, robots)]
    for method in ("shaft", "stereo"):
        places, on, both, count = dict[int, Places](), [], 0, 0
        for pair in PAIRS:
            rows, total = common.rows_of(*logs[pair], method)
            places[pair] = {(row.instrument, row.number): common.pose_of(row).position_m for row in rows}
            on += [common.on_instrument(common.pose_of(row), K[pair], seen[pair][row.number], RADIUS_M) for row in rows]
            both += sum(all((name, n) in places[pair] for name in ARMS) for n in range(len(trials)))
            count += total
        text = f"{sum(map(len, places.values()))}/{count}; both {both}/{count // 2}"
        for against, off, other in zip(
            ("depth, other pairs", "robot, fitted"), apart(places, robots), peers, strict=True
        ):
            yield common.Line("d-lfd", f"`{method}`", against, common.Figures(text, "mm", off, on), other)
