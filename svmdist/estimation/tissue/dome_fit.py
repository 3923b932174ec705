"""A dome's apex and height from a stereo surface."""

from __future__ import annotations

import numpy as np

from svmdist.estimation.detection.stereo_surface import StereoSurface
from svmdist.estimation.tissue.dome import DomeModel
from svmdist.robust import median, scale_of
from svmdist.settings.stereo import StereoSettings
from svmdist.vision.stereo import DEGREE

DEFAULT = StereoSettings()
MIN_POINTS = 100
FREEDOM = (DEGREE + 1) * (DEGREE + 2) / 2
"""Coefficients of the disparity surface: so many of its points err independently, and no more."""
FIT_STEPS = 8


def fit_dome(dome: DomeModel, surface: StereoSurface, settings: StereoSettings = DEFAULT) -> DomeModel | None:
    """The dome with apex and height as the surface shows them; None where it shows something else.

    The most probable shape given the dome's own and the points' heights (Gauss–Newton, Cauchy's weights). The
    points' errors are those of few coefficients: they count as `FREEDOM` independent heights, however many they are,
    of which the smooth part looks like another shape.
    """
    points_m = dome.to_tissue_frame(surface.points_m)
    inner = dome.normalised_radius(points_m[:, :2], np.zeros(2)) < settings.inner_radius
    flat_m, height_m = points_m[inner, :2], points_m[inner, 2]
    if len(flat_m) < MIN_POINTS or not np.all(np.diag(dome.covariance) > 0.0):
        return None
    prior = np.linalg.inv(dome.covariance)
    shape_m, std_m = dome.shape_m, surface.std_m
    for _ in range(FIT_STEPS):
        now = dome.shaped(shape_m, dome.covariance)
        error_m = height_m - now.height_m(flat_m)
        std_m = max(surface.std_m, scale_of(error_m - median(error_m)))
        J = now.derivative(flat_m)
        weight = (
            FREEDOM
            / len(flat_m)
            / (settings.smooth_fraction * std_m) ** 2
            / (1.0 + (error_m / (2.0 * std_m)) ** 2)
        )
        weighted = J * weight[:, None]
        information = prior + weighted.T @ J
        step = np.linalg.solve(information, weighted.T @ error_m + prior @ (dome.shape_m - shape_m))
        shape_m = shape_m + step
        if np.abs(step).max() < 1e-6:
            break
    if std_m > settings.max_spread * surface.std_m or not shape_m[2] > 0.0:
        return None
    return dome.shaped(shape_m, np.asarray(np.linalg.inv(information)))
