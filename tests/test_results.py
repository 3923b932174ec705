"""A failure is told from a result by its type, and carries its reason."""

from __future__ import annotations

from svmdist.results import Failure


def test_a_failure_says_why():
    failure = Failure("no right view")
    assert isinstance(failure, Failure)
    assert failure.reason == "no right view"
    assert failure == Failure("no right view")
