"""Rows by stamp in a file: what is read is what was added, in the order of time, in blocks of any size."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

import svmdist.workflows.stamped_rows as module
from svmdist.tracks import TransformTrack, bracket, sort_stamps
from svmdist.workflows.stamped_rows import StampedRows

Stamps = st.lists(st.integers(-50, 50), min_size=1, max_size=40)


def filled(rows: StampedRows, stamps: Sequence[int]) -> np.ndarray:
    values = np.arange(3.0 * len(stamps)).reshape(-1, 3)
    for stamp, row in zip(stamps, values, strict=True):
        rows.add(stamp, row)
    return values


@pytest.fixture(autouse=True, scope="module")
def small_blocks() -> object:
    before, module.BLOCK = module.BLOCK, 4
    yield
    module.BLOCK = before


@given(stamps=Stamps, is_sorted=st.booleans())
def test_rows_come_in_the_order_of_time(stamps: list[int], is_sorted: bool) -> None:
    """Of equal stamps the last one counts; how many are gone is told."""
    stamps = sorted(set(stamps)) if is_sorted else stamps
    with StampedRows(3) as rows:
        values = filled(rows, stamps)
        gone = rows.finish()
        order = sort_stamps(np.array(stamps, np.int64))
        assert gone == len(stamps) - len(order)
        assert len(rows) == len(order)
        found_ns, found = rows.read(0, len(rows))
        np.testing.assert_array_equal(found_ns, np.array(stamps)[order])
        np.testing.assert_array_equal(found, values[order])
        np.testing.assert_array_equal(rows.read(2, 5)[0], np.array(stamps)[order][2:5])


@given(stamps=Stamps, asked=st.lists(st.integers(-60, 60), min_size=1, max_size=6), gap=st.integers(1, 40))
def test_the_neighbours_of_every_stamp_are_around(stamps: list[int], asked: list[int], gap: int) -> None:
    """Interpolation finds in the part what it finds in all."""
    with StampedRows(3) as rows:
        filled(rows, stamps)
        rows.finish()
        every_ns, _ = rows.read(0, len(rows))
        at_ns = np.array(sorted(asked))
        part_ns, _ = rows.around(int(at_ns[0]), int(at_ns[-1]))
        whole, part = bracket(every_ns, at_ns, gap), bracket(part_ns, at_ns, gap)
        np.testing.assert_array_equal(part.valid, whole.valid)
        known = whole.valid
        np.testing.assert_array_equal(part_ns[part.left[known]], every_ns[whole.left[known]])
        np.testing.assert_array_equal(part_ns[part.right[known]], every_ns[whole.right[known]])


def test_a_track_of_a_part_interpolates_as_the_whole() -> None:
    """Poses too, to the last bit."""
    rng = np.random.default_rng(7)
    stamps = np.arange(0, 100, 3)
    T = np.repeat(np.eye(4)[None], len(stamps), axis=0)
    T[:, :3, 3] = rng.normal(size=(len(stamps), 3))
    with StampedRows(16) as rows:
        for stamp, one in zip(stamps, T, strict=True):
            rows.add(int(stamp), one.reshape(16))
        rows.finish()
        for at_ns in (np.arange(10, 20), np.arange(0, 99), np.array([50])):
            part_ns, part = rows.around(int(at_ns[0]), int(at_ns[-1]))
            found = TransformTrack("a", "b", part_ns, part.reshape(-1, 4, 4)).at(at_ns, 10)
            expected = TransformTrack("a", "b", stamps, T).at(at_ns, 10)
            np.testing.assert_array_equal(found.values, expected.values)
