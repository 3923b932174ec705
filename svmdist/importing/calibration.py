"""A YAML file of a calibration as plain values, read within limits: the file is somebody else's."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, cast

import numpy as np
import yaml

from svmdist.camera import KNOWN_DISTORTION, Camera, DistortionModel, stereo_transform
from svmdist.errors import SourceError, UsageError, did_you_mean
from svmdist.input_file import read_regular, why
from svmdist.transforms import Array

MAX_BYTES = 1 << 20
OPENCV_HEADER = re.compile(r"\A%YAML:1\.0.*\n")
"""How OpenCV's FileStorage begins a file, which is no YAML directive."""


class _Loader(yaml.SafeLoader):
    """Plain values, OpenCV's matrices as mappings, and no aliases: a few of them stand for millions of values."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("an alias, which no calibration needs")
        return super().compose_node(parent, index)


def _mapping(loader: _Loader, node: yaml.Node) -> Any:
    assert isinstance(node, yaml.MappingNode)
    return loader.construct_mapping(node, deep=True)


_Loader.add_constructor("tag:yaml.org,2002:opencv-matrix", _mapping)


def read_yaml(path: Path) -> dict[str, Any]:
    """The first document of a YAML file, which must be a mapping; SourceError in one line for anything else."""
    try:
        data = read_regular(path, MAX_BYTES)
    except OSError as problem:
        raise SourceError(f"{path}: cannot read: {why(problem)}") from None
    try:
        text = OPENCV_HEADER.sub("", data.decode("utf-8"))
        document = next(iter(yaml.load_all(text, _Loader)), None)
    except (yaml.YAMLError, ValueError, AssertionError, RecursionError) as problem:
        raise SourceError(f"{path}: not a YAML file: {' '.join(str(problem).split())}") from None
    if not isinstance(document, dict):
        raise SourceError(
            f"{path}: expected a YAML mapping of a calibration, found {type(document).__name__}"
        )
    return {str(key): value for key, value in document.items()}


K_KEYS = ("camera_matrix", "K", "k", "cameraMatrix", "Camera_Matrix", "intrinsic_matrix")
D_KEYS = ("distortion_coefficients", "D", "d", "distCoeffs", "dist_coeffs", "Distortion_Coefficients")
R_KEYS = ("rectification_matrix", "R", "r")
P_KEYS = ("projection_matrix", "P", "p")
WIDTH_KEYS = ("image_width", "width", "image_Width")
HEIGHT_KEYS = ("image_height", "height", "image_Height")
PAIR_K_KEYS = (("M1", "M2"), ("K1", "K2"), ("cameraMatrix1", "cameraMatrix2"))
PAIR_D_KEYS = (("D1", "D2"), ("distCoeffs1", "distCoeffs2"))
FORMS = "camera_info of ROS (camera_matrix or K), OpenCV (camera_matrix, or M1, D1, M2, D2, R, T), Kalibr (cam0, cam1)"


@dataclass(frozen=True)
class StatedCamera:
    """One camera as a file or a command line states it: K (3, 3), D, R (3, 3) and P (3, 4) as ROS has them."""

    K: Array
    D: Array = field(default_factory=lambda: np.zeros(0))
    model: str = "plumb_bob"
    size_px: tuple[int, int] | None = None
    R: Array | None = None
    P: Array | None = None


def read_calibration(path: Path, unit_m: float = 1.0) -> tuple[StatedCamera, ...]:
    """The cameras of a file: one, or the left and the right one of a pair.

    `unit_m` is the unit of its lengths. Raises SourceError in one line for a file of another form.
    """
    document = read_yaml(path)
    if "cam0" in document:
        return _kalibr(path, document, unit_m)
    for keys in PAIR_K_KEYS:
        if set(keys) <= set(document):
            return _opencv_pair(path, document, keys, unit_m)
    if any(key in document for key in K_KEYS):
        return (_single(path, document, unit_m),)
    found = ", ".join(sorted(document)[:8]) or "nothing"
    raise SourceError(f"{path}: no calibration that is known; expected {FORMS}; found the keys {found}")


def model_of(name: str, count: int) -> str:
    """What svmdist calls a distortion model, by its name and its number of coefficients; ValueError for another one."""
    known = KNOWN_DISTORTION.get(name.lower())
    if known is None:
        raise ValueError(f"distortion model {name!r}: {did_you_mean(name, filter(None, KNOWN_DISTORTION))}")
    if known == "fisheye" and count != 4:
        raise ValueError(f"distortion model {name} has 4 coefficients, found {count}")
    if count not in (0, 4, 5, 8, 12, 14):
        raise ValueError(f"expected 4, 5, 8, 12 or 14 distortion coefficients, found {count}")
    return "rational_polynomial" if known == "plumb_bob" and count > 5 else known


def rectified(
    left: StatedCamera, right: StatedCamera, R_right_left: Array, t_m: Array
) -> tuple[StatedCamera, ...]:
    """A pair with the R and P that make its views parallel, where p_right = R_right_left p_left + t_m."""
    import cv2

    size = left.size_px or (round(2 * left.K[0, 2]), round(2 * left.K[1, 2]))  # of no weight for what follows
    R1, R2, P1, P2, *_ = cv2.stereoRectify(
        left.K, np.zeros(5), right.K, np.zeros(5), size, R_right_left, np.reshape(t_m, (3, 1))
    )
    return (
        StatedCamera(left.K, left.D, left.model, left.size_px, np.asarray(R1), np.asarray(P1)),
        StatedCamera(right.K, right.D, right.model, right.size_px, np.asarray(R2), np.asarray(P2)),
    )


def _single(path: Path, document: dict[str, Any], unit_m: float) -> StatedCamera:
    K = _matrix(path, document, K_KEYS, (3, 3))
    assert K is not None
    D = _matrix(path, document, D_KEYS, None)
    D = np.zeros(0) if D is None else D
    P = _matrix(path, document, P_KEYS, (3, 4))
    if P is not None:
        P = P * [1.0, 1.0, 1.0, unit_m]
    return StatedCamera(
        _checked_K(path, K),
        D,
        _model(path, str(document.get("distortion_model", document.get("camera_model", ""))), D),
        _size(path, document),
        _matrix(path, document, R_KEYS, (3, 3)),
        P if P is not None and P.any() else None,
    )


def _opencv_pair(
    path: Path, document: dict[str, Any], keys: tuple[str, str], unit_m: float
) -> tuple[StatedCamera, ...]:
    size = _size(path, document)
    cameras = []
    for side, key in enumerate(keys):
        K = _matrix(path, document, (key,), (3, 3))
        assert K is not None
        D = _matrix(path, document, tuple(pair[side] for pair in PAIR_D_KEYS), None)
        D = np.zeros(0) if D is None else D
        cameras.append(StatedCamera(_checked_K(path, K), D, _model(path, "", D), size))
    R = _matrix(path, document, ("R",), (3, 3))
    t = _matrix(path, document, ("T", "t"), None)
    if R is None or t is None or t.size != 3:
        raise SourceError(f"{path}: a pair needs R (3 x 3) and T (3): where the right camera stands")
    return rectified(cameras[0], cameras[1], R, t.ravel() * unit_m)


def _kalibr(path: Path, document: dict[str, Any], unit_m: float) -> tuple[StatedCamera, ...]:
    cameras = []
    for name in ("cam0", "cam1"):
        entry = document.get(name)
        if entry is None:
            continue
        if not isinstance(entry, dict):
            raise SourceError(f"{path}: {name} is no mapping")
        if entry.get("camera_model", "pinhole") != "pinhole":
            raise SourceError(f"{path}: {name}: camera_model {entry['camera_model']}: only pinhole is known")
        intrinsics = _matrix(path, entry, ("intrinsics",), None)
        if intrinsics is None or intrinsics.size != 4:
            raise SourceError(f"{path}: {name}: expected intrinsics of 4 numbers, fu, fv, pu, pv")
        fu, fv, pu, pv = intrinsics.ravel()
        D = _matrix(path, entry, ("distortion_coeffs",), None)
        D = np.zeros(0) if D is None else D.ravel()
        K = np.array([[fu, 0.0, pu], [0.0, fv, pv], [0.0, 0.0, 1.0]])
        resolution = _matrix(path, entry, ("resolution",), None)
        size = (
            None if resolution is None or resolution.size != 2 else (int(resolution[0]), int(resolution[1]))
        )
        model = _model(path, str(entry.get("distortion_model", "")), D)
        cameras.append(StatedCamera(_checked_K(path, K), D, model, size))
    if len(cameras) == 1:
        return tuple(cameras)
    T_cam1_cam0 = _matrix(path, document["cam1"], ("T_cn_cnm1",), (4, 4))
    if T_cam1_cam0 is None:
        raise SourceError(f"{path}: cam1 has no T_cn_cnm1: where it stands beside cam0")
    return rectified(cameras[0], cameras[1], T_cam1_cam0[:3, :3], T_cam1_cam0[:3, 3] * unit_m)


def _matrix(
    path: Path, document: dict[str, Any], keys: tuple[str, ...], shape: tuple[int, int] | None
) -> Array | None:
    """The first of some keys as numbers, of a shape or flat; None where there is none of them, or an empty list."""
    key = next((key for key in keys if key in document), None)
    value = None if key is None else document[key]
    if isinstance(value, dict):
        value = value.get("data")
    if value is None:
        return None
    try:
        numbers = np.array(value, np.float64).ravel()
    except (TypeError, ValueError):
        raise SourceError(f"{path}: {key}: expected numbers, found {str(value)[:60]!r}") from None
    if not np.isfinite(numbers).all():
        raise SourceError(f"{path}: {key}: a number that is not finite")
    if shape is None:
        return numbers
    if numbers.size == 0:
        return None
    if numbers.size != shape[0] * shape[1]:
        raise SourceError(f"{path}: {key}: expected {shape[0]} x {shape[1]} numbers, found {numbers.size}")
    return numbers.reshape(shape)


def _model(path: Path, name: str, D: Array) -> str:
    try:
        return model_of("" if name == "pinhole" else name, D.size)
    except ValueError as problem:
        raise SourceError(f"{path}: {problem}") from None


def _checked_K(path: Path, K: Array) -> Array:
    if not (K[0, 0] > 0 and K[1, 1] > 0):
        raise SourceError(f"{path}: the camera is not calibrated: fx = {K[0, 0]:g}, fy = {K[1, 1]:g}")
    return K


def _size(path: Path, document: dict[str, Any]) -> tuple[int, int] | None:
    found = [
        next((document[key] for key in keys if key in document), None) for keys in (WIDTH_KEYS, HEIGHT_KEYS)
    ]
    if None in found:
        return None
    try:
        width_px, height_px = (int(str(value)) for value in found)
    except ValueError:
        raise SourceError(
            f"{path}: expected a width and a height in px, found {found[0]} and {found[1]}"
        ) from None
    return (width_px, height_px) if width_px > 0 and height_px > 0 else None


PLAUSIBLE_BASELINE_M = (2e-4, 1.0)
"""An endoscope's is about 5 mm; beyond these bounds the unit is another one."""


@dataclass(frozen=True)
class CalibrationOptions:
    """Where the calibration comes from: files, or (fx, fy, cx, cy) in px; `unit_m` is the unit of lengths in files."""

    files: tuple[Path | None, Path | None] = (None, None)
    intrinsics: tuple[tuple[float, ...] | None, tuple[float, ...] | None] = (None, None)
    distortion: tuple[float, ...] = ()
    distortion_model: str = "plumb_bob"
    baseline_m: float | None = None
    unit_m: float = 1.0


def stated_cameras(options: CalibrationOptions, view_count: int) -> tuple[StatedCamera, ...]:
    """The cameras of one view or two, as stated; raises UsageError and SourceError in one line."""
    (left_file, right_file), (left_K, right_K) = options.files, options.intrinsics
    if (left_file is None) == (left_K is None):
        raise UsageError(
            "a camera needs a calibration: --calibration FILE, or --camera FX,FY,CX,CY"
            if left_file is None
            else "--calibration and --camera exclude each other: which of them is it?"
        )
    if left_file is not None:
        if options.distortion:
            raise UsageError("--distortion goes with --camera; a calibration file has its own")
        found = read_calibration(left_file, options.unit_m)
        if right_file is not None:
            found = (found[0], read_calibration(right_file, options.unit_m)[-1])
    else:
        assert left_K is not None
        if right_file is not None:
            raise UsageError(
                "--right-calibration goes with --calibration; beside --camera it is --right-camera"
            )
        rights = [right_K or left_K] if view_count == 2 else []
        found = tuple(_from_numbers(K, options) for K in (left_K, *rights))
    if view_count == 1:
        return found[:1]
    if len(found) == 1:
        if options.baseline_m is None:
            raise SourceError(
                f"{left_file}: has one camera, and there are two views: give --right-calibration, or --baseline for"
                " a rectified pair of equal cameras"
            )
        found = (found[0], found[0])
    return found if options.baseline_m is None else _parallel(found, options.baseline_m)


def complete(
    stated: Sequence[StatedCamera], sizes_px: Sequence[tuple[int, int]], frames: Sequence[str]
) -> list[Camera]:
    """Cameras of the size of their images; SourceError where the calibration is of another size, or no pair."""
    cameras = []
    for camera, (width_px, height_px), frame_id in zip(stated, sizes_px, frames, strict=True):
        if camera.size_px is not None and camera.size_px != (width_px, height_px):
            raise SourceError(
                f"the calibration is for {camera.size_px[0]}x{camera.size_px[1]} px, the images have"
                f" {width_px}x{height_px} px: calibrate at the size of the images"
            )
        if not (0 < camera.K[0, 2] < width_px and 0 < camera.K[1, 2] < height_px):
            raise SourceError(
                f"the principal point ({camera.K[0, 2]:g}, {camera.K[1, 2]:g}) is outside of the images of"
                f" {width_px}x{height_px} px"
            )
        P = np.hstack([camera.K, np.zeros((3, 1))]) if camera.P is None else camera.P
        R = np.eye(3) if camera.R is None else camera.R
        model = cast(DistortionModel, camera.model)
        cameras.append(Camera(width_px, height_px, camera.K, camera.D, R, P, frame_id, model))
    if len(cameras) == 2:
        _check_pair(stereo_transform(cameras[0], cameras[1]))
    return cameras


def _check_pair(T_left_right: Array | None) -> None:
    """SourceError where the right camera is not to the right, or further away than any pair is."""
    if T_left_right is None:
        return  # no baseline is known: the caller says so
    baseline_m = float(np.linalg.norm(T_left_right[:3, 3]))
    if not PLAUSIBLE_BASELINE_M[0] <= baseline_m <= PLAUSIBLE_BASELINE_M[1]:
        raise SourceError(
            f"the cameras are {baseline_m:g} m apart: if the calibration is in mm, say --unit mm"
        )
    if abs(T_left_right[1, 3]) > abs(T_left_right[0, 3]):
        raise SourceError("one camera stands above the other one; a pair is expected to stand side by side")
    if T_left_right[0, 3] <= 0:
        raise SourceError(
            f"the right camera stands {-T_left_right[0, 3] * 1e3:.3g} mm to the left of the left one:"
            " exchange the views and their calibrations"
        )


def _from_numbers(K: tuple[float, ...], options: CalibrationOptions) -> StatedCamera:
    fx, fy, cx, cy = K
    D = np.array(options.distortion, np.float64)
    try:
        model = model_of(options.distortion_model, D.size)
    except ValueError as problem:
        raise UsageError(f"--distortion: {problem}") from None
    return StatedCamera(np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), D, model)


def _parallel(pair: Sequence[StatedCamera], baseline_m: float) -> tuple[StatedCamera, ...]:
    """A pair of parallel cameras, the right one `baseline_m` to the right."""
    left, right = (replace(camera, R=None, P=None) for camera in pair)
    shift = np.array([[-right.K[0, 0] * baseline_m], [0.0], [0.0]])
    return left, replace(right, P=np.hstack([right.K, shift]))
