"""Cameras of imported images: calibration files of ROS, OpenCV and Kalibr, or numbers, checked against the images.

Whatever the form, the result is ROS's: K and D of each camera, and for a pair the rotations R that make both views
parallel, and P, whose fourth column has the baseline.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, cast
from xml.etree import ElementTree

import numpy as np
import yaml

from svmdist.camera import KNOWN_DISTORTION, Camera, DistortionModel, stereo_transform
from svmdist.errors import SourceError, UsageError, did_you_mean, restated
from svmdist.files import read_regular, reading
from svmdist.importing.tables import LENGTHS_M, LOG
from svmdist.transforms import Array

MAX_BYTES = 1 << 20
OPENCV_HEADER = re.compile(r"\A%YAML:1\.0.*\n")
"""How OpenCV's FileStorage begins a file, which is no YAML directive."""
XML = re.compile(r"\s*<(\?xml|opencv_storage)")
DECLARATION = re.compile(r"<!(?!--)")
"""Of types and entities, a few of which stand for millions of characters."""
K_KEYS = ("camera_matrix", "K", "k", "cameraMatrix", "Camera_Matrix", "intrinsic_matrix")
D_KEYS = (
    *("distortion_coefficients", "D", "d", "distCoeffs", "dist_coeffs", "Distortion_Coefficients"),
    *("distortion_coeffs", "dist_coeff", "distCoeff", "dist", "distortion"),
)
SIZE_KEYS = (("image_width", "width", "image_Width"), ("image_height", "height", "image_Height"))
PAIR_K_KEYS = (("M1", "M2"), ("K1", "K2"), ("cameraMatrix1", "cameraMatrix2"))
PAIR_D_KEYS = tuple(tuple(f"{key}{side}" for key in D_KEYS) for side in "12")
FORMS = "camera_info of ROS (camera_matrix or K), OpenCV (camera_matrix, or M1, D1, M2, D2, R, T), Kalibr (cam0, cam1)"
TO_FORM = f"expected {FORMS}; or give --camera FX,FY,CX,CY"
PLAUSIBLE_BASELINE_M = (2e-4, 1.0)
"""An endoscope's is about 5 mm; beyond these bounds the unit is another one."""
MAX_NUMBER = 1e9
LEAST_FOCAL_PX = 10.0
"""Images of 320 px would show 173 degrees; a smaller number is in mm, or of coordinates without pixels."""
Document = dict[str, Any]
Size = tuple[int, int] | None
Crop = tuple[int, int, int, int] | None
"""The part of an image that is taken: x and y of its corner, width and height, in px."""


@dataclass(frozen=True)
class GivenCamera:
    """One camera as a file or a command line gives it: K (3, 3), D, R (3, 3) and P (3, 4) as ROS has them."""

    K: Array
    D: Array
    model: DistortionModel
    size_px: Size = None
    R: Array | None = None
    P: Array | None = None
    name: str = ""


@dataclass(frozen=True)
class CalibrationOptions:
    """Files, or (fx, fy, cx, cy) in px of images of `size_px`; `unit_m` is the unit of lengths in files."""

    files: tuple[Path | None, Path | None] = (None, None)
    intrinsics: tuple[tuple[float, ...] | None, tuple[float, ...] | None] = (None, None)
    distortion: tuple[float, ...] = ()
    distortion_model: str = "plumb_bob"
    baseline_m: float | None = None
    unit_m: float = 1.0
    size_px: Size = None


def given_cameras(options: CalibrationOptions, view_count: int) -> tuple[GivenCamera, ...]:
    """The cameras of one view or two, as given; raises UsageError and SourceError."""
    (left_file, right_file), (left_K, right_K) = options.files, options.intrinsics
    if left_file is not None and left_K is not None:
        raise UsageError("--calibration and --camera cannot be combined; give one")
    if left_file is not None:
        if options.distortion:
            raise UsageError("--distortion goes with --camera; a calibration file has its own")
        found = read_calibration(left_file, options.unit_m)
        if right_file is not None:
            found = (found[0], read_calibration(right_file, options.unit_m)[-1])
    elif left_K is not None:
        if right_file is not None:
            raise UsageError("--right-calibration goes with --calibration; with --camera: --right-camera")
        D = np.array(options.distortion, np.float64)
        with restated(ValueError, UsageError, "--distortion: "):
            model = _model_of(options.distortion_model, D.size)
        found = tuple(GivenCamera(_intrinsic_matrix(*K), D, model) for K in (left_K, right_K or left_K)[:view_count])
    else:
        raise UsageError("a camera needs a calibration: --calibration FILE, or --camera FX,FY,CX,CY")
    if view_count == 1 or (options.baseline_m is None and len(found) > 1):
        return found[:view_count]
    if options.baseline_m is None:
        remedy = "give --right-calibration, or --baseline for a rectified pair of equal cameras"
        raise SourceError(f"{left_file}: has one camera, and there are two views: {remedy}")
    P = found[-1].P
    if P is not None and P[0, 3]:
        said = "warning: --baseline %.4g mm is taken for a rectified pair, in place of the %.4g mm and rotations of %s"
        LOG.warning(said, options.baseline_m * 1e3, abs(P[0, 3] / P[0, 0]) * 1e3, right_file or left_file)
    left, right = (replace(camera, R=None, P=None) for camera in (found[0], found[-1]))
    shift = np.array([[-right.K[0, 0] * options.baseline_m], [0.0], [0.0]])
    return left, replace(right, P=np.hstack([right.K, shift]))


def complete(
    given: Sequence[GivenCamera],
    sizes_px: Sequence[tuple[int, int]],
    frames: Sequence[str],
    calibrated_px: Size = None,
    crop: Crop = None,
    unit_m: float = 1.0,
) -> list[Camera]:
    """Cameras of images of some sizes that were scaled since calibration, where its size is given, and are cropped.

    `unit_m` is the unit that its lengths were read in. Raises SourceError for another size, or for no camera or pair.
    """
    cameras = []
    is_one = np.array_equal(given[0].K, given[-1].K) and (given[0].size_px or calibrated_px) is None
    if is_one and len(set(sizes_px)) > 1:  # of one size a camera's pixels are known, of another one not
        sizes = " and ".join("{}x{}".format(*size_px) for size_px in sizes_px)
        remedy = "give the right one's own, by --right-calibration or --right-camera"
        raise SourceError(f"views of {sizes} px, and one camera for both: {remedy}")
    for camera, size_px, frame_id in zip(given, sizes_px, frames, strict=True):
        to_image = _scaling(camera, size_px, calibrated_px)
        (fx, _, cx), (_, fy, cy), _ = to_image @ camera.K
        of = "the images of {}x{} px".format(*size_px)
        if min(fx, fy) < LEAST_FOCAL_PX:
            remedy = "a length in mm is multiplied by the image's width in px over the sensor's in mm"
            found = f"found fx = {fx:g}, fy = {fy:g}"
            raise SourceError(f"expected focal lengths of {LEAST_FOCAL_PX:g} px or more, {found}: {remedy}")
        if not (0 < cx < size_px[0] and 0 < cy < size_px[1]):
            remedy = "were scaled since calibration, say --calibrated-at WIDTHxHEIGHT"
            if size_px[1] > 2 * size_px[0]:  # as halves of pictures that are higher than wide
                remedy = "hold one view above the other, which is not read, split them first"
            raise SourceError(f"the principal point ({cx:g}, {cy:g}) is outside of {of}: if they {remedy}")
        x_px, y_px, width_px, height_px = crop or (0, 0, *size_px)
        if x_px + width_px > size_px[0] or y_px + height_px > size_px[1]:
            raise SourceError(f"--crop goes beyond {of}")
        to_image[:2, 2] -= x_px, y_px
        K = to_image @ camera.K
        P = K @ np.eye(3, 4) if camera.P is None else to_image @ camera.P
        R = np.eye(3) if camera.R is None else camera.R
        with restated(ValueError, SourceError):
            cameras.append(Camera(width_px, height_px, K, camera.D, R, P, frame_id, camera.model))
    T_left_right = stereo_transform(cameras[0], cameras[1]) if len(cameras) == 2 else None
    if T_left_right is None:
        return cameras  # of a pair, no baseline is known: the caller says so
    x_m, y_m, _ = T_left_right[:3, 3]
    baseline_m = float(np.linalg.norm(T_left_right[:3, 3]))
    if not PLAUSIBLE_BASELINE_M[0] <= baseline_m <= PLAUSIBLE_BASELINE_M[1]:
        unit = next((name for name, length_m in LENGTHS_M.items() if length_m == unit_m), f"{unit_m:g} m")
        found = "the cameras are {:g} m apart, expected {:g} to {:g} m".format(baseline_m, *PLAUSIBLE_BASELINE_M)
        units = f"lengths of calibrations were read in {unit}; --unit says which: {', '.join(LENGTHS_M)}"
        raise SourceError(f"{found}: {units}")
    if abs(y_m) > abs(x_m):
        raise SourceError("one camera stands above the other one; a pair is expected to stand side by side")
    if x_m <= 0:
        found = f"the right camera stands {-x_m * 1e3:.3g} mm to the left of the left one"
        raise SourceError(f"{found}: exchange the views and their calibrations")
    return cameras


def _scaling(camera: GivenCamera, size_px: tuple[int, int], calibrated_px: Size) -> Array:
    """What takes pixels of the images that were calibrated to pixels of images of a size, shape (3, 3)."""
    (width_px, height_px), file_px = size_px, camera.size_px or calibrated_px or size_px
    of = f"the calibration is for {file_px[0]}x{file_px[1]} px"
    if calibrated_px is not None and calibrated_px != file_px:
        raise SourceError(f"{of}, not for {calibrated_px[0]}x{calibrated_px[1]} px, as --calibrated-at says")
    images = f"{width_px}x{height_px} px"
    if calibrated_px is None and file_px != size_px:
        option = f"--calibrated-at {file_px[0]}x{file_px[1]} if they were scaled, and nothing else"
        raise SourceError(f"{of}, the images have {images}: calibrate at the size of the images, or say {option}")
    if abs(width_px * file_px[1] - height_px * file_px[0]) > max(file_px):  # a pixel more or less
        raise SourceError(f"{of}, the images of {images} have another aspect: they were not only scaled")
    x, y = width_px / file_px[0], height_px / file_px[1]
    return np.array([[x, 0.0, (x - 1.0) / 2.0], [0.0, y, (y - 1.0) / 2.0], [0.0, 0.0, 1.0]])


class _Loader(yaml.SafeLoader):
    """Plain values, OpenCV's arrays as mappings, and no aliases: a few of them stand for millions of values."""

    def compose_node(self, parent: Any, index: Any) -> Any:
        if self.check_event(yaml.AliasEvent):
            raise yaml.YAMLError("an alias, which no calibration needs")
        return super().compose_node(parent, index)


_Loader.add_multi_constructor(
    "tag:yaml.org,2002:opencv-",
    lambda loader, _, node: loader.construct_mapping(cast(yaml.MappingNode, node), deep=True),
)


def read_calibration(path: Path, unit_m: float = 1.0) -> tuple[GivenCamera, ...]:
    """The cameras in OpenCV's XML or the first document of a YAML file: one, or the left and the right one of a pair.

    `unit_m` is the unit of its lengths. Raises SourceError in one line for a file of another form.
    """
    form = "a YAML"
    try:
        with reading(path, SourceError):
            text = OPENCV_HEADER.sub("", read_regular(path, MAX_BYTES).decode("utf-8-sig"))
        form = "an XML" if XML.match(text) else form
        # JSON may be indented by tabs, YAML not.
        document = _xml_document(text) if XML.match(text) else next(yaml.load_all(text.expandtabs(), _Loader), None)
    except (yaml.YAMLError, SyntaxError, ValueError, AssertionError, RecursionError) as problem:
        raise SourceError(f"{path}: not {form} file: {' '.join(str(problem).split())}; {TO_FORM}") from None
    if not isinstance(document, dict):
        raise SourceError(f"{path}: no calibration that is known; {TO_FORM}; found {str(document)[:40]!r}")
    with restated(ValueError, SourceError, f"{path}: "):
        return _cameras_in({str(key): value for key, value in document.items()}, unit_m)


def _xml_document(text: str) -> Any:
    """The values in a FileStorage of OpenCV: arrays as mappings with `data`, or flat, and text."""
    if DECLARATION.search(text):
        raise ValueError("a declaration, which no calibration needs")

    def value_of(element: ElementTree.Element) -> Any:
        data = element.find("data")
        if data is not None:
            return {"data": (data.text or "").split()}
        words = (element.text or "").split() or [one.text or "" for one in element.findall("_")]
        return words[0] if len(words) == 1 else words

    return {element.tag: value_of(element) for element in ElementTree.fromstring(text.strip())}


def _cameras_in(document: Document, unit_m: float) -> tuple[GivenCamera, ...]:
    if "cam0" in document:
        return _kalibr(document, unit_m)
    size = [_numbers(document, keys, None) for keys in SIZE_KEYS]
    width_px, height_px = (0 if number is None or number.size != 1 else int(number[0]) for number in size)
    size_px = (width_px, height_px) if width_px > 0 and height_px > 0 else None
    for keys in PAIR_K_KEYS:
        if set(keys) <= set(document):
            left, right = (_camera(document, keys[at : at + 1], PAIR_D_KEYS[at], "", size_px) for at in (0, 1))
            R, t = _numbers(document, ("R",), (3, 3)), _numbers(document, ("T", "t"), None)
            if R is None or t is None or t.size != 3:
                raise ValueError("a pair needs R (3 x 3) and T (3): where the right camera stands")
            return _rectified(left, right, R, t * unit_m)
    if not set(K_KEYS) & set(document):
        found = ", ".join(sorted(document)[:8]) or "nothing"
        raise ValueError(f"no calibration that is known; {TO_FORM}; found the keys {found}")
    model = str(document.get("distortion_model", document.get("camera_model", "")))
    camera = _camera(document, K_KEYS, D_KEYS, model, size_px)
    P = _numbers(document, ("projection_matrix", "P", "p"), (3, 4))
    P = P * [1.0, 1.0, 1.0, unit_m] if P is not None and P.any() else None
    R = _numbers(document, ("rectification_matrix", "R", "r"), (3, 3))
    return (replace(camera, R=R, P=P, name=str(document.get("camera_name", ""))),)


def exchanged_names(given: Sequence[GivenCamera]) -> str:
    """That the cameras of two views are named as those of the other view, in words; else ""."""
    wrong = [
        f"the camera of the {side} view is named {camera.name}"
        for side, other, camera in zip(("left", "right"), ("right", "left"), given, strict=False)
        if other in camera.name.lower() and side not in camera.name.lower()
    ]
    return f"{' and '.join(wrong)}: exchange the given" if len(given) == 2 and wrong else ""


def _kalibr(document: Document, unit_m: float) -> tuple[GivenCamera, ...]:
    cameras = []
    for name in ("cam0", "cam1") if document.get("cam1") is not None else ("cam0",):
        entry = document[name]
        if not isinstance(entry, dict):
            raise ValueError(f"{name} is no mapping")
        if entry.get("camera_model", "pinhole") != "pinhole":
            raise ValueError(f"{name}: camera_model {entry['camera_model']}: only pinhole is known")
        intrinsics = _numbers(entry, ("intrinsics",), None)
        if intrinsics is None or intrinsics.size != 4:
            raise ValueError(f"{name}: expected intrinsics of 4 numbers, fu, fv, pu, pv")
        size = _numbers(entry, ("resolution",), None)
        size_px = None if size is None or size.size != 2 else (int(size[0]), int(size[1]))
        model, entry["K"] = str(entry.get("distortion_model", "")), _intrinsic_matrix(*intrinsics)
        cameras.append(_camera(entry, ("K",), D_KEYS, model, size_px))
    if len(cameras) == 1:
        return tuple(cameras)
    T_cam1_cam0 = _numbers(document["cam1"], ("T_cn_cnm1",), (4, 4))
    if T_cam1_cam0 is None:
        raise ValueError("cam1 has no T_cn_cnm1: where it stands beside cam0")
    return _rectified(cameras[0], cameras[1], T_cam1_cam0[:3, :3], T_cam1_cam0[:3, 3] * unit_m)


def _camera(document: Document, K_keys: Sequence[str], D_keys: Sequence[str], model: str, size_px: Size) -> GivenCamera:
    K, D = _numbers(document, K_keys, (3, 3)), _numbers(document, D_keys, None)
    if D is None:
        others = [str(key) for key, value in document.items() if isinstance(value, list | dict)]
        if unread := [key for key in others if "dist" in key.lower() and key not in D_keys]:
            raise ValueError(f"expected distortion as {', '.join(D_keys)}; found {', '.join(unread)}: rename it")
        D = np.zeros(0)
    if K is None or not (K[0, 0] > 0 and K[1, 1] > 0):
        found = "no camera matrix" if K is None else f"fx = {K[0, 0]:g}, fy = {K[1, 1]:g}"
        raise ValueError(f"the camera is not calibrated: {found}")
    if not np.allclose(K[2], [0.0, 0.0, 1.0]):
        raise ValueError(f"expected 0 0 1 in the last row of K, found {K[2]}: transpose a matrix of MATLAB")
    return GivenCamera(K, D, _model_of("" if model == "pinhole" else model, D.size), size_px)


def _rectified(left: GivenCamera, right: GivenCamera, R_right_left: Array, t_m: Array) -> tuple[GivenCamera, ...]:
    """A pair with the R and P that make its views parallel, where p_right = R_right_left p_left + t_m."""
    import cv2

    # The size has no effect on R and P[:, 3].
    size_px = left.size_px or (round(2 * left.K[0, 2]), round(2 * left.K[1, 2]))
    try:
        none, t = np.zeros(5), np.reshape(t_m, (3, 1))
        R1, R2, P1, P2, *_ = cv2.stereoRectify(left.K, none, right.K, none, size_px, R_right_left, t)
    except cv2.error:
        raise ValueError("no pair of cameras stands as R and T say") from None
    left = replace(left, R=np.asarray(R1), P=np.asarray(P1))
    return left, replace(right, R=np.asarray(R2), P=np.asarray(P2))


def _intrinsic_matrix(fx: float, fy: float, cx: float, cy: float) -> Array:
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _model_of(name: str, count: int) -> DistortionModel:
    known = KNOWN_DISTORTION.get(name.lower())
    if known is None:
        raise ValueError(f"distortion model {name!r}: {did_you_mean(name, filter(None, KNOWN_DISTORTION))}")
    if known == "fisheye" and count != 4:
        raise ValueError(f"distortion model {name} has 4 coefficients, found {count}")
    if count not in (0, 4, 5, 8, 12, 14):
        raise ValueError(f"expected 4, 5, 8, 12 or 14 distortion coefficients, found {count}")
    return "rational_polynomial" if known == "plumb_bob" and count > 5 else known


def _numbers(document: Document, keys: Sequence[str], shape: tuple[int, int] | None) -> Array | None:
    """The value of the first of some keys as numbers, of a shape or flat; None where it is missing or empty."""
    key = next((key for key in keys if key in document), "")
    value = document.get(key)
    if isinstance(value, dict):
        value = value.get("data")
    if value is None:
        return None
    try:
        numbers = np.array(value, np.float64).ravel()
    except (TypeError, ValueError, OverflowError):
        raise ValueError(f"{key}: expected numbers, found {str(value)[:60]!r}") from None
    if not (np.abs(numbers) < MAX_NUMBER).all():
        raise ValueError(f"{key}: a number that is not finite, or beyond {MAX_NUMBER:g}")
    if shape is None:
        return numbers
    if numbers.size not in (0, shape[0] * shape[1]):
        raise ValueError(f"{key}: expected {shape[0]} x {shape[1]} numbers, found {numbers.size}")
    return numbers.reshape(shape) if numbers.size else None
