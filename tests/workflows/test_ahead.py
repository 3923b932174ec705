"""Work that runs ahead: the items' order for any number of threads, few items at a time, and a clean end."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from svmdist.workflows.ahead import (
    LOOK_AHEAD,
    in_order,
    keep_freed_memory,
    one_opencv_thread,
    usable_cores,
)

WORKERS = (1, 2, 3, 8)
COUNT = 40


class Counting:
    """Items from a source that counts how many were taken, and in which thread."""

    def __init__(self, count: int = COUNT) -> None:
        self.count = count
        self.taken = 0
        self.threads: set[int] = set()

    def __iter__(self) -> Iterator[int]:
        for number in range(self.count):
            self.taken += 1
            self.threads.add(threading.get_ident())
            yield number


def uneven(number: int) -> int:
    """The square; every third item takes longer than its followers together."""
    time.sleep(0.003 if number % 3 == 0 else 0.0)
    return number * number


@pytest.mark.parametrize("workers", WORKERS)
def test_results_come_in_the_items_order(workers: int) -> None:
    assert list(in_order(uneven, range(COUNT), workers)) == [number * number for number in range(COUNT)]
    assert list(in_order(uneven, [], workers)) == []
    assert list(in_order(uneven, [3], workers)) == [9]


@pytest.mark.parametrize("workers", WORKERS)
def test_few_items_are_taken_ahead(workers: int) -> None:
    """Before the n-th result is used, no more than n and the look-ahead of all threads were taken; one runs in step."""
    source = Counting()
    ahead = LOOK_AHEAD * workers if workers > 1 else 0
    for number, _ in enumerate(in_order(uneven, source, workers), start=1):
        assert source.taken <= number + ahead
    assert source.taken == COUNT


@pytest.mark.parametrize("workers", WORKERS)
def test_items_are_taken_in_the_consumers_thread(workers: int) -> None:
    """A file is read by one thread, whichever work on what it holds."""
    source = Counting()
    worked = set(in_order(lambda _: threading.get_ident(), source, workers))
    assert source.threads == {threading.get_ident()}
    assert (threading.get_ident() in worked) == (workers == 1)


@pytest.mark.parametrize("workers", WORKERS)
def test_an_exception_comes_at_its_place(workers: int) -> None:
    """The results before it are all given, none after it."""

    def breaking(number: int) -> int:
        if number == 5:
            raise ValueError("the fifth")
        return uneven(number)

    given: list[int] = []
    with pytest.raises(ValueError, match="the fifth"):
        given.extend(in_order(breaking, range(COUNT), workers))
    assert given == [number * number for number in range(5)]


@pytest.mark.parametrize("workers", WORKERS)
def test_an_exception_of_the_source_is_raised_too(workers: int) -> None:
    """As a file that ends too early: whatever was given before is right."""

    def source() -> Iterator[int]:
        yield from range(12)
        raise OSError("cut off")

    given: list[int] = []
    with pytest.raises(OSError, match="cut off"):
        given.extend(in_order(uneven, source(), workers))
    assert given == [number * number for number in range(len(given))]


@pytest.mark.parametrize("workers", WORKERS)
def test_who_stops_early_stops_the_work(workers: int) -> None:
    """After closing nothing more is taken or begun, and no thread is left."""
    source, begun = Counting(1000), []
    before = threading.active_count()

    def work(number: int) -> int:
        begun.append(number)
        return uneven(number)

    results = in_order(work, source, workers)
    assert [next(results) for _ in range(3)] == [0, 1, 4]
    results.close()  # type: ignore[attr-defined]
    taken, so_far = source.taken, len(begun)
    time.sleep(0.02)
    assert (source.taken, len(begun)) == (taken, so_far)
    assert taken <= 3 + LOOK_AHEAD * workers
    assert threading.active_count() == before


def test_opencv_has_its_threads_back() -> None:
    """One inside; as many as before outside, also after an exception."""
    before = cv2.getNumThreads()
    with one_opencv_thread():
        assert cv2.getNumThreads() == 1
    assert cv2.getNumThreads() == before
    with pytest.raises(ValueError, match="within"), one_opencv_thread():
        raise ValueError("within")
    assert cv2.getNumThreads() == before


def test_there_is_a_core() -> None:
    assert usable_cores() >= 1


def test_freed_memory_is_kept_where_the_c_library_lets_it() -> None:
    """Nothing but time depends on it: asking twice, or where the C library knows no such thing, does no harm."""
    keep_freed_memory()
    keep_freed_memory()
    assert np.ones((480, 640, 3)).sum() == 480 * 640 * 3
