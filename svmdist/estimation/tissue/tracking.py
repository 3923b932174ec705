"""The tissue on the profile's plane over time: it creeps at most, so that frames that hide it still have a pose."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from svmdist.estimation.gate import chi_square_bound
from svmdist.estimation.tissue.dome import SHAPE_SIZE, DomeModel
from svmdist.estimation.tissue.pose import TissuePose
from svmdist.profile.settings import TissueTrackingSettings
from svmdist.transforms import Array

DEFAULT = TissueTrackingSettings()
TINY_M2 = 1e-14
"""Added to covariances of poses that lie on one plane, so that they have an inverse."""


@dataclass
class CorrelatedMean:
    """A weighted mean of measurements, shape (n,), that err alike, with so many degrees of freedom each.

    Its covariance is the mean's of one measurement (the harmonic mean of all), never smaller for their number. Where
    they scatter more than they say of themselves, as under blur and noise, it grows by as much (Birge 1932).
    """

    degrees_of_freedom: int
    settings: TissueTrackingSettings = DEFAULT
    count: float = 0.0
    _information: Array | None = None
    _weighted: Array | None = None
    _squares: float = 0.0

    def add(self, value: Array, covariance: Array) -> None:
        """Take up a measurement; earlier ones fade."""
        size = len(value)
        weight = np.asarray(np.linalg.inv(covariance + TINY_M2 * np.eye(size)), np.float64)
        if self._information is None or self._weighted is None:
            self._information, self._weighted = np.zeros((size, size)), np.zeros(size)
        fade = 1.0 - 1.0 / self.settings.memory_count
        self._information = fade * self._information + weight
        self._weighted = fade * self._weighted + weight @ value
        self._squares = fade * self._squares + float(value @ weight @ value)
        self.count = fade * self.count + 1.0

    def now(self) -> tuple[Array, Array] | None:
        """Mean and covariance; None before the first measurement."""
        if self._information is None or self._weighted is None:
            return None
        spread = np.linalg.inv(self._information)
        mean = np.asarray(spread @ self._weighted, np.float64)
        excess = 1.0
        if self.count >= self.settings.min_scatter_count:
            scatter = self._squares - float(self._weighted @ mean)
            excess = max(1.0, scatter / (self.degrees_of_freedom * (self.count - 1.0)))
        return mean, np.asarray(excess * self.count * spread, np.float64)


class TissueTracker:
    """The tissue's pose, which a wild detection does not enter, and its dome's shape, where frames show it."""

    def __init__(self, settings: TissueTrackingSettings = DEFAULT) -> None:
        self._settings = settings
        self._outlier_count = 0
        self._frame_count = 0
        self._best: TissuePose | None = None
        # A pose has two degrees of freedom of its own, on the plane; a dome has five of shape.
        self._place = CorrelatedMean(2, settings)
        self._shape = CorrelatedMean(SHAPE_SIZE, settings)

    @property
    def wants_shape(self) -> bool:
        """Whether another view of the dome's shape is worth its time."""
        every = self._settings.shape_count
        return self._frame_count < every or self._frame_count % every == 0

    def add_shape(self, dome: DomeModel) -> None:
        """Take up a dome as stereo shows it."""
        self._shape.add(dome.shape, dome.covariance)

    def add(self, pose: TissuePose | None) -> TissuePose | None:
        """Take up a frame's pose, if it has one; gives the tissue as known then."""
        if pose is None:
            return self.now()
        if not self._agrees(pose):
            self._outlier_count += 1
            if self._outlier_count < self._settings.moved_count:
                return self.now()
            self._best, self._frame_count = None, 0
            self._place, self._shape = (
                CorrelatedMean(2, self._settings),
                CorrelatedMean(SHAPE_SIZE, self._settings),
            )
        self._outlier_count = 0
        self._frame_count += 1
        self._place.add(pose.position_m, pose.own_covariance)
        if self._best is None or np.trace(pose.own_covariance) <= np.trace(self._best.own_covariance):
            self._best = pose
        return self.now()

    def now(self) -> TissuePose | None:
        """The tissue as it is known; None before the first pose."""
        place = self._place.now()
        if self._best is None or place is None:
            return None
        # Outlines differ from frame to frame and are averaged; the plane is as uncertain in all of them.
        position_m, of_outline = place
        covariance = of_outline + self._best.covariance - self._best.own_covariance
        known = replace(
            self._best, position_m=position_m, covariance=covariance, outline_covariance=of_outline
        )
        shape = self._shape.now()
        return known if shape is None or known.dome is None else known.with_dome(known.dome.shaped(*shape))

    def _agrees(self, pose: TissuePose) -> bool:
        place = self._place.now()
        if place is None:
            return True
        position_m, covariance = place
        offset_m = pose.position_m - position_m
        nis = offset_m @ np.linalg.solve(pose.own_covariance + covariance + TINY_M2 * np.eye(3), offset_m)
        return bool(nis <= chi_square_bound(3, self._settings.gate_z))
