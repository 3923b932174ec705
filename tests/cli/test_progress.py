"""The progress bar: on a terminal, with a rate; nothing at all in a pipe."""

from __future__ import annotations

import io
import itertools
import re
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
from rich.console import Console
from svmdist.cli.console import Verbosity, set_verbosity
from svmdist.cli.progress import _lines, progress_bar, tracked

from svmdist.cli import progress
from tests.cli.conftest import Cli
from tests.conftest import REPOSITORY

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


def test_what_is_done_within_has_no_bar_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two bars at a time would overwrite each other; afterwards there is one again."""
    text = terminal(monkeypatch)
    with progress_bar("outer", "rows") as outer, progress_bar("inner", "images") as inner:
        inner(1, 2)
        outer(1, 5)
    with progress_bar("later", "rows") as later:
        later(2, 3)
    assert "inner" not in text.getvalue()
    assert all(shown in text.getvalue() for shown in ("outer", "1/5", "later", "2/3"))


def test_quiet_shows_no_bar_on_a_terminal(monkeypatch: pytest.MonkeyPatch) -> None:
    text = terminal(monkeypatch)
    set_verbosity(Verbosity.QUIET)
    try:
        with progress_bar("reading", "rows") as advance:
            advance(1, 2)
    finally:
        set_verbosity(Verbosity.NORMAL)
    assert text.getvalue() == ""


STEREO = REPOSITORY / "recordings" / "3d" / "contact.mcap"
FEW = ("--every", 20)
COMMANDS: list[tuple[tuple[object, ...], str]] = [
    (("estimate", STEREO, *FEW, "-o", "rows.csv"), "measuring: 4 of 4 rows"),
    (("estimate", STEREO, *FEW, "-o", "a.mp4"), "drawing contact: 4 of 4 images"),
    (("estimate", STEREO, *FEW, "-o", "a.mcap"), "drawing contact: 4 of 4 images"),
    (("estimate", STEREO, *FEW, "-o", "a.html"), r"drawing the worst frames: \d of \d images"),
    (("estimate", STEREO, *FEW, "--lag", "auto", "-o", "rows.csv"), "lag of contact: 4 of 4 images"),
    (("validate", STEREO, *FEW), "validating overlay: 4 of 4 rows"),
    (
        ("validate", STEREO, *FEW, "--method", "kinematic", "--lag", "auto"),
        "validating kinematic: 8 of 8 rows",
    ),
    (("compare", STEREO, *FEW, "--method", "overlay", "--method", "shaft"), "comparing: 8 of 8 measurements"),
    (("blur-bench", STEREO, *FEW), "Table I: 4 of 4 images"),
    (
        ("blur-bench", STEREO, *FEW),
        "overlay, 2 conditions: 8 of 8 measurements",
    ),
    (
        ("calibrate", REPOSITORY / "recordings" / "calibration.mcap", "-o", "c.toml"),
        "calibrating: 80 of 80 images",
    ),
    (("fk", STEREO, "-o", "poses.csv"), "reading: 801 of 801 joint states"),
    (("fk", STEREO, "-o", "poses.csv"), "writing: 801 of 801 poses"),
    (("hand-eye", STEREO, "--method", "fiducial"), "fiducial sees PSM1: 80 of 80 images"),
    (("show", STEREO, "--frame", 2), "drawing contact: 3 of 3 images"),
    (
        ("import", "images", "--rate", 10, "--camera", "60,60,32,24", "-o", "b.mcap"),
        "import images: 3 of 3 images",
    ),
]


@pytest.mark.parametrize(
    ("arguments", "told"), COMMANDS, ids=lambda value: value if isinstance(value, str) else value[0]
)
def test_commands_tell_how_far_they_are(
    monkeypatch: pytest.MonkeyPatch, cli: Cli, tmp_path: Path, arguments: Sequence[object], told: str
) -> None:
    """By a clock that jumps eleven seconds at each look, a line comes at each step, up to the last one."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "images").mkdir()
    for number in range(3):
        cv2.imwrite(str(tmp_path / "images" / f"{number}.png"), np.full((48, 64, 3), 40 * number, np.uint8))
    clock = itertools.count(0, 11)
    monkeypatch.setattr(progress, "now_s", lambda: float(next(clock)))
    outcome = cli(*arguments, *(() if arguments[0] in ("import", "fk", "calibrate") else ("--jobs", 1)))
    assert re.search(rf"^svmdist: {told}, [\d.]+ \w", outcome.err, re.MULTILINE), outcome.err
    quiet = cli(*arguments, "-q", *(("--force",) if "-o" in arguments and arguments[-1] in FORCED else ()))
    assert quiet.err == "" or arguments[0] == "hand-eye", quiet.err  # whose log is one that it refuses


FORCED = ("a.mcap", "b.mcap", "c.toml")
