"""A dome's shape from a stereo surface."""

from __future__ import annotations

import numpy as np

from svmdist.estimation.detection.stereo_surface import StereoSurface
from svmdist.estimation.tissue.dome import SHAPE_SIZE, DomeModel
from svmdist.least_squares import median, scale_of
from svmdist.profile.settings import StereoSettings
from svmdist.vision.stereo import DEGREE

DEFAULT = StereoSettings()
MIN_POINTS = 100
FREEDOM = (DEGREE + 1) * (DEGREE + 2) / 2
"""Coefficients of the disparity surface: so many of its points err independently, and no more."""
FIT_STEPS = 8
STEP_SETTLED = np.array([1e-6, 1e-6, 1e-6, 1e-4, 1e-4])
"""A step below it moves no point of the dome by more than a micrometre."""


def fit_dome(dome: DomeModel, surface: StereoSurface, settings: StereoSettings = DEFAULT) -> DomeModel | None:
    """The dome with apex, height and exponents as the surface shows them; None where it shows something else.

    The most probable shape given the dome's own and the points' heights (Gauss–Newton, Cauchy's weights). The
    points' errors are those of few coefficients: they count as `FREEDOM` independent heights, however many they are,
    of which the smooth part looks like another shape. What has no deviation stays as it is.
    """
    points_m = dome.to_tissue_frame(surface.points_m)
    inner = dome.normalised_radius(points_m[:, :2], np.zeros(2)) < settings.inner_radius
    flat_m, height_m = points_m[inner, :2], points_m[inner, 2]
    free = np.flatnonzero(np.diag(dome.covariance) > 0.0)
    if len(flat_m) < MIN_POINTS or len(free) == 0:
        return None
    at = np.ix_(free, free)
    prior = np.linalg.inv(dome.covariance[at])
    now, std_m = dome, surface.std_m
    for _ in range(FIT_STEPS):
        error_m = height_m - now.height_m(flat_m)
        std_m = max(surface.std_m, scale_of(error_m - median(error_m)))
        J = now.derivative(flat_m)[:, free]
        weight = (
            FREEDOM
            / len(flat_m)
            / (settings.smooth_fraction * std_m) ** 2
            / (1.0 + (error_m / (2.0 * std_m)) ** 2)
        )
        weighted = J * weight[:, None]
        information = prior + weighted.T @ J
        step = np.zeros(SHAPE_SIZE)
        step[free] = np.linalg.solve(
            information, weighted.T @ error_m + prior @ (dome.shape - now.shape)[free]
        )
        now = now.shaped(now.shape + step, dome.covariance)
        if np.abs(step / STEP_SETTLED).max() < 1.0:
            break
    if std_m > settings.max_spread * surface.std_m or not now.shape[2] > 0.0:
        return None
    covariance = np.zeros_like(dome.covariance)
    covariance[at] = np.linalg.inv(information)
    return now.shaped(now.shape, covariance)
