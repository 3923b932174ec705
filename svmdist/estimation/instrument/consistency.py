"""The gate for residuals: what a normal distribution lets pass, and what became of a measurement there."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import lru_cache

from svmdist.profile.settings import FilterSettings

# Frames after which a young filter solves anew: linearisation is cm off at first
WINDOW_SOLVES = (1, 2, 3, 5, 8, 12, 20)
CONSISTENCY_WINDOW_S = 1.5  # of averaged innovations: a hundred degrees of freedom at 10 Hz
CONSISTENCY_MIN_DEGREES = 8  # fewer degrees of freedom in that window tell nothing of consistency
MAX_REFUSED_FRAMES = 4  # in a row, all refused: what hides an instrument misleads two or three
MAX_REFUSED_SHARE = 0.5  # of degrees of freedom: more than half contradicts the prediction
MAX_YOUNG_REFUSED_SHARE = 0.2  # in the first frames, by which later ones are judged
USUAL_CONSTANT_DEVIATIONS = 2.5  # one constant of twenty is, one time in four; beyond, deviations grow
MAX_TIME_OFFSET_DEVIATIONS = 5.0  # beyond, the offset leaves the joints that travel with an image
PROBATION_S = 3.0  # after a restart: what the profile has wrong contradicts again by then

GATE_Z = FilterSettings().gate_z


@dataclass(frozen=True, slots=True)
class GatingResult:
    """A measurement at the gate, with the detection it is of where that has another name."""

    name: str
    nis: float
    degrees_of_freedom: int
    is_accepted: bool
    source: str = ""


@lru_cache(maxsize=256)
def chi_square_bound(degrees_of_freedom: int, z: float = GATE_Z) -> float:
    """Quantile of the chi-square distribution at the normal quantile z (Wilson and Hilferty 1931)."""
    c = 2.0 / (9.0 * degrees_of_freedom)
    return degrees_of_freedom * (1.0 - c + z * math.sqrt(c)) ** 3


CODED = "tag"  # the source that nothing else can be mistaken for


@dataclass(slots=True)
class Tally:
    """What one source measured: degrees of freedom of all and of accepted results, and the squares of the latter."""

    degrees: int = 0
    accepted: int = 0
    square: float = 0.0

    @property
    def refused(self) -> int:
        """Degrees of freedom that did not pass the gate."""
        return self.degrees - self.accepted

    def add(self, result: GatingResult) -> None:
        """Count a result."""
        self.degrees += result.degrees_of_freedom
        if result.is_accepted:
            self.accepted += result.degrees_of_freedom
            self.square += result.nis


class Consistency:
    """Watches the gating results of the last frames."""

    def __init__(self, settings: FilterSettings) -> None:
        self._settings = settings
        self._untrusted_since_ns: int | None = None
        self._now_ns = 0
        self._tool_sources: set[str] = set()
        self.clear()

    def clear(self) -> None:
        """Begin anew; what is distrusted stays so."""
        self._frames: deque[tuple[int, tuple[GatingResult, ...]]] = deque()
        self._tallies: dict[str, Tally] = {}
        self._is_refused: dict[str, bool] = {}
        self._frame_count = self._refused_frames = 0
        self._scene_refused_frames, self._scene_agreed = 0, False
        self._furthest, self._furthest_name = 0.0, ""
        self._late_s = self._late_deviations = 0.0

    def add(self, stamp_ns: int, results: Sequence[GatingResult], *, of_tool: bool = True) -> None:
        """Take up a frame's results, of the tool or of something else; a frame without any tells nothing."""
        self._now_ns = stamp_ns
        horizon_ns = stamp_ns - round(1e9 * CONSISTENCY_WINDOW_S)
        while self._frames and self._frames[0][0] < horizon_ns:
            self._frames.popleft()
        if results:
            self._frames.append((stamp_ns, tuple(results)))
            is_refused = not any(result.is_accepted for result in results)
            if of_tool:
                self._frame_count += 1
                self._tool_sources.update(result.source or result.name for result in results)
                self._refused_frames = self._refused_frames + 1 if is_refused else 0
            else:
                self._scene_refused_frames = self._scene_refused_frames + 1 if is_refused else 0
                self._scene_agreed |= not is_refused
            for result in results:
                self._is_refused[result.name] = not result.is_accepted
        self._tallies = _tallies(result for _, members in self._frames for result in members)

    def watch_constants(self, found: Iterable[tuple[str, float]]) -> None:
        """Take up how far constants were found from what is stated of them, in stated deviations, by name."""
        offs = ((abs(off), name) for name, off in found)
        self._furthest, self._furthest_name = max(offs, key=lambda one: one[0], default=(0.0, ""))

    def watch_time_offset(self, late_s: float, std_s: float) -> None:
        """Take up how late joints were found to be, and how late they may be by what is stated, in s."""
        self._late_s = late_s
        self._late_deviations = abs(late_s) / std_s if std_s > 0.0 else 0.0

    def distrust(self, since_ns: int) -> None:
        """After a contradiction nothing is trusted before it has agreed for a while."""
        self._untrusted_since_ns = since_ns

    @property
    def ratio(self) -> float | None:
        """Innovations squared of accepted measurements over what is expected of them; None before any."""
        accepted = sum(tally.accepted for tally in self._tallies.values())
        return sum(tally.square for tally in self._tallies.values()) / accepted if accepted else None

    def _young_refused_share(self) -> float:
        """The refused share without the source that is refused most, where enough of the tool's others is accepted.

        One detection may be wrong for seconds: a shadow beside the shaft, a marker that is half hidden. Where two
        contradict the prediction, it is the prediction that is wrong; or where a tag does, whose code says what it is.
        """
        of_tool = {name: tally for name, tally in self._tallies.items() if name in self._tool_sources}
        mistakable = [name for name in of_tool if name != CODED]
        worst = max(mistakable, default="", key=lambda name: of_tool[name].refused)
        others = [tally for name, tally in of_tool.items() if name != worst]
        if sum(tally.accepted for tally in others) < CONSISTENCY_MIN_DEGREES:
            others = list(self._tallies.values())
        return _refused_share(others)

    @property
    def widening(self) -> float:
        """By what variances grow: the ratio where innovations are larger than expected (Birge 1932)."""
        return max(1.0, self.ratio or 1.0, (self._furthest / USUAL_CONSTANT_DEVIATIONS) ** 2)

    @property
    def contradiction(self) -> str:
        """Why no distance can be trusted, for a person; empty where one can."""
        return self._off_what_is_stated() or self._all_refused() or self._disagreement()

    @property
    def doubt(self) -> str:
        """Why no distance is stated: a contradiction, or one before that what was seen since has not yet outlived."""
        since_ns = self._untrusted_since_ns
        if since_ns is not None and self._now_ns < since_ns + round(1e9 * PROBATION_S):
            return self.contradiction or "begun anew after a contradiction"
        return self.contradiction

    def _off_what_is_stated(self) -> str:
        """What was found too far from what is stated of it: a constant, or the clock of the joints."""
        settings = self._settings
        if self._furthest > settings.max_constant_deviations:
            return f"{self._furthest_name} is {self._furthest:.1f} stated deviations from its stated value"
        if self._late_deviations > MAX_TIME_OFFSET_DEVIATIONS:
            return (
                f"joints seem {self._late_s:+.2f} s late, {self._late_deviations:.0f} stated deviations: is there a lag"
                " of the images to be given?"
            )
        return ""

    def _all_refused(self) -> str:
        """What was refused whole, frame after frame: all of the tool, or the tissue."""
        most = MAX_REFUSED_FRAMES
        if self._refused_frames >= most:
            return f"all that was measured in {self._refused_frames} frames contradicts the prediction: {self._worst()}"
        # What never agreed has nothing that speaks for it: one frame is enough.
        if self._scene_refused_frames >= (most if self._scene_agreed else 1):
            return f"the tissue contradicts its plane in {self._scene_refused_frames} frames: {self._worst()}"
        return ""

    def _disagreement(self) -> str:
        """What disagrees with predictions over the window: too much refused, or accepted by far too little."""
        settings = self._settings
        if sum(tally.degrees for tally in self._tallies.values()) < CONSISTENCY_MIN_DEGREES:
            return ""
        share, most = _refused_share(self._tallies.values()), MAX_REFUSED_SHARE
        if self._frame_count <= max(WINDOW_SOLVES) and share <= most:
            # A young filter has no past that outweighs what it refuses: it may have begun with other joints.
            share, most = self._young_refused_share(), MAX_YOUNG_REFUSED_SHARE
        if share > most:
            return f"{share:.0%} of what was measured contradicts the prediction: {self._worst()}"
        if (self.ratio or 0.0) > settings.max_consistency:
            return f"innovations are {self.ratio:.1f} times what is expected of them"
        return ""

    def _worst(self) -> str:
        refused = [name for name, is_refused in self._is_refused.items() if is_refused]
        return ", ".join(refused) or "measurements"


def _tallies(results: Iterable[GatingResult]) -> dict[str, Tally]:
    tallies: dict[str, Tally] = {}
    for result in results:
        tallies.setdefault(result.source or result.name, Tally()).add(result)
    return tallies


def _refused_share(tallies: Iterable[Tally]) -> float:
    members = list(tallies)
    degrees = sum(tally.degrees for tally in members)
    return sum(tally.refused for tally in members) / degrees if degrees else 0.0
