"""Work that runs ahead in threads while its results are taken in order, a bounded number of them at a time."""

from __future__ import annotations

import ctypes
import os
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from functools import cache
from typing import TypeVar

import cv2

Item = TypeVar("Item")
Result = TypeVar("Result")

LOOK_AHEAD = 2
"""Results per worker that may wait: enough for a slow frame, and few images in memory."""

M_TRIM_THRESHOLD, M_MMAP_THRESHOLD = -1, -3
"""Of glibc's malloc.h."""
KEPT_BYTES = 64 << 20
"""As much freed memory a process keeps: some float images of 640x480."""


def usable_cores() -> int:
    """Cores that this process may run on."""
    try:
        return len(os.sched_getaffinity(0))
    except AttributeError:  # macOS and Windows
        return os.cpu_count() or 1


def in_order(function: Callable[[Item], Result], items: Iterable[Item], workers: int) -> Iterator[Result]:
    """Yield the function of every item, in the items' order; up to so many threads work ahead of the consumer.

    With one worker everything runs in the consumer's thread. Items are taken in this thread, one after the other. What
    the function raises is raised here, in its place.
    """
    if workers <= 1:
        yield from map(function, items)
        return
    waiting: deque[Future[Result]] = deque()
    with ThreadPoolExecutor(workers, thread_name_prefix="svmdist") as pool:
        try:
            for item in items:
                waiting.append(pool.submit(function, item))
                if len(waiting) > LOOK_AHEAD * workers:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            for future in waiting:
                future.cancel()


@cache
def keep_freed_memory() -> None:
    """Let this process keep the memory of an image for the next one, as far as its C library can be told (glibc).

    By default it is given back and asked for again, page by page, many times a frame: a sixth of the time of a
    method on degraded images.
    """
    try:
        mallopt = ctypes.CDLL(None).mallopt
    except (AttributeError, OSError, TypeError):  # another C library; Windows
        return
    mallopt(M_MMAP_THRESHOLD, 32 << 20)
    mallopt(M_TRIM_THRESHOLD, KEPT_BYTES)


@contextmanager
def one_opencv_thread() -> Iterator[None]:
    """Frames are worked on in parallel; OpenCV's own threads inside each would only get in their way."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)
