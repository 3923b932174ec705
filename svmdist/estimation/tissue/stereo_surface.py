"""The tissue's surface from both cameras, as a cloud, and a dome's apex and height from that."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.estimation.tissue.dome import DomeModel
from svmdist.samples import Image, Observation, RightView
from svmdist.transforms import Array
from svmdist.vision.rectified import FAR_M, NEAR_M, RectifiedPair
from svmdist.vision.stereo import DEGREE, DisparitySurface, fit_surface

SURFACE_STD_PX, CLEAN_MISMATCH_PX = 0.12, 0.36
"""What an aligned low-order surface leaves: measured 0.36 mm at 105 mm and a baseline of 5 mm, where the images differ
by no more than noise of 2 levels makes them. Blocks of JPEG and noise in the dark shift pixels more, and the surface
with them, in proportion."""
GRID_STEP_PX = 5
INNER_GAUGE = 0.9
"""Beyond it the rim is too steep for a surface of low order."""
MIN_POINTS = 100
FREEDOM = (DEGREE + 1) * (DEGREE + 2) / 2
"""Coefficients of the disparity surface: so many of its points err independently, and no more."""
SMOOTH = 0.4
"""Part of a point's deviation that is as smooth as a dome's apex and height: the surface errs most in its highest
coefficients, at the rim. Measured over seven organs: fitted without a prior, shapes stand 0.11 mm off the real ones."""
FIT_STEPS = 8
MAX_SPREAD = 3.0
"""Points that scatter about the dome by so many of their deviations are no view of it."""


@dataclass(frozen=True, slots=True)
class StereoSurface:
    """Points of the surface in the camera frame, shape (n, 3), and the standard deviation of their depth."""

    points_m: Array
    std_m: float


def see_surface(
    observation: Observation,
    right: RightView,
    pair: RectifiedPair,
    hull: NDArray[np.int32],
    masks: tuple[Image, Image],
) -> StereoSurface | None:
    """The tissue's surface inside its hull in the left image, under the instrument too; None if the views disagree.

    `masks` are the tissue's in both images.
    """
    far_px, near_px = (pair.disparity_at(depth_m) + pair.offset_px for depth_m in (FAR_M, NEAR_M))
    bounds = (int(np.floor(far_px)), int(np.ceil(near_px)))
    surface = fit_surface(_grey(observation.image_bgr), _grey(right.image_bgr), *masks, *bounds)
    if surface is None:
        return None
    points_m = _cloud(surface, hull, pair, masks[0].shape)
    depth_m = float(np.median(points_m[:, 2]))
    std_px = SURFACE_STD_PX * max(1.0, surface.mismatch_px / CLEAN_MISMATCH_PX)
    return StereoSurface(points_m, depth_m / pair.disparity_at(depth_m) * std_px)


def fit_dome(dome: DomeModel, surface: StereoSurface) -> DomeModel | None:
    """The dome with apex and height as the surface shows them; None where it shows something else.

    The most probable shape given the dome's own and the points' heights (Gauss–Newton, Cauchy's weights). The
    points' errors are those of few coefficients: they count as `FREEDOM` independent heights, however many they are,
    of which the `SMOOTH` part looks like another shape.
    """
    points_m = dome.to_tissue_frame(surface.points_m)
    inner = dome.normalised_radius(points_m[:, :2], np.zeros(2)) < INNER_GAUGE
    flat_m, height_m = points_m[inner, :2], points_m[inner, 2]
    if len(flat_m) < MIN_POINTS or not np.all(np.diag(dome.covariance) > 0.0):
        return None
    prior = np.linalg.inv(dome.covariance)
    shape_m, std_m = dome.shape_m, surface.std_m
    for _ in range(FIT_STEPS):
        now = dome.shaped(shape_m, dome.covariance)
        error_m = height_m - now.height_m(flat_m)
        std_m = max(surface.std_m, 1.4826 * float(np.median(np.abs(error_m - np.median(error_m)))))
        J = now.derivative(flat_m)
        weight = FREEDOM / len(flat_m) / (SMOOTH * std_m) ** 2 / (1.0 + (error_m / (2.0 * std_m)) ** 2)
        weighted = J * weight[:, None]
        information = prior + weighted.T @ J
        step = np.linalg.solve(information, weighted.T @ error_m + prior @ (dome.shape_m - shape_m))
        shape_m = shape_m + step
        if np.abs(step).max() < 1e-6:
            break
    if std_m > MAX_SPREAD * surface.std_m or not shape_m[2] > 0.0:
        return None
    return dome.shaped(shape_m, np.asarray(np.linalg.inv(information)))


def _cloud(
    surface: DisparitySurface, hull: NDArray[np.int32], pair: RectifiedPair, shape: tuple[int, ...]
) -> Array:
    inside = np.zeros(shape[:2], np.uint8)
    cv2.fillConvexPoly(inside, np.asarray(hull, np.int32), 255)
    rows, columns = np.nonzero(inside[::GRID_STEP_PX, ::GRID_STEP_PX])
    points_px = np.stack([columns, rows], -1).astype(np.float64) * GRID_STEP_PX
    disparity_px = surface.at(points_px) - pair.offset_px
    return pair.points(points_px, np.maximum(disparity_px, pair.disparity_at(FAR_M)))


def _grey(image_bgr: Image) -> Image:
    return np.asarray(cv2.cvtColor(image_bgr, cv2.COLOR_BGR2GRAY), np.uint8)
