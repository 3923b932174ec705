"""What detections cost: computed once, charged to whoever asks, each part counted once. The clock is the test's own.

All times are whole numbers of the fake clock, so that sums are exact.
"""

from __future__ import annotations

from typing import Any

import pytest

from svmdist.estimation.scene import CostLedger, detected


class FakeClock:
    """A clock that goes on only where work is done."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def __call__(self) -> float:
        """The time in s."""
        return self.now_s


class Detections:
    """Detections made of each other: `sum` of `left` and `right`, which both are made of `base`."""

    def __init__(self, clock: FakeClock, ledger: CostLedger) -> None:
        self.clock = clock
        self.ledger = ledger
        self.found: dict[str, Any] = {}
        self.made: list[str] = []

    def work(self, name: str, seconds: float) -> None:
        """Note what is computed, and let time pass."""
        self.made.append(name)
        self.clock.now_s += seconds

    @detected
    def base(self) -> int:
        """What the others are made of."""
        self.work("base", 1.0)
        return 1

    @detected
    def left(self) -> int:
        """One part."""
        self.work("left", 2.0)
        return self.base + 1

    @detected
    def right(self) -> int:
        """The other part, which asks for the base twice."""
        self.work("right", 4.0)
        return self.base + self.base

    @detected
    def sum(self) -> int:
        """Both parts."""
        self.work("sum", 8.0)
        return self.left + self.right

    @detected
    def nothing(self) -> None:
        """What is not there, which is an answer too."""
        self.work("nothing", 16.0)

    @detected
    def broken(self) -> int:
        """What raises after some work."""
        self.work("broken", 32.0)
        raise ValueError("broken")


@pytest.fixture
def clock() -> FakeClock:
    return FakeClock()


@pytest.fixture
def detections(clock: FakeClock) -> Detections:
    return Detections(clock, CostLedger(clock))


def cost_s(detections: Detections, *names: str, own_s: float = 0.0) -> float:
    """What a method costs that asks for these detections and works a while by itself."""
    costs: list[float] = []
    with detections.ledger.method(costs.append):
        for name in names:
            getattr(detections, name)
        detections.clock.now_s += own_s
    (cost,) = costs
    return cost


def test_a_detection_is_computed_once(detections: Detections) -> None:
    """However often it is asked for, and where its answer is that there is none."""
    for _ in range(3):
        assert detections.sum == 4
        assert detections.nothing is None
    assert sorted(detections.made) == ["base", "left", "nothing", "right", "sum"]


def test_a_part_of_two_detections_is_charged_once(detections: Detections) -> None:
    """`sum` is 8 s by itself, its parts 2 s and 4 s, and the base under both of them 1 s."""
    assert cost_s(detections, "sum") == 15.0
    assert detections.clock.now_s == 15.0


COSTS_S = {"base": 1.0, "left": 3.0, "right": 5.0, "sum": 15.0, "nothing": 16.0}


@pytest.mark.parametrize("first", COSTS_S)
@pytest.mark.parametrize("second", COSTS_S)
def test_a_method_is_charged_as_if_it_ran_alone(detections: Detections, first: str, second: str) -> None:
    """Whoever asked first, for whatever part of it, each pays the whole of what it asked for, and its own steps."""
    assert cost_s(detections, first, own_s=0.5) == COSTS_S[first] + 0.5
    assert cost_s(detections, second, own_s=0.25) == COSTS_S[second] + 0.25
    assert cost_s(detections, first, first, own_s=0.5) == COSTS_S[first] + 0.5


def test_what_was_prefetched_is_charged_to_who_uses_it(detections: Detections) -> None:
    """Detections that were computed outside of any method belong to the methods that ask for them, and to no other."""
    assert detections.sum == 4
    assert cost_s(detections, own_s=0.5) == 0.5
    assert cost_s(detections, "left") == 3.0
    assert cost_s(detections, "left", "right") == 7.0


def test_parts_add_up_across_objects(clock: FakeClock) -> None:
    """Two objects share a ledger, as a scene and its instruments do; equal names stay apart."""
    ledger = CostLedger(clock)
    first, second = Detections(clock, ledger), Detections(clock, ledger)
    costs: list[float] = []
    with ledger.method(costs.append):
        assert (first.left, second.left) == (2, 2)
    assert costs == [6.0]


def test_a_detection_that_raises_is_charged_and_not_kept(detections: Detections) -> None:
    """The time was spent; who asks again computes it again, and the ledger is in order for the others."""
    costs: list[float] = []
    for _ in range(2):
        with pytest.raises(ValueError, match="broken"), detections.ledger.method(costs.append):
            _ = detections.broken
    assert costs == [32.0, 32.0]
    assert detections.made == ["broken", "broken"]
    assert cost_s(detections, "left") == 3.0


def test_the_class_gives_the_detection_itself() -> None:
    """Documentation is that of the method, so that help and checks see it."""
    assert isinstance(Detections.base, detected)
    assert Detections.base.__doc__ == "What the others are made of."
