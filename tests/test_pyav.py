"""PyAV where it is installed, and one line where it is not."""

from __future__ import annotations

import sys

import pytest

from svmdist.errors import OutputError, SourceError, optional_package


def test_where_it_is_missing_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    """As the error of whoever needs it."""
    monkeypatch.setitem(sys.modules, "av", None)
    for error in (OutputError, SourceError):
        with pytest.raises(error, match=r"^a\.mp4 needs the package av, .*: pip install 'svmdist\[video\]'$"):
            optional_package("av", "video", "a.mp4", error)


def test_where_it_is_there_it_decodes() -> None:
    pytest.importorskip("av", reason="PyAV has no wheel for this platform")
    assert "h264" in optional_package("av", "video", "a video", OutputError).codecs_available
