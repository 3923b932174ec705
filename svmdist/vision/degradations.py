"""What spoils endoscope images: the paper's blurs, degradations by name and severity, borders, and coarse colour."""

from __future__ import annotations

from enum import StrEnum
from functools import lru_cache

import cv2
import numpy as np

from svmdist.errors import UsageError, did_you_mean
from svmdist.samples import Image
from svmdist.transforms import Array


class Blur(StrEnum):
    """The rows of Table I, and a clean row to compare with. The paper counts the morphological two as blurs."""

    NONE = "none"
    EROSION = "erosion"
    DILATION = "dilation"
    GAUSSIAN = "gaussian"
    MEDIAN = "median"
    BILATERAL = "bilateral"


def apply_blur(image_bgr: Image, blur: Blur, kernel_px: int) -> Image:
    """Degrade an image, shape (h, w, 3), with a kernel of `kernel_px` (odd) pixels."""
    square = np.ones((kernel_px, kernel_px), np.uint8)
    match blur:
        case Blur.NONE:
            return image_bgr
        case Blur.EROSION:
            return np.asarray(cv2.erode(image_bgr, square), np.uint8)
        case Blur.DILATION:
            return np.asarray(cv2.dilate(image_bgr, square), np.uint8)
        case Blur.GAUSSIAN:
            # OpenCV's own for wide kernels; up to 7 px it would take narrower binomial ones.
            sigma_px = 0.3 * ((kernel_px - 1) / 2 - 1) + 0.8
            return np.asarray(cv2.GaussianBlur(image_bgr, (kernel_px, kernel_px), sigma_px), np.uint8)
        case Blur.MEDIAN:
            return np.asarray(cv2.medianBlur(image_bgr, kernel_px), np.uint8)
        case Blur.BILATERAL:
            return np.asarray(cv2.bilateralFilter(image_bgr, kernel_px, 75.0, float(kernel_px)), np.uint8)


REFERENCE_WIDTH_PX = 640
SEVERITIES = (1, 2, 3, 4, 5)


class Degradation(StrEnum):
    """What is wrong with the image."""

    DEFOCUS = "defocus"
    MOTION_BLUR = "motion_blur"
    NOISE = "noise"
    LOW_LIGHT = "low_light"
    SPECULAR = "specular"
    SMOKE = "smoke"
    JPEG = "jpeg"


# By severity. Radius of the disc a point becomes: a fixed-focus endoscope is sharp from some 3 to 15 cm, less so closer
DEFOCUS_RADIUS_PX = (1.0, 1.7, 2.7, 4.0, 6.0)
# Length of the path across the image during an exposure of 1/60 s. A tool at 90 mm moves 1 px for every 10 mm/s:
# these are speeds of 30 to 220 mm/s, or a camera that turns by 20 to 140 degrees per second
MOTION_LENGTH_PX = (3.0, 6.0, 10.0, 15.0, 22.0)
NOISE_LEVELS = (4.0, 8.0, 14.0, 22.0, 32.0)  # of 8 bits, in each channel: 2 is a good sensor, 14 one at high gain
# The remaining fraction of the light, and the photons that a white pixel had at full light. Shot noise (Poisson) grows
# relative to the falling light, because the camera's gain is at its limit
LOW_LIGHT = ((0.7, 3000.0), (0.5, 1500.0), (0.35, 800.0), (0.22, 400.0), (0.13, 200.0))
SPECULAR_COUNT = (4, 8, 14, 22, 34)  # of glints on wet surfaces; those of a severity are among those of the next
# The share of the light that the plume's densest part scatters; cautery smoke is white and has structure of a fifth of
# the image and finer (image formation of haze, Koschmieder 1924)
SMOKE_DENSITY, SMOKE_BGR = (0.15, 0.3, 0.45, 0.6, 0.75), (208.0, 204.0, 200.0)
JPEG_QUALITY = (60, 40, 25, 14, 7)  # of 100: recorders use 80 and more, streams fall to 25 and below


def require_degradation(name: str, severity: int) -> Degradation:
    """The degradation of that name; raises UsageError that lists the names, or the severities."""
    if name not in list(Degradation):
        raise UsageError(f"no degradation named {name}: {did_you_mean(name, list(Degradation))}")
    if severity not in SEVERITIES:
        raise UsageError(f"the severity of {name} is a whole number from 1 to 5, found {severity}")
    return Degradation(name)


def image_seed(kind: Degradation, camera: int, *path: int) -> int:
    """The seed of one image: `path` determines log and frame, `camera` is 0 for the left one and 1 for the right."""
    # Both cameras of a pair see the same scene and motion, each by its own sensor.
    is_own = kind in (Degradation.NOISE, Degradation.LOW_LIGHT)
    return int(np.random.SeedSequence([*path, camera if is_own else 0]).generate_state(1)[0])


def degrade(image_bgr: Image, name: Degradation | str, severity: int, seed: int) -> Image:
    """Degrade an image, shape (h, w, 3), alike for a seed, by a name and severity as `require_degradation` checks."""
    rng = np.random.default_rng(seed)
    level = severity - 1
    scale = image_bgr.shape[1] / REFERENCE_WIDTH_PX
    degraded: Array
    match Degradation(name):
        case Degradation.DEFOCUS:
            return _filtered(image_bgr, _disc(DEFOCUS_RADIUS_PX[level] * scale))
        case Degradation.MOTION_BLUR:
            return _filtered(image_bgr, _line(MOTION_LENGTH_PX[level] * scale, rng.uniform(0.0, np.pi)))
        case Degradation.NOISE:
            degraded = image_bgr + rng.normal(0.0, NOISE_LEVELS[level], image_bgr.shape)
        case Degradation.LOW_LIGHT:
            light, photon_count = LOW_LIGHT[level]
            photons = rng.poisson(image_bgr * (light * photon_count / 255.0))
            degraded = np.asarray(photons * (255.0 / photon_count), np.float64)
        case Degradation.SPECULAR:
            glare = _glints(rng, image_bgr.shape[:2], SPECULAR_COUNT[level], scale)[..., None]
            degraded = np.asarray(image_bgr + glare * (255.0 - image_bgr), np.float64)
        case Degradation.SMOKE:
            scattered = SMOKE_DENSITY[level] * _plume(rng, image_bgr.shape[:2])[..., None]
            degraded = np.asarray(image_bgr * (1.0 - scattered), np.float64) + scattered * np.array(SMOKE_BGR)
        case Degradation.JPEG:
            _, data = cv2.imencode(".jpg", image_bgr, [cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY[level]])
            return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)
    return np.clip(np.rint(degraded, out=degraded), 0, 255, out=degraded).astype(np.uint8)


def _filtered(image_bgr: Image, kernel: Array) -> Image:
    return np.asarray(cv2.filter2D(image_bgr, -1, kernel, borderType=cv2.BORDER_REFLECT_101), np.uint8)


def _disc(radius_px: float) -> Array:
    """A disc with an even edge of one pixel, normalised to a sum of 1."""
    half = int(np.ceil(radius_px + 0.5))
    y, x = np.mgrid[-half : half + 1, -half : half + 1]
    weight = np.clip(radius_px + 0.5 - np.hypot(x, y), 0.0, 1.0)
    return np.asarray(weight / weight.sum())


def _line(length_px: float, angle_rad: float) -> Array:
    half = int(np.ceil(length_px / 2.0)) + 1
    kernel = np.zeros((2 * half + 1, 2 * half + 1))
    for along_px in np.linspace(-length_px / 2.0, length_px / 2.0, 16 * half):
        x, y = half + along_px * np.cos(angle_rad), half + along_px * np.sin(angle_rad)
        column, row = int(x), int(y)
        right, down = x - column, y - row
        kernel[row : row + 2, column : column + 2] += np.outer([1.0 - down, down], [1.0 - right, right])
    return np.asarray(kernel / kernel.sum())


def _glints(rng: np.random.Generator, shape: tuple[int, int], count: int, scale: float) -> Array:
    """Soft-edged ellipses, 0 to 1, shape (height, width); a larger count adds to the same ones."""
    canvas = np.zeros(shape, np.uint8)
    for _ in range(count):
        x, y = (rng.uniform(0.0, 1.0, 2) * (shape[1], shape[0])).tolist()
        radius_px, slimness, turn_deg = rng.uniform(3.0, 12.0), rng.uniform(0.3, 1.0), rng.uniform(0.0, 180.0)
        size_px = 2.0 * (radius_px * scale), 2.0 * (radius_px * slimness * scale)
        cv2.ellipse(canvas, ((x, y), size_px, turn_deg), 255, -1, cv2.LINE_AA)
    return np.asarray(cv2.GaussianBlur(canvas, (0, 0), max(0.5, 1.2 * scale)) / 255.0, np.float64)


def _plume(rng: np.random.Generator, shape: tuple[int, int]) -> Array:
    """Smooth noise of three octaves over a haze, 0 to 1 with a maximum of 1, shape (height, width)."""
    plume = np.zeros(shape)
    for fineness in (1, 2, 4):
        cells = rng.uniform(0.0, 1.0, (4 * fineness, 4 * fineness))
        plume += cv2.resize(cells, shape[::-1], interpolation=cv2.INTER_CUBIC) / fineness
    plume = np.clip(plume, 0.0, None)
    return np.asarray(0.35 + 0.65 * plume / plume.max())


EDGE_PX = 1.5  # half of the width in which the round border goes from light to black


def dimmed(image_bgr: Image, border: float, vignette: float) -> Image:
    """Darken an image, shape (h, w, 3), by vignetting and a round border: 0 at the corners, 1 at the sides."""
    if not (border or vignette):
        return image_bgr
    left = light_left(border, vignette, image_bgr.shape[1], image_bgr.shape[0])
    return np.clip(np.rint(image_bgr * left), 0, 255).astype(np.uint8)


@lru_cache(maxsize=4)
def light_left(border: float, vignette: float, width_px: int, height_px: int) -> Array:
    """The share of the light that is left at each pixel, shape (h, w, 1)."""
    column, row = np.arange(width_px) - 0.5 * (width_px - 1), np.arange(height_px) - 0.5 * (height_px - 1)
    radius_px = np.hypot(column[None], row[:, None])
    # Fourth power of the cosine, to first order: the loss grows with the square of the radius.
    left = 1.0 - vignette * (radius_px / radius_px.max()) ** 2
    if border:
        corner_px, side_px = 0.5 * np.hypot(width_px, height_px), 0.5 * width_px
        inside_px = float(corner_px + border * (side_px - corner_px)) - radius_px
        left *= np.clip(0.5 + 0.5 * inside_px / EDGE_PX, 0.0, 1.0)
    return np.asarray(left[..., None])


def subsampled(image_bgr: Image, share: float) -> Image:
    """Keep colour for every 2 x 2 pixels only (4:2:0), or go that share of the way to it."""
    height, width = image_bgr.shape[:2]
    y_cr_cb = cv2.cvtColor(image_bgr, cv2.COLOR_BGR2YCrCb)
    colour = y_cr_cb[..., 1:]
    half = cv2.resize(colour, ((width + 1) // 2, (height + 1) // 2), interpolation=cv2.INTER_AREA)
    whole = cv2.resize(half, (width, height), interpolation=cv2.INTER_LINEAR)
    y_cr_cb[..., 1:] = cv2.addWeighted(whole, share, colour, 1.0 - share, 0.0)
    return np.asarray(cv2.cvtColor(y_cr_cb, cv2.COLOR_YCrCb2BGR), np.uint8)
