"""Whether what is measured agrees with what is predicted: chi-square bounds, and innovations of the last seconds."""

from __future__ import annotations

import math
from collections import Counter, deque
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from statistics import NormalDist

import numpy as np

from svmdist.profile.settings import FilterSettings
from svmdist.results import FrameResult
from svmdist.transforms import Array

WINDOW_S = 1.5  # of averaged innovations: a hundred degrees of freedom at 10 Hz
MIN_DEGREES = 8  # with fewer degrees of freedom in that window it is not tested
MAX_OUTLIER_SHARE = 0.3  # of them: more contradicts the prediction
NU = 4.0  # degrees of freedom of Student's t: one measurement in a hundred is an outlier
OUTLIER_WEIGHT = 0.2  # below, a measurement is an outlier; it keeps its weight
MAX_SCENE_OUTLIERS = 4  # frames in a row in which the tissue contradicts its plane, after some inlier
USUAL_SHARE = 0.75  # of worlds: there calibration parameters are no further off; beyond, deviations grow
MAX_TIME_OFFSET_DEVIATIONS = 5.0  # beyond, the offset leaves the joints that travel with an image

GATE_Z = FilterSettings().gate_z


@dataclass(frozen=True, slots=True)
class GatingResult:
    """A measurement against its prediction: normalised innovation squared, degrees of freedom, its robust weight."""

    name: str
    nis: float
    degrees_of_freedom: int
    weight: float
    source: str = ""  # the detection that it is made of

    @property
    def is_accepted(self) -> bool:
        """Whether it counts as an inlier; an outlier keeps its weight."""
        return self.weight > OUTLIER_WEIGHT


def with_detections(result: FrameResult, gating: Sequence[GatingResult]) -> FrameResult:
    """The result with its detections: those of inliers mostly are accepted, those of outliers mostly are refused."""
    balance = Counter[str]()
    for one in gating:
        balance[one.source] += 1 if one.is_accepted else -1
    accepted = tuple(name for name, more in balance.items() if more >= 0)
    return replace(result, accepted=accepted, refused=tuple(name for name in balance if name not in accepted))


def student_weight(square: Array | float, degrees_of_freedom: Array | int) -> Array:
    """Student's weight of normalised squares, no more than one (Lange, Little and Taylor 1989)."""
    return np.minimum(1.0, (NU + degrees_of_freedom) / (NU + np.asarray(square)))


@lru_cache(maxsize=256)
def chi_square_bound(degrees_of_freedom: int, z: float = GATE_Z) -> float:
    """Quantile of the chi-square distribution at the normal quantile z (Wilson and Hilferty 1931)."""
    c = 2.0 / (9.0 * degrees_of_freedom)
    return degrees_of_freedom * (1.0 - c + z * math.sqrt(c)) ** 3


@lru_cache(maxsize=256)
def usual_furthest(count: int) -> float:
    """By how many deviations the furthest of so many normal numbers is off at most, in `USUAL_SHARE` of all cases."""
    return NormalDist().inv_cdf(0.5 * (1.0 + USUAL_SHARE ** (1.0 / count)))


class Consistency:
    """Innovations of the last seconds against what is expected of them, and the calibration parameters' estimates."""

    def __init__(self, settings: FilterSettings) -> None:
        self._settings = settings
        self.clear()

    def clear(self) -> None:
        """Begin anew."""
        self._frames: deque[tuple[int, Sequence[GatingResult]]] = deque()
        self._furthest, self._furthest_name, self._surprise = 0.0, "", 0.0
        self._late_s = self._late_deviations = 0.0
        self._scene_outliers, self._scene_has_inliers = 0, False
        self.excess = 1.0  # factor on the covariance for what else is known of this frame

    def add(self, stamp_ns: int, results: Sequence[GatingResult], *, of_tool: bool = True) -> None:
        """Take up a frame's results, of the tool or of the tissue; a frame without any changes nothing."""
        while self._frames and self._frames[0][0] < stamp_ns - round(1e9 * WINDOW_S):
            self._frames.popleft()
        if not results:
            return
        self._frames.append((stamp_ns, results))
        if not of_tool:
            is_inlier = any(result.is_accepted for result in results)
            self._scene_outliers = 0 if is_inlier else self._scene_outliers + 1
            self._scene_has_inliers |= is_inlier

    def watch(self, parameter: tuple[str, float, float, int], late_s: float, late_std_s: float) -> None:
        """Take up the estimates of calibration parameters (`ErrorState.furthest_parameter`) and of the time offset."""
        self._furthest_name, self._furthest, jointly, count = parameter
        self._surprise = jointly / usual_furthest(max(count, 1))
        self._late_s, self._late_deviations = late_s, abs(late_s) / late_std_s if late_std_s > 0.0 else 0.0

    def _results(self) -> list[GatingResult]:
        return [result for _, members in self._frames for result in members]

    @property
    def ratio(self) -> float | None:
        """Innovations squared over what is expected of them, by their robust weights; None before any."""
        results = self._results()
        expected = sum(result.weight * result.degrees_of_freedom for result in results)
        return sum(result.weight * result.nis for result in results) / expected if expected else None

    @property
    def widening(self) -> float:
        """Factor on covariances, where innovations are larger than expected (Birge 1932, of all measurements)."""
        return max(1.0, self.ratio or 1.0, self._surprise**2, self.excess)

    @property
    def contradiction(self) -> str:
        """Why no distance can be trusted, human-readable; empty where one can."""
        settings, results = self._settings, self._results()
        if self._furthest > settings.max_constant_deviations:
            return f"{self._furthest_name} is {self._furthest:.1f} standard deviations from the profile's value"
        if self._late_deviations > MAX_TIME_OFFSET_DEVIATIONS:
            late = f"{self._late_s:+.2f} s late, {self._late_deviations:.0f} standard deviations"
            return f"joints seem {late}: is there a lag of the images to be given?"
        accepted: dict[str, list[bool]] = {}
        for result in results:
            accepted.setdefault(result.name, []).append(result.is_accepted)
        names = [name for name, ones in accepted.items() if not ones[-1] or 2 * sum(ones) < len(ones)]
        outliers = ", ".join(names) or "measurements"
        # Without an inlier before, one frame is enough.
        if self._scene_outliers >= (MAX_SCENE_OUTLIERS if self._scene_has_inliers else 1):
            return f"the tissue contradicts its plane in {self._scene_outliers} frames: {outliers}"
        degrees = sum(result.degrees_of_freedom for result in results)
        if degrees < MIN_DEGREES:
            return ""
        share = sum(result.degrees_of_freedom for result in results if not result.is_accepted) / degrees
        if share > MAX_OUTLIER_SHARE:
            return f"{share:.0%} of what was measured contradicts the prediction: {outliers}"
        is_off = (self.ratio or 0.0) > settings.max_consistency
        return f"innovations are {self.ratio:.1f} times what is expected of them" if is_off else ""
