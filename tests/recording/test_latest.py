"""The samples that a stream keeps: sorted, bounded, and those around a stamp."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from svmdist.recording.observations import Latest

stamp_lists = st.lists(st.integers(0, 50), max_size=60)


@given(stamp_lists, st.integers(-1, 51))
def test_the_samples_around_a_stamp_are_its_neighbours(stamps_ns: list[int], at_ns: int) -> None:
    """Whatever the order of arrival; of equal stamps the last one counts."""
    latest: Latest[int] = Latest()
    for number, stamp_ns in enumerate(stamps_ns):
        latest.add(stamp_ns, number, 1000)
    last = {stamp_ns: number for number, stamp_ns in enumerate(stamps_ns)}
    before = [stamp_ns for stamp_ns in sorted(last) if stamp_ns < at_ns][-1:]
    after = [stamp_ns for stamp_ns in sorted(last) if stamp_ns >= at_ns][:1]
    expected = after if after == [at_ns] else before + after
    assert latest.around(at_ns) == (expected, [last[stamp_ns] for stamp_ns in expected])
    assert latest.newest_ns == max(stamps_ns, default=-1)


@given(st.lists(st.integers(0, 10**9), unique=True, max_size=200))
def test_the_oldest_are_forgotten(stamps_ns: list[int]) -> None:
    latest: Latest[int] = Latest()
    for stamp_ns in stamps_ns:
        latest.add(stamp_ns, stamp_ns, 20)
        assert len(latest.values) <= 20
    assert latest.values == sorted(latest.values)
    if stamps_ns:
        assert latest.newest_ns == max(stamps_ns)
