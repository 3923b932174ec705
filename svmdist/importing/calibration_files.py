"""Calibration files of other programs: ROS `camera_info`, OpenCV's matrices, Kalibr's camera chains.

Whatever the form, the result is ROS's: K and D of each camera, and for a pair the rotations R that make both views
parallel, and P, whose fourth column has the baseline.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from svmdist.camera import KNOWN_DISTORTION
from svmdist.errors import SourceError, did_you_mean
from svmdist.importing.yaml_file import read_yaml
from svmdist.transforms import Array

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
