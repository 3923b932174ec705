"""The progress bar: on a terminal, with a rate; nothing at all in a pipe."""

from __future__ import annotations

import io

import pytest
from rich.console import Console

from svmdist.cli import progress
from svmdist.cli.progress import _lines, progress_bar, tracked

SHOW_CURSOR = "\x1b[?25h"


def terminal(monkeypatch: pytest.MonkeyPatch) -> io.StringIO:
    """A terminal in place of stderr."""
    text = io.StringIO()
    monkeypatch.setattr(progress, "stderr_is_terminal", lambda: True)
    monkeypatch.setattr(
        progress, "error_console", lambda: Console(file=text, force_terminal=True, width=120, markup=False)
    )
    return text


def test_a_pipe_gets_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    with progress_bar("Reading", "frames") as advance:
        for done in range(3):
            advance(done, None)
    captured = capsys.readouterr()
    assert (captured.out, captured.err) == ("", "")


def test_a_terminal_gets_the_title_the_count_and_the_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    """A title is no markup: brackets in a name stay."""
    text = terminal(monkeypatch)
    with progress_bar("[red]a.mcap", "frames") as advance:
        advance(3, 8)
    shown = text.getvalue()
    assert "[red]a.mcap" in shown
    assert "3/8" in shown
    assert "frames/s" in shown


def test_an_error_passes_and_the_cursor_is_shown_again(monkeypatch: pytest.MonkeyPatch) -> None:
    text = terminal(monkeypatch)

    def fail() -> None:
        with progress_bar("Reading", "frames"):
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fail()
    assert text.getvalue().endswith(SHOW_CURSOR)


def test_a_pipe_gets_a_line_every_ten_seconds(capsys: pytest.CaptureFixture[str]) -> None:
    """By a clock that jumps four seconds at each look."""
    times = iter(range(0, 400, 4))
    advance = _lines("measuring a", "frames", lambda: float(next(times)))
    for done in range(1, 8):
        advance(done, 20)
    assert capsys.readouterr().err.splitlines() == [
        "svmdist: measuring a: 3 of 20 frames, 0.2 frames/s",
        "svmdist: measuring a: 6 of 20 frames, 0.2 frames/s",
    ]


def test_tracked_items_are_the_items(monkeypatch: pytest.MonkeyPatch) -> None:
    text = terminal(monkeypatch)
    assert list(tracked("abc", "rows of a", "rows", 3)) == ["a", "b", "c"]
    assert "3/3" in text.getvalue()
