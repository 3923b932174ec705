"""What is known of the tissue over time: it holds still, so that frames that hide it still have one."""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from svmdist.estimation.gate import chi_square_bound
from svmdist.estimation.tissue.dome import DomeModel
from svmdist.estimation.tissue.fix import TissuePose
from svmdist.transforms import Array

MOVED_COUNT = 5
"""So many fixes in a row away from the remembered place mean that the tissue has moved."""
MIN_SCATTER_COUNT = 4.0
"""Fewer fixes do not tell how they scatter."""
MEMORY_COUNT = 50.0
"""Fixes beyond as many fade: tissue that creeps is followed."""
SHAPE_COUNT = 8
"""So many views of the shape are taken first, then one in as many frames: all of them err nearly alike."""


@dataclass
class LastingMean:
    """A weighted mean of measurements, shape (n,), that err alike, of which `freedom` dimensions are their own.

    Its covariance is the mean's of one measurement (the harmonic mean of all), never smaller for their number. Where
    they scatter more than they say of themselves, as under blur and noise, it grows by as much (Birge 1932).
    """

    freedom: int
    count: float = 0.0
    _information: Array | None = None
    _weighted: Array | None = None
    _squares: float = 0.0

    def add(self, value: Array, covariance: Array) -> None:
        """Take up a measurement; earlier ones fade."""
        size = len(value)
        weight = np.asarray(np.linalg.inv(covariance + 1e-14 * np.eye(size)), np.float64)
        if self._information is None or self._weighted is None:
            self._information, self._weighted = np.zeros((size, size)), np.zeros(size)
        fade = 1.0 - 1.0 / MEMORY_COUNT
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
        if self.count >= MIN_SCATTER_COUNT:
            scatter = self._squares - float(self._weighted @ mean)
            excess = max(1.0, scatter / (self.freedom * (self.count - 1.0)))
        return mean, np.asarray(excess * self.count * spread, np.float64)


@dataclass
class TissueMemory:
    """The tissue's place, which a wild fix does not enter, and the shape of its dome, where frames show it."""

    best: TissuePose | None = None
    _place: LastingMean = field(default_factory=lambda: LastingMean(2))
    _shape: LastingMean = field(default_factory=lambda: LastingMean(3))
    _strange: int = 0
    _frames: int = 0

    @property
    def wants_shape(self) -> bool:
        """Whether another view of the shape is worth its time."""
        return self._frames < SHAPE_COUNT or self._frames % SHAPE_COUNT == 0

    def add(self, fix: TissuePose | None, dome: DomeModel | None = None) -> TissuePose | None:
        """Take up a frame's fix, if it has one, and its dome as stereo saw it; gives the tissue as it is known then."""
        if fix is None:
            return self.now()
        if not self._agrees(fix):
            self._strange += 1
            if self._strange < MOVED_COUNT:
                return self.now()
            # A fix has two dimensions of its own, on the plane; a dome has apex and height.
            self.best, self._place, self._shape, self._frames = None, LastingMean(2), LastingMean(3), 0
        self._strange = 0
        self._frames += 1
        self._place.add(fix.position_m, fix.covariance)
        if dome is not None:
            self._shape.add(dome.shape_m, dome.covariance)
        if self.best is None or np.trace(fix.covariance) <= np.trace(self.best.covariance):
            self.best = fix
        return self.now()

    def now(self) -> TissuePose | None:
        """The tissue as it is known; None before the first fix."""
        place = self._place.now()
        if self.best is None or place is None:
            return None
        position_m, covariance = place
        known = replace(self.best, position_m=position_m, covariance=covariance)
        shape = self._shape.now()
        return known if shape is None or known.dome is None else known.with_dome(known.dome.shaped(*shape))

    def _agrees(self, fix: TissuePose) -> bool:
        place = self._place.now()
        if place is None:
            return True
        position_m, covariance = place
        offset_m = fix.position_m - position_m
        nis = offset_m @ np.linalg.solve(fix.covariance + covariance, offset_m)
        return bool(nis <= chi_square_bound(3))
