"""What the machine ran out of, in a line; a fault of ours is none of that."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from svmdist.cli.resources import NO_MEMORY, what_lacks


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (MemoryError(), NO_MEMORY),
        (OSError(24, "Too many open files", "a.mcap"), "a.mcap: Too many open files"),
        (RuntimeError("can't start new thread"), "no thread can be started; try --jobs 1"),
        (ImportError("libx.so: failed to map segment from shared object"), "a library cannot be loaded"),
    ],
)
def test_what_is_exhausted_is_told(error: BaseException, said: str) -> None:
    assert (what_lacks(error) or "").startswith(said)


def test_a_fault_of_ours_is_not_hidden() -> None:
    assert what_lacks(ValueError("a bug")) is None
    assert what_lacks(RuntimeError("another")) is None
    with pytest.raises(cv2.error) as caught:
        cv2.cvtColor(np.zeros((2, 2), np.uint8), cv2.COLOR_BGR2GRAY)
    assert what_lacks(caught.value) is None
