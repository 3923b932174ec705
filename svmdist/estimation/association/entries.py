"""Which seen instrument is which where no joints tell: by the side it comes in from, and by where it was before.

A trocar holds its instrument: where that enters the picture moves slowly, whatever the tip does. Instruments that were
never seen are expected on their sides. What may as well be another one's is named with a doubt, which stays with the
row, and teaches the tracks nothing.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from svmdist.estimation.association.tracker import assignments
from svmdist.profile import EntrySide
from svmdist.profile.settings import AssociationSettings
from svmdist.transforms import Array
from svmdist.vision.instruments.seen import SeenInstrument

DEFAULT = AssociationSettings()
SIDES: dict[EntrySide, tuple[float, float]] = {
    "left": (0.0, 0.5),
    "right": (1.0, 0.5),
    "above": (0.5, 0.0),
    "below": (0.5, 1.0),
}
"""The middle of each side of a picture, over its size."""


@dataclass(frozen=True, slots=True)
class NamedInstrument:
    """Which of an image's seen instruments an instrument is, None where it is not seen, and why that is in doubt."""

    seen: int | None
    doubt: str = ""


@dataclass
class _Track:
    """Where an instrument came in and ended when it was last seen for sure, over the image's size; None before."""

    side: Array | None
    entry: Array | None = None
    end: Array | None = None
    stamp_ns: int = 0


class EntryTracker:
    """Names the seen instruments of one camera's images, in the order of their stamps."""

    def __init__(
        self,
        names: Sequence[str],
        sides: Sequence[EntrySide | None],
        size: tuple[int, int],
        settings: AssociationSettings = DEFAULT,
    ) -> None:
        self._names = tuple(names)
        self._size = np.array([size[1], size[0]], np.float64)
        self._settings = settings
        self._tracks = [_Track(place) for place in expected_places(sides)]

    def update(self, stamp_ns: int, seen: Sequence[SeenInstrument]) -> tuple[NamedInstrument, ...]:
        """Name the seen instruments of the next image; an entry for each name."""
        seen = seen[: self._settings.max_regions]
        entries = np.array([one.entry_px / self._size for one in seen]).reshape(-1, 2)
        ends = np.array([one.end_px / self._size for one in seen]).reshape(-1, 2)
        cost = np.array(
            [
                [self._cost(track, stamp_ns, *place) for place in zip(entries, ends, strict=True)]
                for track in self._tracks
            ]
        ).reshape(len(self._tracks), len(seen))
        # What is surer an instrument is the likelier one where one name has a choice.
        cost = cost - np.log(np.array([max(one.evidence, 1e-3) for one in seen]).reshape(1, -1))
        hypotheses = sorted(
            ((self._total(hypothesis, cost), hypothesis) for hypothesis in assignments(*cost.shape)),
            key=lambda item: (item[0], [-1 if at is None else at for at in item[1]]),
        )
        best_cost, best = hypotheses[0]
        named = []
        for place, at in enumerate(best):
            doubt = "" if at is None else self._doubt(place, at, best_cost, hypotheses)
            named.append(NamedInstrument(at, doubt))
            if at is not None and not doubt:
                track = self._tracks[place]
                track.entry, track.end, track.stamp_ns = entries[at], ends[at], stamp_ns
        return tuple(named)

    def _cost(self, track: _Track, stamp_ns: int, entry: Array, end: Array) -> float:
        """-log likelihood of a seen instrument under a track, up to a constant that all tracks share."""
        settings = self._settings
        if track.entry is None or track.end is None:
            if track.side is None:
                return 2.0 * math.log(settings.side_std)
            off = entry - track.side
            return 0.5 * float(off @ off) / settings.side_std**2 + 2.0 * math.log(settings.side_std)
        passed_s = max(0.0, (stamp_ns - track.stamp_ns) / 1e9)
        entry_std = min(settings.entry_std + settings.entry_speed * passed_s, settings.side_std)
        end_std = min(settings.end_std + settings.end_speed * passed_s, settings.side_std)
        from_entry, from_end = entry - track.entry, end - track.end
        of_entry = 0.5 * float(from_entry @ from_entry) / entry_std**2 + 2.0 * math.log(entry_std)
        # Ends say nothing more once they may be anywhere.
        of_end = 0.5 * float(from_end @ from_end) / end_std**2 + 2.0 * math.log(end_std / settings.side_std)
        return of_entry + of_end

    def _total(self, hypothesis: Sequence[int | None], cost: Array) -> float:
        """-log likelihood of naming all at once: each one that goes unnamed, or unseen, costs."""
        unnamed = cost.shape[1] - sum(at is not None for at in hypothesis)
        total: float = self._settings.unnamed_cost * unnamed
        for place, at in enumerate(hypothesis):
            total += self._settings.unseen_cost if at is None else float(cost[place, at])
        return float(total)

    def _doubt(
        self,
        place: int,
        at: int,
        best_cost: float,
        hypotheses: Sequence[tuple[float, tuple[int | None, ...]]],
    ) -> str:
        """Why a name is in doubt: another naming of this instrument, or of this name, is nearly as likely."""
        for cost, other in hypotheses[1:]:
            if cost - best_cost > self._settings.contest:
                return ""
            if other[place] == at:
                continue
            names = [self._names[rival] for rival, taken in enumerate(other) if taken == at]
            if names:
                return f"cannot tell whether this is {self._names[place]} or {names[0]}"
            if other[place] is not None:
                return f"cannot tell which of the instruments seen is {self._names[place]}"
        return ""


def expected_places(sides: Sequence[EntrySide | None]) -> list[Array | None]:
    """Where instruments are expected to come in, shape (2,) each over the picture's size.

    Without sides several are expected from left to right in their order, and one may come from anywhere.
    """
    count = len(sides)
    places: list[Array | None] = []
    for at, side in enumerate(sides):
        if side is not None:
            places.append(np.array(SIDES[side]))
        elif count > 1:
            angle = np.pi * (1.0 - at / (count - 1))
            places.append(np.array([0.5 + 0.5 * np.cos(angle), 0.5 - 0.5 * np.sin(angle)]))
        else:
            places.append(None)
    return places
