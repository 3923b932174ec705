"""Errors that say what to do: the nearest name, and the extra of a package that is not installed."""

from __future__ import annotations

import sys

import pytest

from svmdist.errors import OutputError, SourceError, did_you_mean, optional_package


def test_the_nearest_name_comes_first() -> None:
    """Whatever its case; without a near one the choices are listed alone."""
    assert (
        did_you_mean("SWEEEP", ["approach", "sweep"])
        == "did you mean sweep? The choices are: approach, sweep"
    )
    assert did_you_mean("zzz", ["b", "a"]) == "the choices are: a, b"


@pytest.mark.parametrize("error", [OutputError, SourceError])
def test_where_a_package_is_missing_the_extra_is_named(monkeypatch: pytest.MonkeyPatch, error: type) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    with pytest.raises(error, match=r"^a\.mp4 needs the package av, .*: pip install 'svmdist\[video\]'$"):
        optional_package("av", "video", "a.mp4", error)
