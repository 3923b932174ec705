"""Names without joints: by the side of entry and by continuity; in doubt where two names fit."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
import pytest

from svmdist.estimation.alarms import AlarmRules, AlarmState, AlarmWatch
from svmdist.estimation.association import EntryTracker, expected_places
from svmdist.profile import EntrySide
from svmdist.results import Distance, Distances, FrameResult
from svmdist.samples import Status
from svmdist.transforms import Array
from svmdist.vision.find_instruments import SeenInstrument

SIZE = (480, 640)
SECOND = 10**9
NOTHING = np.zeros((1, 1), np.uint8)


def seen(entry: Sequence[float], end: Sequence[float], evidence: float = 0.5) -> SeenInstrument:
    """An instrument that comes in at one pixel and ends at another."""
    sides = np.array([[entry, end], [entry, end]], np.float64)
    return SeenInstrument(
        NOTHING, NOTHING, NOTHING, sides, np.array(end, float), np.array(end, float), evidence
    )


def tracker(
    names: Sequence[str] = ("A", "B"), sides: Sequence[EntrySide | None] = (None, None)
) -> EntryTracker:
    """A tracker of an image of 640x480."""
    return EntryTracker(names, sides, SIZE)


def test_from_left_to_right_in_the_order_of_the_profile() -> None:
    """Whatever the order in which they are found; one alone is named by its side too."""
    left, right = seen((0, 200), (250, 260)), seen((639, 180), (380, 250))
    assert [one.seen for one in tracker().update(0, [right, left])] == [1, 0]
    assert [one.seen for one in tracker().update(0, [right])] == [None, 0]
    assert [one.seen for one in tracker().update(0, [left])] == [0, None]
    assert [one.seen for one in tracker().update(0, [])] == [None, None]


def test_sides_of_the_profile_win() -> None:
    """The first one may come from the right, or from above."""
    left, right, above = seen((0, 200), (250, 260)), seen((639, 180), (380, 250)), seen((320, 0), (320, 200))
    assert [one.seen for one in tracker(sides=("right", "left")).update(0, [left, right])] == [1, 0]
    assert [one.seen for one in tracker(sides=("above", "left")).update(0, [left, above])] == [1, 0]


def test_tips_that_cross_keep_their_names() -> None:
    """Trocars stay where they are: 200 courses with tips anywhere, noise, misses and any order."""
    for seed in range(200):
        rng = np.random.default_rng(seed)
        watch = tracker()
        places = np.array([[5.0, rng.uniform(100, 400)], [634.0, rng.uniform(100, 400)]])
        phase = rng.uniform(0.0, 6.28, 2)
        for step in range(40):
            shown = [at for at in rng.permutation(2) if rng.random() > 0.2]
            found = []
            for at in shown:
                entry = places[at] + rng.normal(0.0, 6.0, 2)
                end = [320 + 120 * np.sin(0.3 * step + phase[at]), 260 + 60 * np.cos(0.23 * step + phase[at])]
                found.append(seen(entry, end))
            named = watch.update(step * SECOND // 8, found)
            for name, one in enumerate(named):
                assert one.seen is None or one.doubt or shown[one.seen] == name


def test_two_on_the_same_side_after_a_while_are_in_doubt() -> None:
    """Both were gone, and come back where either may be: names are given, with a word."""
    watch = tracker()
    first = [seen((300, 0), (300, 200)), seen((340, 0), (345, 210))]
    watch.update(0, [seen((280, 0), (260, 200)), seen((360, 0), (380, 210))])
    for step in range(1, 4):
        watch.update(step * 20 * SECOND, [])
    named = watch.update(100 * SECOND, first)
    assert all(one.doubt for one in named if one.seen is not None)
    assert any("cannot tell whether this is" in one.doubt for one in named)


def test_a_name_in_doubt_teaches_nothing() -> None:
    """After doubtful images the instruments are still where they were last seen for sure."""
    watch = tracker()
    left, right = seen((0, 240), (250, 240)), seen((639, 240), (390, 240))
    watch.update(0, [left, right])
    middle = seen((320, 0), (320, 150))
    doubtful = watch.update(10 * SECOND, [middle])
    assert [one.doubt != "" or one.seen is None for one in doubtful] == [True, True]
    again = watch.update(11 * SECOND, [right, left])
    assert [one.seen for one in again] == [1, 0]
    assert not any(one.doubt for one in again)


def test_one_name_follows_one_instrument() -> None:
    """A second instrument, however well seen, does not take the name."""
    watch = tracker(("A",), (None,))
    left = seen((0, 240), (250, 240), 0.4)
    assert watch.update(0, [left])[0].seen == 0
    for step in range(1, 30):
        rival = seen((639, 240), (390, 240), 0.9)
        named = watch.update(step * SECOND // 4, [rival, left])
        assert named[0].seen == 1
        assert not named[0].doubt


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_expected_places_are_apart(count: int) -> None:
    """From the left over the top to the right; one alone may come from anywhere."""
    places = [place for place in expected_places([None] * count) if place is not None]
    assert len(places) == (0 if count == 1 else count)
    apart: list[Array] = [b - a for a, b in itertools.pairwise(places)]
    assert all(step[0] > 0.1 for step in apart)


def test_a_doubtful_row_raises_no_alarm() -> None:
    """Nor does it tell a speed, nor do rows before it tell one after it."""
    watch = AlarmWatch(AlarmRules(below_m=0.005))
    close = FrameResult(0, Status.OK, distances=Distances(clearance=Distance(0.001, 1e-4)))
    assert watch.watch(close).alarm is True
    doubted = close.doubted("cannot tell whether this is A or B")
    assert doubted.detail == doubted.doubt
    assert watch.watch(doubted) == AlarmState()
    assert FrameResult(0, Status.OK, detail="first").doubted("second").detail == "first; second"
