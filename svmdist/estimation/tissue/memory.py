"""Where the tissue is, over time: it holds still, so that frames that hide it still have one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from svmdist.estimation.gate import chi_square_bound
from svmdist.estimation.tissue.fix import TissueFix
from svmdist.transforms import Array

MOVED_COUNT = 5
"""So many fixes in a row away from the remembered place mean that the tissue has moved."""
MIN_SCATTER_COUNT = 4.0
"""Fewer fixes do not tell how they scatter."""
MEMORY_COUNT = 50.0
"""Fixes beyond as many fade: tissue that creeps is followed."""


@dataclass
class TissueMemory:
    """A weighted mean of the fixes so far, which a wild one does not enter.

    Fixes of one outline err alike, so the mean's covariance is the mean's of one fix (the harmonic mean of
    all), never smaller for their number. Where they scatter more than they say of themselves, as under blur and
    noise, it grows by as much (Birge 1932).
    """

    best: TissueFix | None = None
    _information: Array | None = None
    _weighted: Array | None = None
    _squares: float = 0.0
    _count: float = 0.0
    _strange: int = 0

    def add(self, fix: TissueFix | None) -> TissueFix | None:
        """Take up a frame's fix, if it has one; gives the tissue as it is known then."""
        if fix is None:
            return self.now()
        if not self._agrees(fix):
            self._strange += 1
            if self._strange < MOVED_COUNT:
                return self.now()
            self.best, self._information, self._weighted = None, None, None
            self._squares, self._count = 0.0, 0.0
        self._strange = 0
        weight = np.asarray(np.linalg.inv(fix.covariance + 1e-14 * np.eye(3)), np.float64)
        if self._information is None or self._weighted is None:
            self._information, self._weighted = np.zeros((3, 3)), np.zeros(3)
        fade = 1.0 - 1.0 / MEMORY_COUNT
        self._information = fade * self._information + weight
        self._weighted = fade * self._weighted + weight @ fix.position_m
        self._squares = fade * self._squares + float(fix.position_m @ weight @ fix.position_m)
        self._count = fade * self._count + 1.0
        if self.best is None or np.trace(fix.covariance) <= np.trace(self.best.covariance):
            self.best = fix
        return self.now()

    def now(self) -> TissueFix | None:
        """The tissue as it is known; None before the first fix."""
        if self.best is None or self._information is None or self._weighted is None:
            return None
        spread = np.linalg.inv(self._information)
        position_m = np.asarray(spread @ self._weighted, np.float64)
        scatter = self._squares - float(self._weighted @ position_m)
        # A fix has two dimensions of its own, on the plane; the mean takes one fix's share.
        excess = max(1.0, scatter / (2.0 * (self._count - 1.0))) if self._count >= MIN_SCATTER_COUNT else 1.0
        covariance = np.asarray(excess * self._count * spread, np.float64)
        return replace(self.best, position_m=position_m, covariance=covariance)

    def _agrees(self, fix: TissueFix) -> bool:
        known = self.now()
        if known is None:
            return True
        offset_m = fix.position_m - known.position_m
        nis = offset_m @ np.linalg.solve(fix.covariance + known.covariance, offset_m)
        return bool(nis <= chi_square_bound(3))
