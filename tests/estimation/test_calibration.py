"""Calibration: known quadratics come back, files survive the round trip, and errors name the key."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from svmdist.camera import Camera
from svmdist.errors import CalibrationError
from svmdist.estimation.plane_mapping import (
    MIN_SAMPLE_COUNT,
    Calibration,
    PlaneMapping,
    Quadratic,
    SourceFile,
    fit_calibration,
    load_calibration,
    save_calibration,
)
from svmdist.transforms import Array

CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)
SOURCES = (SourceFile(name="calibration.mcap", sha256="0" * 64),)
TRUE_X, TRUE_Y = (
    Quadratic(quadratic_per_cm=-0.0036, linear=0.7938, constant_cm=-6.4),
    Quadratic(quadratic_per_cm=0.002, linear=0.81, constant_cm=-4.9),
)


def samples(x: Quadratic = TRUE_X, y: Quadratic = TRUE_Y, count: int = 60, noise_m: float = 0.0) -> tuple[Array, Array]:
    """Noise-free or noisy samples all over the image under known quadratics, in px and m."""
    rng = np.random.default_rng(1)
    tool_px = rng.uniform([20, 20], [620, 460], (count, 2))
    tool_m = PlaneMapping("corrected", x, y).to_plane_m(tool_px)
    return tool_px, tool_m + rng.normal(scale=noise_m, size=tool_m.shape)


def fitted(**changes: object) -> Calibration:
    """A calibration fitted to the samples that the changes ask for."""
    return fit_calibration(*samples(**changes), CAMERA, "overlay", "svmdist 0.1.0", SOURCES)


coefficients = st.builds(
    Quadratic.model_construct,
    quadratic_per_cm=st.floats(-0.01, 0.01),
    linear=st.floats(-1.0, 1.0),
    constant_cm=st.floats(-10.0, 10.0),
)


@settings(max_examples=50)
@given(coefficients, coefficients)
def test_known_quadratics_are_recovered(x, y):
    """Noise-free samples give back all six coefficients within 1e-9, and residuals of zero."""
    found = fitted(x=x, y=y)
    for model, true in ((found.x, x), (found.y, y)):
        assert model.quadratic_per_cm == pytest.approx(true.quadratic_per_cm, abs=1e-9)
        assert model.linear == pytest.approx(true.linear, abs=1e-9)
        assert model.constant_cm == pytest.approx(true.constant_cm, abs=1e-9)
    assert found.fit.max_error_m < 1e-12


def test_too_few_samples_and_too_small_a_span_are_refused():
    """Fewer than twelve samples, or all within a quarter of the image along one axis; twelve are enough."""
    for count in (0, 1, MIN_SAMPLE_COUNT - 1):
        with pytest.raises(CalibrationError, match=f"at least {MIN_SAMPLE_COUNT} .* found {count}"):
            fitted(count=count)
    assert fitted(count=MIN_SAMPLE_COUNT).fit.sample_count == MIN_SAMPLE_COUNT
    tool_px, tool_m = samples()
    for axis, (name, size_px) in enumerate((("x", 640), ("y", 480))):
        narrow = tool_px.copy()
        narrow[:, axis] = np.linspace(200, 200 + 0.24 * size_px, len(narrow))
        with pytest.raises(CalibrationError, match=f"along {name} it covers .* of {size_px} px"):
            fit_calibration(narrow, tool_m, CAMERA, "overlay", "svmdist", SOURCES)


def test_a_file_survives_the_round_trip(tmp_path):
    """What is saved is loaded bit for bit, distortion and sources included, and saving again changes nothing."""
    camera = replace(CAMERA, D=np.array([-0.3, 0.1, 1e-3, 0.0, 0.0]))
    sources = (*SOURCES, SourceFile(name='gebäude "2".mcap', sha256="f" * 64))
    saved = fit_calibration(*samples(noise_m=1e-4), camera, "overlay", "svmdist 0.1.0", sources)
    path = tmp_path / "calibration.toml"
    save_calibration(saved, path)
    loaded = load_calibration(path)
    assert loaded == saved
    first = path.read_bytes()
    save_calibration(loaded, path)
    assert path.read_bytes() == first


def test_a_calibration_is_for_its_camera_only():
    """Its own camera passes, also with 0.005 px of rounding; another size or focal length names both."""
    calibration = fitted()
    calibration.require_camera(CAMERA, "a.mcap")
    calibration.require_camera(replace(CAMERA, K=CAMERA.K + 0.005 * np.diag([1, 1, 0])), "a.mcap")
    others = {
        "1280x960": Camera.from_horizontal_fov(1280, 960, np.pi / 3),
        "fx 564.26": replace(CAMERA, K=CAMERA.K + np.diag([10.0, 0, 0])),
        "cx 320.50": replace(CAMERA, K=CAMERA.K + np.array([[0, 0, 1.0], [0, 0, 0], [0, 0, 0]])),
    }
    for found, camera in others.items():
        with pytest.raises(CalibrationError, match=f"^a.mcap: .*expected 640x480 .* found .*{found}"):
            calibration.require_camera(camera, "a.mcap")


def test_a_bad_file_names_file_key_and_nearest_key(tmp_path):
    """In one line, as for profiles."""
    path = tmp_path / "bad.toml"
    save_calibration(fitted(), path)
    path.write_text(path.read_text("utf-8").replace("linear =", "liner =", 1), "utf-8")
    with pytest.raises(CalibrationError, match=r"bad\.toml: unknown key x\.liner: did you mean linear\?") as caught:
        load_calibration(path)
    assert "\n" not in str(caught.value)
