"""Calibrations of ROS, OpenCV and Kalibr become the camera that they describe."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from svmdist.camera import stereo_transform
from svmdist.errors import SourceError
from svmdist.importing import calibration
from svmdist.transforms import make_transform, rotation_of

K = [572.2, 0.0, 378.8, 0.0, 571.0, 239.3, 0.0, 0.0, 1.0]
D = [-0.3, 0.1, 0.001, -0.002, 0.0]
KALIBR = {
    "camera_model": "pinhole",
    "intrinsics": [K[0], K[4], K[2], K[5]],
    "distortion_model": "radtan",
    "distortion_coeffs": D[:4],
    "resolution": [640, 480],
}
PAIR = {"M1": K, "M2": K, "R": np.eye(3).tolist()}
SIZES = [(640, 480), (640, 480)]
FRAMES = ("camera", "camera_right")


def _write(path: Path, document: object) -> Path:
    path.write_text(json.dumps(document, indent="\t"))  # which is YAML, too, but for the tabs
    return path


def test_ros_camera_info(tmp_path):
    """`camera_calibration`'s file and an echoed message give the same camera."""
    P = [560.0, 0.0, 370.0, -2.9, 0.0, 560.0, 240.0, 0.0, 0.0, 0.0, 1.0, 0.0]
    saved = {
        "image_width": 640,
        "image_height": 480,
        "camera_matrix": {"rows": 3, "cols": 3, "data": K},
        "distortion_model": "plumb_bob",
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": D},
        "projection_matrix": {"rows": 3, "cols": 4, "data": P},
    }
    echoed = {"height": 480, "width": 640, "distortion_model": "plumb_bob", "D": D, "K": K, "P": P}
    for document in (saved, echoed):
        (camera,) = calibration.read_calibration(_write(tmp_path / "a.yaml", document))
        np.testing.assert_allclose(camera.K.ravel(), K)
        np.testing.assert_allclose(camera.D, D)
        assert camera.size_px == (640, 480)
        np.testing.assert_allclose(camera.P.ravel(), P)


@pytest.mark.parametrize("key", ["D", "d", "dist", "dist_coeff", "dist_coeffs", "distortion", "distortion_coeffs"])
def test_distortion_has_many_names(tmp_path, key):
    """Of one camera, and with a number behind them of a pair."""
    T = {"T": [-0.0053, 0.0, 0.0]}
    for document in ({"K": K, key: [D]}, PAIR | T | {f"{key}1": [D], f"{key}2": [D]}):
        for camera in calibration.read_calibration(_write(tmp_path / "a.yaml", document)):
            np.testing.assert_allclose(camera.D, D)


@pytest.mark.parametrize("form", ["matrix", "vector", "numbers"])
@pytest.mark.parametrize("ending", ["yaml", "xml", "json"])
def test_opencv_file_storage(tmp_path, ending, form):
    """What OpenCV's own FileStorage wrote, with its header and tags, is read, in every form of its arrays."""
    path = tmp_path / f"opencv.{ending}"
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.write("image_width", 640)
    storage.write("image_height", 480)
    for name, values in (
        ("camera_matrix", np.reshape(K, (3, 3))),
        ("distortion_coefficients", np.array([D])),
    ):
        if form == "numbers":
            storage.startWriteStruct(name, cv2.FileNode_SEQ)
            for value in values.ravel():
                storage.write("", float(value))
            storage.endWriteStruct()
        else:
            storage.write(name, values if form == "matrix" else values.ravel())
    storage.release()
    written = path.read_text()
    for header in ("%YAML 1.2", "%YAML:1.0"):  # OpenCV 5's, and that of the versions before
        path.write_text(header + written[written.index("\n") :] if ending == "yaml" else written)
        (camera,) = calibration.read_calibration(path)
        np.testing.assert_allclose(camera.K.ravel(), K)
        np.testing.assert_allclose(camera.D, D)
        assert camera.size_px == (640, 480)
        assert camera.model == "plumb_bob"


@pytest.mark.parametrize("form", ["opencv", "kalibr"])
@pytest.mark.parametrize("unit_m", [1.0, 1e-3])
def test_pair_stands_where_it_says(tmp_path, form, unit_m):
    """R and T of a pair come back from the R and P that a log carries, within 1e-9 m."""
    R_right_left = rotation_of([0.01, -0.02, 0.005])
    t_m = np.array([-0.0053, 0.0002, -0.0001])
    t = (t_m / unit_m).tolist()
    if form == "opencv":
        document: dict[str, object] = {"M1": K, "D1": D, "M2": K, "D2": D, "R": R_right_left.tolist(), "T": t}
    else:
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = R_right_left, t
        document = {"cam0": KALIBR, "cam1": KALIBR | {"T_cn_cnm1": T.tolist()}}
    path = _write(tmp_path / "pair.yaml", document)
    stated = calibration.given_cameras(calibration.CalibrationOptions((path, None), unit_m=unit_m), 2)
    left, right = calibration.complete(stated, SIZES, FRAMES)
    T_left_right = stereo_transform(left, right)
    expected = np.linalg.inv(make_transform(R_right_left, t_m))
    np.testing.assert_allclose(T_left_right, expected, atol=1e-9)
    np.testing.assert_allclose(left.K.ravel(), K)


@pytest.mark.parametrize(
    ("document", "said"),
    [
        (
            {"cam0": KALIBR | {"distortion_model": "equidistant", "distortion_coeffs": [0.1]}},
            "4 coefficients, found 1",
        ),
        ({"colour": 1}, "expected camera_info of ROS"),
        ([1, 2], "Kalibr (cam0, cam1); or give --camera FX,FY,CX,CY; found '[1, 2]'"),
        ({"K": [500.0, 0, 0, 0, 500, 0, 160, 120, 1]}, "transpose a matrix of MATLAB"),
        ({"camera_matrix": [1.0, 2.0]}, "expected 3 x 3 numbers, found 2"),
        ({"K": ["a"] * 9}, "expected numbers"),
        ({"K": [0.0] * 9}, "not calibrated"),
        ({"K": K, "D": D, "distortion_model": "ftheta"}, "ftheta"),
        ({"K": K, "D": [0.1, 0.2, 0.3]}, "found 3"),
        ({"K": K, "lens_distortion": D}, "distortion; found lens_distortion: rename it"),
        (PAIR | {"left_dist": {"data": D}}, "distortion1; found left_dist: rename it"),
        ({"K": K, "image_width": "wide", "image_height": 4}, "found 'wide'"),
        ({"cam0": {"camera_model": "omni"}}, "only pinhole"),
        ({"cam0": {"intrinsics": [1.0]}}, "fu, fv, pu, pv"),
        ({"M1": K, "M2": K}, "where the right camera stands"),
        (PAIR | {"T": [0.0, 0.0, 0.0]}, "no pair of cameras"),
        ({"K": K, "D": [1e300] * 5}, "beyond 1e+09"),
    ],
)
def test_wrong_files(tmp_path, document, said):
    path = _write(tmp_path / "wrong.yaml", document)
    with pytest.raises(SourceError, match=r"wrong\.yaml") as caught:
        calibration.read_calibration(path)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("a: &a [1, 1]\nb: [*a, *a]\n", "not a YAML file: an alias"),
        ("K: !!python/object/apply:os.system ['true']\n", "not a YAML file"),
        ("K: [1, 2\n", "not a YAML file"),
        ("\0", "not a YAML file"),
        ("<?xml version='1.0'?><!DOCTYPE a [<!ENTITY b 'c'>]><a>&b;</a>", "not an XML file: a declaration"),
        ("<opencv_storage><K>1", "not an XML file"),
        ("#" * (calibration.MAX_BYTES + 1), "the limit"),
    ],
    ids=["alias", "object", "broken", "NUL", "entity", "broken XML", "large"],
)
def test_hostile_yaml(tmp_path, text, said):
    """Aliases, objects of Python, broken text and large files are refused in one line."""
    path = tmp_path / "bomb.yaml"
    path.write_text(text)
    with pytest.raises(SourceError, match=rf"bomb\.yaml: .*{said}") as caught:
        calibration.read_calibration(path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("document", "said"),
    [
        (PAIR | {"T": [0.0053, 0.0, 0.0]}, "to the left of the left one"),
        (PAIR | {"T": [-5.3, 0.0, 0.0]}, "are 5.3 m apart.* read in m; --unit says which: mm, cm, m"),
        (
            {"K": K, "width": 1280, "height": 720},
            "1280x720 px, the images have 640x480 px.*--calibrated-at 1280x720",
        ),
        (
            {"K": [0.9, 0, 0.5, 0, 0.9, 0.5, 0, 0, 1]},
            "focal lengths of 10 px or more, found fx = 0.9, fy = 0.9",
        ),
        ({"K": [2e7, 0, 300, 0, 2e7, 300, 0, 0, 1]}, "the camera is not calibrated"),
        ({"K": [900, 0, 700, 0, 900, 300, 0, 0, 1]}, "outside of the images of 640x480 px.*--calibrated-at"),
    ],
)
def test_implausible_cameras(tmp_path, document, said):
    """Exchanged views, lengths in mm and a calibration of another size or unit are told."""
    count = 2 if "M1" in document else 1
    stated = calibration.given_cameras(
        calibration.CalibrationOptions((_write(tmp_path / "a.yaml", document), None)), count
    )
    with pytest.raises(SourceError, match=said):
        calibration.complete(stated, SIZES[:count], FRAMES[:count])


def test_a_length_in_another_unit_is_named_by_the_one_that_was_read(tmp_path):
    path = _write(tmp_path / "a.yaml", PAIR | {"T": [-0.005, 0.0, 0.0]})
    stated = calibration.given_cameras(calibration.CalibrationOptions((path, None), unit_m=1e-3), 2)
    with pytest.raises(SourceError, match=r"are 5e-06 m apart.* read in mm; --unit says which"):
        calibration.complete(stated, SIZES, FRAMES, unit_m=1e-3)


@pytest.mark.parametrize("length", [-0.005, None])
def test_a_baseline_that_replaces_a_pair_s_names_both(tmp_path, caplog, length):
    path = _write(tmp_path / "a.yaml", PAIR | {"T": [length, 0.0, 0.0]} if length else {"K": K})
    stated = calibration.given_cameras(calibration.CalibrationOptions((path, None), baseline_m=0.007), 2)
    assert stereo_transform(*calibration.complete(stated, SIZES, FRAMES))[0, 3] == pytest.approx(0.007)
    said = f"--baseline 7 mm is taken for a rectified pair, in place of the 5 mm and rotations of {path}"
    assert (said in caplog.text) == (len(caplog.messages) > 0) == bool(length)


def test_views_of_two_sizes_have_two_cameras():
    """Where one is known for both, its pixels are of one size alone; calibrated at a size, it is scaled to each."""
    left, right = (572.2, 571.0, 378.8, 239.3), (286.1, 285.5, 189.1, 119.4)
    sizes = [(640, 480), (320, 240)]
    for given, calibrated_px in (((left, right), None), ((left, None), (640, 480))):
        options = calibration.CalibrationOptions(intrinsics=given, baseline_m=0.005)
        cameras = calibration.complete(calibration.given_cameras(options, 2), sizes, FRAMES, calibrated_px)
        np.testing.assert_allclose([camera.K[0, 0] for camera in cameras], [572.2, 286.1])
    for baseline_m in (0.005, None):
        options = calibration.CalibrationOptions(intrinsics=(left, None), baseline_m=baseline_m)
        with pytest.raises(SourceError, match="views of 640x480 and 320x240 px, and one camera for both: give"):
            calibration.complete(calibration.given_cameras(options, 2), sizes, FRAMES)


def test_scaled_and_cropped_images():
    """A point is seen in the same place of the picture, and the right camera stands where it stood."""
    of_pair = calibration.CalibrationOptions(intrinsics=((572.2, 571.0, 378.8, 239.3), None), baseline_m=0.005)
    stated = calibration.given_cameras(of_pair, 2)
    whole = calibration.complete(stated, SIZES, FRAMES)
    crop = (40, 20, 200, 160)
    small = calibration.complete(stated, [(320, 240)] * 2, FRAMES, (640, 480), crop)
    point_m = np.array([[0.01, -0.02, 0.15]])
    for before, after in zip(whole, small, strict=True):
        assert (after.width_px, after.height_px) == (200, 160)
        x_px, y_px = before.project(point_m)[0]
        expected = (x_px + 0.5) / 2.0 - 0.5 - 40.0, (y_px + 0.5) / 2.0 - 0.5 - 20.0
        np.testing.assert_allclose(after.project(point_m)[0], expected)
        np.testing.assert_allclose(after.P[:, :3], after.K)
    np.testing.assert_allclose(stereo_transform(*small), stereo_transform(*whole))
    for size_px, calibrated_px, said in (
        ((320, 180), (640, 480), "another aspect"),
        ((320, 960), None, "outside of the images of 320x960 px: if they hold one view above the other"),
        ((210, 158), (420, 316), "--crop goes beyond the images of 210x158 px"),
    ):
        with pytest.raises(SourceError, match=said):
            calibration.complete(stated, [size_px] * 2, FRAMES, calibrated_px, crop)
