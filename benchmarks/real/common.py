"""What the sets share: logs by the program's own commands, rows of methods, and the lines of the page."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

import svmdist
from benchmarks.masks import instruments_of, shipped_network
from svmdist.estimation.alignment import rigid_fit
from svmdist.profile import Profile
from svmdist.results import FrameResult, ToolPose
from svmdist.samples import Image
from svmdist.transforms import Array

Mask = NDArray[np.bool_]
FRAMES: dict[str, Any] = tomllib.loads(Path(__file__).with_name("frames.toml").read_text("utf-8"))
"""Which frames of each set are measured."""
CHI_95 = {2: 5.99, 3: 7.81}
"""Squares of normalised errors, by the degrees of freedom, that 95 % are below."""
ON_INSTRUMENT = 0.7
"""Least share of what a row projects to that is on an instrument, if the row is."""
LIT = 20
"""Level, of 255, above which a pixel is picture: around a round view it is black."""
COLUMNS = (
    *("set", "method", "against", "rows", "error", "in 95%", "on instrument"),
    *("OpenCV: rows", "error", "on instrument"),
)


@dataclass(frozen=True)
class Figures:
    """What was measured: rows, errors (n,) in `unit`, the shares on an instrument, and what is in 95 % intervals."""

    rows: str
    unit: str = ""
    errors: Any = ()
    on: Sequence[float] = ()
    in_95: Any = ()

    @property
    def error(self) -> str:
        """Median and 95th percentile."""
        return f"{number(self.errors)} ({number(self.errors, 95.0)}) {self.unit}" if len(self.errors) else "–"

    @property
    def on_instrument(self) -> str:
        """How much of it lies on an instrument."""
        return share(np.array(self.on) >= ON_INSTRUMENT)


@dataclass(frozen=True)
class Line:
    """A method on a set against a reference, and the fifteen lines of OpenCV, where they can be asked for it."""

    of: str
    method: str
    against: str
    own: Figures
    peer: Figures = Figures("–")

    @property
    def cells(self) -> tuple[str, ...]:
        """Its row of the table."""
        shown = (self.own.rows, self.own.error, share(self.own.in_95), self.own.on_instrument)
        return (
            self.of,
            self.method,
            self.against,
            *shown,
            self.peer.rows,
            self.peer.error,
            self.peer.on_instrument,
        )


def number(values: Any, percentile: float = 50.0) -> str:
    """A percentile of values, a dash where there is none."""
    return f"{np.percentile(values, percentile):.3g}" if len(values) else "–"


def share(values: Any) -> str:
    """How many of truth values hold."""
    return f"{100.0 * float(np.mean(values)):.0f}%" if len(values) else "–"


def run(*arguments: object) -> None:
    """A command of svmdist, which must succeed."""
    subprocess.run([sys.executable, "-m", "svmdist", *map(str, arguments), "-q"], check=True)


def make_log(path: Path, *arguments: object, instrument: str = "da-vinci-8mm") -> tuple[Path, Path]:
    """A log by `import`, and its profile by `profile new`, of an instrument that every set is said to show."""
    profile = path.with_suffix(".toml")
    path.parent.mkdir(parents=True, exist_ok=True)
    run("import", *arguments, "--force", "-o", path)
    run("profile", "new", path, "--instrument", instrument, "--force", "-o", profile)
    return path, profile


def write_calibration(path: Path, K: Sequence[Array], D: Sequence[Array], T: Array) -> None:
    """Both cameras and the transform from left to right, (4, 4), as OpenCV's file of a pair."""
    path.parent.mkdir(parents=True, exist_ok=True)
    file = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    stored = {"M1": K[0], "D1": D[0], "M2": K[1], "D2": D[1], "R": T[:3, :3], "T": T[:3, 3:]}
    for name, value in stored.items():
        file.write(name, np.ascontiguousarray(value))
    file.release()


def with_camera_error(profile: Path, table: str) -> None:
    """Puts a `[camera_error]` into a profile in place of the one that is there."""
    text = profile.read_text("utf-8")
    text = re.sub(r"(?<=\[camera_error\])([^\n]*\n)(\w.*\n)+", lambda found: found[1] + table, text)
    profile.write_text(text, "utf-8")


def rows_of(log: Path, profile: Path | Profile, method: str) -> tuple[list[FrameResult], int]:
    """The measured rows of a method, and how many rows there are."""
    rows = list(svmdist.estimate(svmdist.open_recording(log, profile), method))
    return [row for row in rows if row.measured and row.tool is not None], len(rows)


def copied(paths: Iterable[Path], folder: Path) -> Path:
    """An empty folder with copies of images, numbered in their order."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for number, path in enumerate(paths):
        shutil.copy(path, folder / f"{number:03d}{path.suffix}")
    return folder


def pose_of(row: FrameResult) -> ToolPose:
    """The tool's pose of a measured row."""
    assert row.tool is not None
    return row.tool.pose


def read(path: Path) -> Image:
    """An image in BGR, shape (h, w, 3)."""
    if (image := cv2.imread(str(path), cv2.IMREAD_COLOR)) is None:
        raise SystemExit(f"{path}: expected an image")
    return np.asarray(image, np.uint8)


def by_network(bgr: Image) -> Mask:
    """Where the shipped network sees an instrument, shape (h, w): no truth, for sets without masks."""
    return instruments_of(shipped_network(from_border=False).masks(bgr))


def outline(pose: ToolPose, K: Array, size: tuple[int, int], radius_m: float) -> Mask:
    """Where a shaft of a radius ends in the tool's origin, and what is before it, cover an image of `size` (h, w)."""
    end = pose.position_m if pose.hinge is None else pose.hinge.position_m
    mask = np.zeros(size, np.uint8)
    for start, way, thick in ((end, -0.2 * pose.axis, 1.0), (end, pose.position_m - end, 0.6)):
        points = start + np.linspace(0.0, 1.0, 60)[:, None] * way
        points = points[points[:, 2] > 0.01]
        across = np.cross(points, way)
        across /= np.maximum(np.linalg.norm(across, axis=1, keepdims=True), 1e-12)
        sides = np.concatenate([points + thick * radius_m * across, (points - thick * radius_m * across)[::-1]])
        if len(points) > 1 and np.linalg.norm(way) > 1e-4:
            px = (sides @ K.T)[:, :2] / sides[:, 2:]
            cv2.fillPoly(mask, [np.rint(16 * np.clip(px, -1e4, 1e4)).astype(np.int32)], 1, shift=4)
    return mask > 0


def on_instrument(pose: ToolPose, K: Array, seen: Mask, radius_m: float, lit: Mask | bool = True) -> float:
    """The share of what a pose projects to that is on what is seen, shape (h, w), within a round view; 0 beside it."""
    covered = outline(pose, K, (seen.shape[0], seen.shape[1]), radius_m) & lit
    return float(seen[covered].mean()) if covered.any() else 0.0


def on_instruments(
    rows: Iterable[FrameResult], K: Array, pictures: Sequence[Image], seen: Sequence[Mask], radius_m: float
) -> list[float]:
    """The same of each row, by what is seen of instruments in its picture, where light reaches."""
    lit = [(bgr.max(axis=2) > LIT) | mask for bgr, mask in zip(pictures, seen, strict=True)]
    return [on_instrument(pose_of(row), K, seen[row.number], radius_m, lit[row.number]) for row in rows]


def pixel(point_m: Array, K: Array) -> Array:
    """Where the image shows points (…, 3)."""
    return np.asarray((point_m @ K.T)[..., :2] / point_m[..., 2:])


def within_px(row: FrameResult, off_px: Array, K: Array, reference_std_px: float) -> bool:
    """Whether an error in the image, (2,), is inside of the row's 95 % interval and the reference's own noise."""
    pose = pose_of(row)
    x, y, z = pose.position_m
    J = K[:2, :2] @ np.array([[1.0 / z, 0.0, -x / z**2], [0.0, 1.0 / z, -y / z**2]])
    S = J @ pose.position_covariance @ J.T + reference_std_px**2 * np.eye(2)
    return bool(off_px @ np.linalg.solve(S, off_px) < CHI_95[2])


def robust_fit(to_m: Array, from_m: Array) -> Array:
    """T (4, 4) of least distances that takes places (n, 3) to others."""
    weights = np.ones(len(to_m))
    for _ in range(20):
        T = rigid_fit(to_m, from_m, weights)
        off_m = np.linalg.norm(from_m @ T[:3, :3].T + T[:3, 3] - to_m, axis=1)
        weights = 1.0 / np.maximum(off_m, max(float(np.median(off_m)), 1e-6))
    return np.asarray(T)


def K_of(fx: float, fy: float, cx: float, cy: float) -> Array:
    """A camera matrix, (3, 3)."""
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
