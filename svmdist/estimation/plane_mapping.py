"""The paper's mapping from screen to plane, eqs. (3)-(6), (21)-(27) and (33)-(35), and the file that refits it."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np
import tomli_w
from pydantic import Field

from svmdist.camera import Camera
from svmdist.errors import CalibrationError
from svmdist.files import write_atomically
from svmdist.profile.toml import MIN_NUMBER, StrictModel, parse_toml
from svmdist.transforms import Array

Equations = Literal["corrected", "printed"]

CM_PER_PIXEL = 0.0254  # one pixel at 100 dpi: 2.54 cm / 100, which eqs. (3) and (4) give as 0.0245 cm
MIN_SAMPLE_COUNT = 12  # four per coefficient: fewer leave the residuals without meaning
PUBLISHED_TISSUE_M = (0.099, 0.043)  # of eqs. (33) and (34): they can only be the tissue's x and y in m


class Quadratic(StrictModel):
    """q S² + l S + c: from screen to plane along one axis, both in cm; as it stands in a calibration file."""

    quadratic_per_cm: float
    linear: float
    constant_cm: float

    def __call__(self, screen_cm: Array) -> Array:
        """Evaluate at screen coordinates in cm."""
        return (self.quadratic_per_cm * screen_cm + self.linear) * screen_cm + self.constant_cm


PUBLISHED_X = Quadratic(quadratic_per_cm=-0.0036, linear=0.7938, constant_cm=-0.0403)
"""eq. (5), and (23). Its slope near S = 0 fits the authors' camera; units are not given, cm is assumed."""
PUBLISHED_Y = Quadratic(quadratic_per_cm=-0.0068, linear=0.0395, constant_cm=-0.4439)
"""eq. (6), and (24). Not monotone over the screen: with corrected S it turns around at row 114."""


def screen_cm_as_published(pixel: Array | float) -> Array:
    """eqs. (3) and (4) as published: S = (1 - T * 2.54) / 100, from +0.01 to -16.2 over 640 px."""
    return (1.0 - np.asarray(pixel) * 2.54) / 100.0


def screen_cm_corrected(pixel: Array | float) -> Array:
    """eqs. (3) and (4) corrected: S = 0.0254 T cm, one pixel at 100 dpi."""
    return CM_PER_PIXEL * np.asarray(pixel)


def displacement_cm_as_published(p_m: Array) -> Array:
    """eqs. (33), (34) as published, shape (..., 2): metres divided by 100, called cm, 10^4 too small."""
    return (np.array(PUBLISHED_TISSUE_M) - p_m[..., :2]) / 100.0


def displacement_cm_corrected(p_m: Array, tissue_m: Array) -> Array:
    """eqs. (33), (34) corrected, shape (..., 2) in cm: tissue from the recording, metres times 100."""
    return np.asarray((tissue_m[..., :2] - p_m[..., :2]) * 100.0)


def planar_distance(displacement: Array) -> Array:
    """eqs. (25)–(27), where "GC" is "GP", and (35): length, shape (...), of (..., 2) in the plane; without depth."""
    return np.hypot(displacement[..., 0], displacement[..., 1])


@dataclass(frozen=True, slots=True)
class PlaneMapping:
    """From pixels to the camera's xy plane: eqs. (3)–(6) in one reading, with one quadratic per axis."""

    equations: Equations
    x: Quadratic
    y: Quadratic

    def to_plane_m(self, point_px: Array) -> Array:
        """Map pixels, shape (..., 2), to plane coordinates in m, shape (..., 2)."""
        screen = screen_cm_as_published if self.equations == "printed" else screen_cm_corrected
        return np.stack([self.x(screen(point_px[..., 0])), self.y(screen(point_px[..., 1]))], -1) / 100.0


PUBLISHED_MAPPING = PlaneMapping("printed", PUBLISHED_X, PUBLISHED_Y)


def degeneracies(mapping: PlaneMapping, width_px: int, height_px: int) -> list[str]:
    """Say in sentences where a mapping cannot be right for an image of this size."""
    warnings = []
    if mapping.equations == "printed":
        low, high = float(screen_cm_as_published(width_px - 1)), float(screen_cm_as_published(0))
        warnings.append(
            f"eqs. (3), (4) as printed: S runs from {high:+.2f} to {low:+.1f} cm over {width_px} px;"
            " a pixel is 0.0254 cm there, not 0.0245"
        )
    for name, axis, size_px in (("(5), (23)", mapping.x, width_px), ("(6), (24)", mapping.y, height_px)):
        q = axis.quadratic_per_cm
        turning_cm = -axis.linear / (2.0 * q) if q else float("inf")
        row = (1.0 - turning_cm * 100.0) / 2.54 if mapping.equations == "printed" else turning_cm / CM_PER_PIXEL
        if 0 <= row < size_px:
            warnings.append(
                f"eqs. {name} turn around at pixel {row:.0f} of {size_px}: positions on both sides of it"
                " are mapped to the same place"
            )
    return warnings


class CameraModel(StrictModel):
    """Size, focal lengths, principal point and distortion of the camera that was calibrated."""

    width_px: int = Field(gt=0)
    height_px: int = Field(gt=0)
    fx_px: float = Field(gt=0)
    fy_px: float = Field(gt=0)
    cx_px: float
    cy_px: float
    distortion: tuple[float, ...] = ()


class Fit(StrictModel):
    """How well the quadratics fit their samples, in m, and the pixels that the samples span."""

    sample_count: int = Field(ge=1)
    rmse_x_m: float
    rmse_y_m: float
    max_error_m: float
    span_x_px: tuple[float, float]
    span_y_px: tuple[float, float]


class SourceFile(StrictModel):
    """A recording that the fit used."""

    name: str
    sha256: str = Field(pattern="^[0-9a-f]{64}$")


class Calibration(StrictModel):
    """A whole calibration file."""

    schema_: Literal["svmdist.calibration/1"] = Field(alias="schema")
    method: str
    created_by: str
    camera: CameraModel
    x: Quadratic
    y: Quadratic
    fit: Fit
    sources: tuple[SourceFile, ...] = Field(min_length=1)

    def require_camera(self, camera: Camera, recording_name: str) -> None:
        """Raise CalibrationError unless a recording's camera is the calibrated one, to 0.01 px."""
        own = self.camera
        K = np.array([[own.fx_px, 0.0, own.cx_px], [0.0, own.fy_px, own.cy_px], [0.0, 0.0, 1.0]])
        mine = Camera(own.width_px, own.height_px, K, np.array(own.distortion))
        if not mine.same_optics(camera, tolerance_px=0.01):
            raise CalibrationError(
                f"{recording_name}: the calibration is for another camera: expected {_describe(mine)},"
                f" found {_describe(camera)}; make one with `svmdist calibrate`"
            )


def fit_calibration(
    tool_px: Array, tool_m: Array, camera: Camera, method: str, created_by: str, sources: tuple[SourceFile, ...]
) -> Calibration:
    """Fit eqs. (5) and (6) by least squares; CalibrationError for few samples, a small span, no focal length.

    The tool was seen at `tool_px`, shape (n, 2), and truly was at `tool_m`, shape (n, 2), in the camera's plane.
    """
    if not (np.all(np.isfinite(camera.K)) and camera.K[0, 0] > 0 and camera.K[1, 1] > 0):
        found = f"fx_px = {camera.K[0, 0]:g}, fy_px = {camera.K[1, 1]:g}"
        raise CalibrationError(f"expected a camera with intrinsics to calibrate: found {found}")
    if len(tool_px) < MIN_SAMPLE_COUNT:
        expected = f"expected at least {MIN_SAMPLE_COUNT} measured frames to calibrate"
        raise CalibrationError(f"{expected}, found {len(tool_px)}")
    low_px, high_px = tool_px.min(0).tolist(), tool_px.max(0).tolist()
    for axis, size_px in enumerate((camera.width_px, camera.height_px)):
        if high_px[axis] - low_px[axis] < 0.25 * size_px:
            raise CalibrationError(
                f"the tool must cover at least a quarter of the image: along {'xy'[axis]} it covers"
                f" {high_px[axis] - low_px[axis]:.0f} of {size_px} px"
            )
    (x, residual_x), (y, residual_y) = (_fit_axis(tool_px, tool_m, axis) for axis in (0, 1))
    return Calibration(
        schema="svmdist.calibration/1",
        method=method,
        created_by=created_by,
        camera=CameraModel(
            width_px=camera.width_px,
            height_px=camera.height_px,
            fx_px=camera.K[0, 0],
            fy_px=camera.K[1, 1],
            cx_px=camera.K[0, 2],
            cy_px=camera.K[1, 2],
            distortion=tuple(camera.D.tolist()),
        ),
        x=x,
        y=y,
        fit=Fit(
            sample_count=len(tool_px),
            rmse_x_m=_stored(np.sqrt(np.mean(residual_x**2))),
            rmse_y_m=_stored(np.sqrt(np.mean(residual_y**2))),
            max_error_m=_stored(np.max(np.hypot(residual_x, residual_y))),
            span_x_px=(low_px[0], high_px[0]),
            span_y_px=(low_px[1], high_px[1]),
        ),
        sources=sources,
    )


def load_calibration(path: Path) -> Calibration:
    """Read a calibration file and check it; raises CalibrationError that names the file and the key."""
    return parse_toml(path, Calibration, CalibrationError)


def save_calibration(calibration: Calibration, path: Path) -> None:
    """Write a calibration file; raises OutputError where that fails."""
    write_atomically(path, [tomli_w.dumps(calibration.model_dump(mode="json", by_alias=True))])


def _fit_axis(tool_px: Array, tool_m: Array, axis: int) -> tuple[Quadratic, Array]:
    screen_cm = screen_cm_corrected(tool_px[:, axis])
    truth_cm = tool_m[:, axis] * 100.0
    # In a domain of the samples' own: S and S² are nearly parallel over an image otherwise.
    fitted, (_, rank, _, _) = np.polynomial.Polynomial.fit(screen_cm, truth_cm, 2, full=True)
    if rank < 3:
        raise CalibrationError(
            f"the tool must be seen at three places or more to fit a quadratic: along {'xy'[axis]} it is seen"
            f" at {len(np.unique(screen_cm))}"
        )
    constant, linear, q = np.pad(fitted.convert().coef, (0, 2))[:3]  # an exact zero is left out
    model = Quadratic(quadratic_per_cm=_stored(q), linear=_stored(linear), constant_cm=_stored(constant))
    return model, (model(screen_cm) - truth_cm) / 100.0


def _stored(value: float) -> float:
    """A number as a file holds it: a size that no file may hold has no effect, and is 0."""
    return 0.0 if abs(value) < MIN_NUMBER else float(value)


def _describe(camera: Camera) -> str:
    K = camera.K
    distortion = ", ".join(f"{value:g}" for value in np.trim_zeros(camera.D, "b"))
    return (
        f"{camera.width_px}x{camera.height_px} with fx {K[0, 0]:.2f}, fy {K[1, 1]:.2f},"
        f" cx {K[0, 2]:.2f}, cy {K[1, 2]:.2f} px and {f'distortion {distortion}' if distortion else 'no distortion'}"
    )
