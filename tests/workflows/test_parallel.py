"""Threads and processes: results do not depend on their number, few items are held, and none is left behind."""

import multiprocessing
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import cv2
import pytest

from svmdist.errors import RecordingError
from svmdist.workflows.parallel import (
    LOOK_AHEAD,
    each_in_processes,
    in_order,
    one_opencv_thread,
    process_pools,
)

WORKERS = (1, 2, 3, 8)
COUNT = 40


class Counting:
    """Items from a source that counts how many were taken, and in which thread."""

    def __init__(self, count: int) -> None:
        self.count, self.taken, self.threads = count, 0, set()

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
def test_few_items_are_taken_ahead_in_the_consumers_thread(workers):
    """Before the n-th result is used, no more than n and the look-ahead; one thread reads the file."""
    source = Counting(COUNT)
    ahead = LOOK_AHEAD * workers if workers > 1 else 0
    for number, _ in enumerate(in_order(uneven, source, workers), start=1):
        assert source.taken <= number + ahead
    assert source.taken == COUNT
    assert source.threads == {threading.get_ident()}
    worked = set(in_order(lambda _: threading.get_ident(), range(COUNT), workers))
    assert (threading.get_ident() in worked) == (workers == 1)


@pytest.mark.parametrize("workers", WORKERS)
@pytest.mark.parametrize("in_source", [False, True], ids=["work", "source"])
def test_an_exception_comes_at_its_place(workers, in_source):
    """No result comes after it, and of the work, all before it: a file may end too early."""

    def source() -> Iterator[int]:
        yield from range(12)
        raise OSError("cut off")

    def breaking(number: int) -> int:
        if number == 5:
            raise OSError("cut off")
        return uneven(number)

    given: list[int] = []
    work, items = (uneven, source()) if in_source else (breaking, range(COUNT))
    with pytest.raises(OSError, match="cut off"):
        given.extend(in_order(work, items, workers))
    assert given == [number * number for number in range(len(given) if in_source else 5)]


@pytest.mark.parametrize("workers", WORKERS)
def test_who_stops_early_stops_the_work(workers):
    """After closing nothing more is taken or begun, and no thread is left."""
    source, begun = Counting(1000), []
    before = threading.active_count()

    def work(number: int) -> int:
        begun.append(number)
        return uneven(number)

    results = in_order(work, source, workers)
    assert [next(results) for _ in range(3)] == [0, 1, 4]
    results.close()
    taken, so_far = source.taken, len(begun)
    time.sleep(0.02)
    assert (source.taken, len(begun)) == (taken, so_far)
    assert taken <= 3 + LOOK_AHEAD * workers
    assert threading.active_count() == before


def test_opencv_has_its_threads_back():
    """One inside; as many as before outside, also after an exception."""
    before = cv2.getNumThreads()
    with one_opencv_thread():
        assert cv2.getNumThreads() == 1
    assert cv2.getNumThreads() == before
    with pytest.raises(ValueError, match="within"), one_opencv_thread():
        raise ValueError("within")
    assert cv2.getNumThreads() == before


def one_fails(part: int) -> None:
    if part == 0:
        raise RecordingError("broken")
    time.sleep(60)


def test_an_error_ends_all_processes_at_once():
    start_s = time.monotonic()
    with pytest.raises(RecordingError, match="broken"):
        list(each_in_processes(one_fails, [1, 0], 2))
    assert time.monotonic() - start_s < 30
    assert not multiprocessing.active_children()


def large(path: Path) -> bytes:
    path.touch()
    return bytes(150 << 20)


@pytest.mark.parametrize("after_s", [0.0, 0.1, 0.2, 0.3])
def test_an_error_ends_a_process_in_the_midst_of_a_result(tmp_path, after_s):
    """A part of a result is not waited for: at one of these times, at least, this has only come in part."""

    def fail():
        with suppress(RecordingError), process_pools() as make:
            make(1).submit(large, tmp_path / "made")
            while not (tmp_path / "made").exists():
                time.sleep(0.001)
            time.sleep(after_s)
            raise RecordingError("broken")

    failing = threading.Thread(target=fail, daemon=True)
    failing.start()
    failing.join(60.0)
    assert not failing.is_alive()
    assert not multiprocessing.active_children()
