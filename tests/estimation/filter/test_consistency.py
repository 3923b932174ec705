"""Consistency: what is as expected, what widens, and what nobody should trust."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.estimation.instrument.consistency import (
    MAX_REFUSED_FRAMES,
    MAX_REFUSED_SHARE,
    MAX_YOUNG_REFUSED_SHARE,
    PROBATION_S,
    USUAL_CONSTANT_DEVIATIONS,
    WINDOW_SOLVES,
    Consistency,
    GatingResult,
)
from svmdist.profile.settings import FilterSettings

SETTINGS = FilterSettings()
STEP_NS = 100_000_000


def judged(nis: float, accepted: bool = True, name: str = "tag", degrees: int = 2) -> GatingResult:
    return GatingResult(name, nis, degrees, accepted)


def test_true_innovations_are_as_expected() -> None:
    """Drawn from chi-square: the ratio is about 1 over many, and nothing is said against it."""
    rng = np.random.default_rng(3)
    watch, ratios = Consistency(SETTINGS), []
    assert watch.ratio is None
    assert watch.widening == 1.0
    for frame in range(400):
        watch.add(frame * STEP_NS, [judged(float(rng.chisquare(2))) for _ in range(3)])
        ratios.append(watch.ratio or 0.0)
        assert not watch.contradiction
    assert np.mean(ratios) == pytest.approx(1.0, abs=0.05)


def test_large_innovations_widen_by_their_ratio() -> None:
    """Three times what is expected: variances grow by three."""
    watch = Consistency(SETTINGS)
    for frame in range(10):
        watch.add(frame * STEP_NS, [judged(6.0)])
    assert watch.ratio == pytest.approx(3.0)
    assert watch.widening == pytest.approx(3.0)
    assert not watch.contradiction


def test_very_large_innovations_are_a_contradiction() -> None:
    watch = Consistency(SETTINGS)
    for frame in range(10):
        watch.add(frame * STEP_NS, [judged(2.0 * (SETTINGS.max_consistency + 0.5))])
    assert "times what is expected" in watch.contradiction


def test_most_of_what_was_measured_refused_is_a_contradiction_that_names_it() -> None:
    """Not by one frame: a wild detection alone is none. What passes out of the window is forgotten."""
    watch = Consistency(SETTINGS)
    watch.add(0, [judged(400.0, False, "edge +1")])
    assert not watch.contradiction
    for frame in range(1, 9):
        watch.add(
            frame * STEP_NS, [judged(0.5), judged(400.0, False, "edge +1"), judged(90.0, False, "edge -1")]
        )
    assert watch.refused_share > MAX_REFUSED_SHARE
    assert "edge +1, edge -1" in watch.contradiction
    for frame in range(9, 60):
        watch.add(frame * STEP_NS, [judged(1.0)])
    assert watch.refused_share == 0.0
    assert not watch.contradiction


def test_a_constant_far_from_what_is_stated_widens_and_then_contradicts() -> None:
    watch = Consistency(SETTINGS)
    watch.watch_constants([("focal length", -1.0), ("tag size", 2.0)])
    assert watch.widening == 1.0
    watch.watch_constants([("focal length", -4.0), ("tag size", 2.0)])
    assert watch.widening == pytest.approx((4.0 / USUAL_CONSTANT_DEVIATIONS) ** 2)
    assert not watch.contradiction
    watch.watch_constants([("focal length", -1.0), ("tag size", 6.0)])
    assert watch.contradiction == "tag size is 6.0 stated deviations from its stated value"


def test_cleared_it_knows_nothing() -> None:
    watch = Consistency(SETTINGS)
    watch.add(0, [judged(9.0)] * 8)
    watch.clear()
    assert watch.ratio is None
    assert watch.refused_share == 0.0


@pytest.mark.parametrize("rate_hz", [2, 10, 30])
def test_after_a_contradiction_nothing_is_trusted_for_a_while(rate_hz: int) -> None:
    """For the probation's time at any rate of images, through a new start; then what agrees is trusted again."""
    watch, step_ns = Consistency(SETTINGS), 1_000_000_000 // rate_hz
    watch.distrust(0)
    watch.clear()
    trusted_ns = None
    for frame in range(1, 5 * rate_hz):
        watch.add(frame * step_ns, [judged(1.0), judged(2.0)])
        assert not watch.contradiction
        if trusted_ns is None and not watch.doubt:
            trusted_ns = frame * step_ns
    assert trusted_ns is not None
    assert abs(trusted_ns / 1e9 - PROBATION_S) <= 1.0 / rate_hz


def test_joints_far_later_than_stated_are_a_contradiction_until_it_is_cleared() -> None:
    """Either way; where the clocks are said to agree exactly, nothing is off."""
    watch = Consistency(SETTINGS)
    watch.watch_time_offset(0.24, 0.05)
    assert not watch.contradiction
    watch.watch_time_offset(-0.26, 0.05)
    assert watch.contradiction.startswith("joints seem -0.26 s late, 5 stated deviations")
    assert watch.widening == 1.0
    watch.clear()
    assert not watch.contradiction
    watch.watch_time_offset(0.26, 0.0)
    assert not watch.contradiction


def test_a_young_filter_may_refuse_less() -> None:
    """A quarter refused: too much in the first frames, as long as they are solved for anew, and none later."""
    watch = Consistency(SETTINGS)
    told = []
    for frame in range(max(WINDOW_SOLVES) + 2):
        watch.add(frame * STEP_NS, [judged(1.0)] * 3 + [judged(90.0, False)])
        told.append(bool(watch.contradiction))
    assert told[:2] == [True, True]
    assert told[-3:] == [True, False, False]


def test_one_source_alone_may_be_wrong_in_the_first_frames() -> None:
    """A shadow taken for the shaft, while the tag agrees; not while only the tissue does, which has no tool."""
    with_tag, alone = Consistency(SETTINGS), Consistency(SETTINGS)
    shadow = GatingResult("edge +1", 90.0, 2, False, "shaft")
    scene = GatingResult("tissue height", 0.5, 1, True, "tissue height")
    for frame in range(8):
        stamp_ns = frame * STEP_NS
        with_tag.add(stamp_ns, [shadow, GatingResult("tag", 5.0, 6, True, "tag")])
        alone.add(stamp_ns, [shadow, GatingResult("edge -1", 1.0, 3, True, "shaft")])
        alone.add(stamp_ns, [scene, scene], of_tool=False)
    assert not with_tag.contradiction
    assert with_tag.refused_share > MAX_YOUNG_REFUSED_SHARE
    assert "edge +1" in alone.contradiction


def test_two_sources_that_are_refused_contradict_a_young_filter() -> None:
    watch = Consistency(SETTINGS)
    for frame in range(8):
        refused = [GatingResult(name, 90.0, 2, False, name) for name in ("shaft", "distal marker")]
        watch.add(frame * STEP_NS, [*refused, GatingResult("tag", 5.0, 6, True, "tag")])
    assert "shaft, distal marker" in watch.contradiction


def test_tissue_that_never_agreed_with_its_plane_is_a_contradiction() -> None:
    """At once where nothing speaks for the plane; after it agreed, only several refusals in a row."""
    refused, agreed = judged(90.0, False, "tissue height", 1), judged(0.5, True, "tissue height", 1)
    never, after = Consistency(SETTINGS), Consistency(SETTINGS)
    never.add(0, [judged(1.0)] * 4)
    never.add(0, [refused], of_tool=False)
    assert "tissue height" in never.contradiction
    after.add(0, [agreed], of_tool=False)
    for frame in range(1, MAX_REFUSED_FRAMES + 1):
        assert not after.contradiction
        after.add(frame * STEP_NS, [judged(1.0)] * 4)
        after.add(frame * STEP_NS, [refused], of_tool=False)
    assert "tissue contradicts its plane" in after.contradiction


def test_a_tag_is_taken_for_nothing_else() -> None:
    """A tag that is refused contradicts a young filter, whatever other sources agree."""
    watch = Consistency(SETTINGS)
    for frame in range(8):
        tag = GatingResult("tag", 90.0, 6, False, "tag")
        others = [GatingResult(name, 4.0, 4, True, name) for name in ("shaft", "distal marker")]
        watch.add(frame * STEP_NS, [tag, *others])
    assert "tag" in watch.contradiction
