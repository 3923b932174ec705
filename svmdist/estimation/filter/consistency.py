"""Whether what was measured agrees with what was predicted, over the last frames.

Normalised innovations squared follow a chi-square distribution where the model holds (Bar-Shalom, Li, Kirubarajan 2001,
"Estimation with Applications to Tracking and Navigation", sec. 5.4). Where they do not, something differs from the
profile: deviations must grow, and past a bound no distance can be trusted.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from svmdist.estimation.gate import GatingResult
from svmdist.settings.filter import FilterSettings


@dataclass(frozen=True, slots=True)
class Judged:
    """The measurements of one frame: degrees of freedom of all and of accepted ones, and the squares of the latter."""

    stamp_ns: int
    square: float
    degrees_of_freedom: int
    accepted_degrees: int


class Consistency:
    """Watches the gating results of the last frames."""

    def __init__(self, settings: FilterSettings) -> None:
        self._settings = settings
        self._frames: deque[Judged] = deque()
        self._refused: dict[str, int] = {}
        self._furthest, self._furthest_name = 0.0, ""
        self._late_s = self._late_deviations = 0.0
        self._frame_count = 0
        self._untrusted_since_ns: int | None = None
        self._now_ns = 0
        self._refused_frames = 0

    def add(self, stamp_ns: int, results: Sequence[GatingResult], *, of_tool: bool = True) -> None:
        """Take up a frame's results, of the tool or of something else; a frame without any tells nothing."""
        self._now_ns = stamp_ns
        horizon_ns = stamp_ns - round(1e9 * self._settings.consistency_window_s)
        while self._frames and self._frames[0].stamp_ns < horizon_ns:
            self._frames.popleft()
        if not results:
            return
        is_refused = not any(result.is_accepted for result in results)
        if of_tool:
            self._frame_count += 1
            self._refused_frames = self._refused_frames + 1 if is_refused else 0
        for result in results:
            count = self._refused.get(result.name, 0)
            self._refused[result.name] = 0 if result.is_accepted else count + 1
        squares = [result.nis for result in results if result.is_accepted]
        self._frames.append(
            Judged(
                stamp_ns,
                sum(squares),
                sum(result.degrees_of_freedom for result in results),
                sum(result.degrees_of_freedom for result in results if result.is_accepted),
            )
        )

    def watch_constants(self, found: Iterable[tuple[str, float]]) -> None:
        """Take up how far constants were found from what is stated of them, in stated deviations, by name."""
        self._furthest, self._furthest_name = 0.0, ""
        for name, off in found:
            if abs(off) > self._furthest:
                self._furthest, self._furthest_name = abs(off), name

    def watch_time_offset(self, late_s: float, std_s: float) -> None:
        """Take up how late joints were found to be, and how late they may be by what is stated, in s."""
        self._late_s = late_s
        self._late_deviations = abs(late_s) / std_s if std_s > 0.0 else 0.0

    def distrust(self, since_ns: int) -> None:
        """After a contradiction nothing is trusted before it has agreed for a while."""
        self._untrusted_since_ns = since_ns

    def clear(self) -> None:
        """Begin anew; what is distrusted stays so."""
        self._frames.clear()
        self._refused.clear()
        self._refused_frames = 0
        self._furthest, self._furthest_name = 0.0, ""
        self._late_s = self._late_deviations = 0.0
        self._frame_count = 0

    @property
    def ratio(self) -> float | None:
        """Innovations squared over what is expected of them: 1 is as expected; None before anything was measured.

        Of accepted measurements, so that a wild one alone is no contradiction.
        """
        degrees = sum(frame.accepted_degrees for frame in self._frames)
        return sum(frame.square for frame in self._frames) / degrees if degrees else None

    @property
    def refused_share(self) -> float:
        """Share of the measured degrees of freedom that did not pass the gate."""
        degrees = sum(frame.degrees_of_freedom for frame in self._frames)
        accepted = sum(frame.accepted_degrees for frame in self._frames)
        return 1.0 - accepted / degrees if degrees else 0.0

    @property
    def widening(self) -> float:
        """By what variances grow: the ratio where innovations are larger than expected (Birge 1932).

        So do they where a constant is far from what is stated: it may be off as far again, and others with it.
        """
        return max(1.0, self.ratio or 1.0, (self._furthest / self._settings.usual_constant_deviations) ** 2)

    @property
    def contradiction(self) -> str:
        """Why no distance can be trusted, for a person; empty where one can."""
        settings = self._settings
        off = self._off_what_is_stated()
        if off:
            return off
        if self._refused_frames >= settings.max_refused_frames:
            return f"all that was measured in {self._refused_frames} frames contradicts the prediction: {self._worst()}"
        degrees = sum(frame.degrees_of_freedom for frame in self._frames)
        if degrees < settings.consistency_min_degrees:
            return ""
        # A young filter has no past that outweighs what it refuses: it may have begun with other joints.
        is_young = self._frame_count <= max(settings.window_solves)
        if self.refused_share > (
            settings.max_young_refused_share if is_young else settings.max_refused_share
        ):
            return (
                f"{self.refused_share:.0%} of what was measured contradicts the prediction: {self._worst()}"
            )
        if (self.ratio or 0.0) > settings.max_consistency:
            return f"innovations are {self.ratio:.1f} times what is expected of them"
        return ""

    @property
    def doubt(self) -> str:
        """Why no distance is told: a contradiction, or one before that what was seen since has not yet outlived."""
        since_ns = self._untrusted_since_ns
        if since_ns is not None and self._now_ns < since_ns + round(1e9 * self._settings.probation_s):
            return self.contradiction or "begun anew after a contradiction"
        return self.contradiction

    def _off_what_is_stated(self) -> str:
        """What was found too far from what is stated of it: a constant, or the clock of the joints."""
        settings = self._settings
        if self._furthest > settings.max_constant_deviations:
            return f"{self._furthest_name} is {self._furthest:.1f} stated deviations from its stated value"
        if self._late_deviations > settings.max_time_offset_deviations:
            return (
                f"joints seem {self._late_s:+.2f} s late, {self._late_deviations:.0f} stated deviations: is there a lag"
                " of the images to be given?"
            )
        return ""

    def _worst(self) -> str:
        return ", ".join(name for name, count in self._refused.items() if count) or "measurements"
