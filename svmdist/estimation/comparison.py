"""Comparisons of two independent sources over a log: what contradicts, who is to blame, and what it could be.

What differs by more than `MAX_DEVIATIONS` in two frames of five, and in two, contradicts: one frame alone may be
mistaken. Each kind is a test of its own (Baarda 1968), so that its line says what to look at.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

MAX_DEVIATIONS = 3.5  # 1 normal error in 2,000 is beyond it; of clean logs, none beyond 3.2
MIN_FRAMES, MIN_SHARE = 2, 0.4  # that contradict, of those that compare
MIN_MOTIONS, MOST = 3, 0.55  # of frames, by their usual motion: two of five may be mistaken

KINEMATICS, SHAFT, DISPARITY, TAG = "kinematics", "the shaft's width", "disparity", "the tag"
MARKER = "the marker's size"
TISSUE, VIEWS, FIELD, JAWS = "the profile's tissue", "both views", "[field]", "jaw_length_m"
CAMERAS, PROFILE, LATER = "the stated cameras", "the profile", "later camera_info"
HEIGHT, TILT, SHAPE = "height of the tissue", "tilt of the tissue", "shape of the tissue"
MOTION = "motion of the tool"
ROWS = "rows of both views"
OTHER_SHAPE_DEVIATIONS = 1.0  # of tilt or shape, beyond which a seen surface is better than the profile's
BORDER_M = 0.02  # of an organ, from its middle
MISTAKES = {
    KINEMATICS: (
        "the camera-to-base transform (mm for m, inverse, order of the quaternion, moved since)",
        "the chain (another robot's, modified for standard DH)",
        "joints (order, signs, unit, late)",
    ),
    SHAFT: ("shaft_radius_m (a diameter?)", "the focal length (another zoom?)"),
    DISPARITY: ("the baseline (unit, half, sign)", "exchanged or turned views"),
    MARKER: ("knuckle_radius_m", "the focal length"),
    JAWS: ("jaw_length_m (a whole jaw, or the part behind the marker?)",),
    TAG: ("the tag's size_m", "its link, place or rotation"),
    TISSUE: ("[tissue]: plane, dome or mesh (place, tilt, height, unit, axes)", "focal length or baseline"),
    VIEWS: ("left and right exchanged", "the baseline (unit, sign)"),
    ROWS: ("a lens stated of rectified images", "half of a lens' coefficients", "a turned camera"),
    LATER: ("a zoom while the log was recorded", "camera_info of another mode or camera"),
    FIELD: ("a unit (mm for m)", "a diameter for a radius", "[field], where this robot is another one"),
}
"""The mistakes that look like a contradiction of each source, or of rows, the commonest first."""
ALL_RELY = {KINEMATICS, TISSUE, FIELD, JAWS}  # on joints of the wrist, too, where the base may be anywhere
RELIES = {
    "kinematic": ALL_RELY,
    "fiducial": ALL_RELY | {TAG},
    "shaft": ALL_RELY | {SHAFT, MARKER},
    "stereo": ALL_RELY | {DISPARITY, VIEWS, SHAFT, MARKER},
    "fused": ALL_RELY | {DISPARITY, VIEWS, SHAFT, MARKER, TAG},
}
"""What each method relies on; the planar ones rely on their calibration alone."""


class Difference(NamedTuple):
    """One value by one source less that by another, in one frame or between two, and its standard deviation."""

    what: str
    sources: tuple[str, ...]
    value: float
    std: float
    unit: str  # m, px, rad; empty for a logarithm

    @property
    def deviations(self) -> float:
        """Over its standard deviation, without a sign."""
        return abs(self.value) / self.std if self.std > 0.0 else np.inf if self.value else 0.0


@dataclass(frozen=True, slots=True)
class Comparison:
    """All differences of one kind over a log: the usual one, and whether it contradicts."""

    usual: Difference
    frames: int
    contradicting: int
    contradicts: bool  # whether enough frames are beyond what is uncertain

    @property
    def verdict(self) -> str:
        """`agrees` or `contradicts`."""
        return "contradicts" if self.contradicts else "agrees"

    @property
    def against(self) -> str:
        """The sources, in words."""
        return " against ".join(self.usual.sources)

    @property
    def could_be(self) -> tuple[str, ...]:
        """What mistakes look like this."""
        if self.usual.what in MISTAKES:
            return MISTAKES[self.usual.what]
        known = [MISTAKES[source] for source in self.usual.sources if source in MISTAKES]
        return tuple(one for mistakes in known for one in mistakes[: 4 // len(known)])

    def __str__(self) -> str:
        """A human-readable sentence."""
        found = self.usual
        return (
            f"{found.what}, {self.against}: contradiction of {readable(found)}, {found.deviations:.0f} standard"
            f" deviations, in {self.contradicting} of {self.frames} frames"
        )


@dataclass(frozen=True)
class Checks:
    """All comparisons of one instrument in a log."""

    comparisons: tuple[Comparison, ...]

    @classmethod
    def of(cls, differences: Iterable[Difference], frames: int) -> Checks:
        """Put the differences of some frames together by their kind, in the order in which they first came."""
        kinds: dict[tuple[str, tuple[str, ...]], list[Difference]] = {}
        for one in differences:
            if one.std < np.inf:  # one of an infinite deviation compares nothing
                kinds.setdefault((one.what, one.sources), []).append(one)
        return cls(tuple(_compared(ones, frames) for ones in kinds.values()))

    @property
    def contradictions(self) -> tuple[Comparison, ...]:
        """Those that contradict, the worst first."""
        found = [one for one in self.comparisons if one.contradicts]
        return tuple(sorted(found, key=lambda one: -one.usual.deviations))

    @property
    def blamed(self) -> set[str]:
        """The sources that may be wrong: of those that contradict the one that fewest others agree with, or all."""
        blamed: set[str] = set()
        for wrong in self.contradictions:
            bound = abs(wrong.usual.value) / MAX_DEVIATIONS  # an agreement counts that would have shown this
            consistent = [one.usual for one in self.comparisons if not one.contradicts]
            sharp = [one.sources for one in consistent if one.what == wrong.usual.what and one.std < bound]
            votes = {source: sum(source in sources for sources in sharp) for source in wrong.usual.sources}
            blamed |= {source for source, count in votes.items() if count == min(votes.values())}
        return blamed

    @property
    def bends_rows(self) -> bool:
        """Whether rows of both views bend more than the calibration allows."""
        return any(one.usual.what == ROWS for one in self.contradictions)

    def contradiction(self, method: str) -> str:
        """Why no row of a method can be trusted; empty where none of what it relies on is contradicted."""
        wrong = RELIES.get(method, set()) & self.blamed
        return next((str(one) for one in self.contradictions if wrong & set(one.usual.sources)), "")

    @property
    def tissue_off_m(self) -> float | None:
        """By how much both views show the tissue elsewhere than the profile has it; None where they do not show it."""
        found = self._usual(HEIGHT)
        return None if found is None else abs(found.value)

    @property
    def tissue_shape_off_m(self) -> float:
        """By how much its shape is another one at its border, tilt and all; 0 where it is the profile's."""
        tilt, shape = self._usual(TILT), self._usual(SHAPE)
        if tilt is None or shape is None or max(tilt.deviations, shape.deviations) < OTHER_SHAPE_DEVIATIONS:
            return 0.0
        return float(np.hypot(tilt.value * BORDER_M, 2.0 * shape.value))

    def _usual(self, what: str) -> Difference | None:
        return next((one.usual for one in self.comparisons if one.usual.what == what), None)


def _compared(ones: Sequence[Difference], frames: int) -> Comparison:
    beyond = [one for one in ones if one.deviations > MAX_DEVIATIONS]
    least, share = min(MIN_FRAMES, frames), MIN_SHARE  # of those that compare, to contradict
    if ones[0].what == MOTION:
        least, share = MIN_MOTIONS, MOST
    elif JAWS in ones[0].sources:  # a hole in a mask behind them may be anything dark
        share = MOST
    elif ones[0].sources[0] in (PROFILE, VIEWS, CAMERAS):  # of a profile, or of many points
        least = 1
    contradicts = len(beyond) >= max(least, share * len(ones))
    shown = sorted(beyond if contradicts else ones, key=lambda one: one.deviations)
    return Comparison(shown[len(shown) // 2], len(ones), len(beyond), contradicts)


def readable(found: Difference) -> str:
    """The difference with its unit."""
    if not np.isfinite(found.value):
        return "all"
    scale, unit = {"m": (1e3, "mm"), "rad": (180.0 / np.pi, "°"), "px": (1.0, "px")}.get(found.unit, (100.0, "%"))
    return f"{scale * found.value:.3g}{'' if unit in '°%' else ' '}{unit}"
