"""Ctrl-C: one line, exit code 130, no traceback, whatever the command is doing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import NoReturn

import pytest

from svmdist.profile import load_profile
from svmdist.recording.reader import open_recording
from svmdist.samples import ImageSample
from tests.cli.conftest import Cli

INTERRUPTED = "svmdist: interrupted"


@pytest.mark.parametrize(
    ("arguments", "busy"),
    [
        (["info", "x.mcap"], "svmdist.recording.inspect.inspect_recording"),
        (["estimate", "x.mcap"], "svmdist.recording.reader.open_recording"),
        (["validate", "x.mcap"], "svmdist.recording.reader.open_recording"),
        (["compare", "x.mcap"], "svmdist.recording.reader.open_recording"),
        (["blur-bench", "x.mcap"], "svmdist.recording.reader.open_recording"),
        (["blur-bench", "x.mcap", "--grid"], "svmdist.recording.reader.open_recording"),
        (["calibrate", "x.mcap", "-o", "c.toml"], "svmdist.recording.reader.open_recording"),
        (["fk", "x.mcap"], "svmdist.recording.reader.open_recording"),
        (["record", "-o", "r.mcap"], "svmdist.workflows.record.record"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_every_command(
    cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: list[str], busy: str
) -> None:
    """An interrupt in the middle of the work of each command ends it so, and leaves no file."""

    def interrupted(*_: object, **__: object) -> NoReturn:
        raise KeyboardInterrupt

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(busy, interrupted)
    outcome = cli(*arguments)
    assert (outcome.code, outcome.out) == (130, "")
    assert outcome.err.splitlines() == [INTERRUPTED]
    assert list(tmp_path.iterdir()) == []


def test_while_rows_are_written(golden: Path) -> None:
    """A real signal between two rows."""
    command = [sys.executable, "-u", "-m", "svmdist", "estimate", str(golden / "sweep.mcap"), "-f", "csv"]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    ) as process:
        assert process.stdout is not None
        rows = [process.stdout.readline() for _ in range(3)]
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=30)
    assert rows[2].startswith("sweep,")
    assert process.returncode == 130
    assert err.splitlines() == [INTERRUPTED]


def test_while_a_log_is_recorded(tmp_path: Path) -> None:
    """A real signal between two frames: no log under its name, and what there is stays in its `.part`, readable."""
    pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
    path, part = tmp_path / "r.mcap", tmp_path / "r.mcap.part"
    command = [sys.executable, "-m", "svmdist", "record", "--duration", "60", "-o", str(path)]
    with subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True) as process:
        deadline = time.monotonic() + 30.0
        while not (part.exists() and part.stat().st_size > 100_000) and time.monotonic() < deadline:
            time.sleep(0.02)
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=30)
    assert process.returncode == 130
    assert err.splitlines() == [INTERRUPTED]
    assert list(tmp_path.iterdir()) == [part]
    assert any(isinstance(image, ImageSample) for image in open_recording(part, load_profile()).images())


def test_with_a_progress_bar_on_a_terminal(golden: Path) -> None:
    """The bar is taken off the terminal, the cursor comes back, and the line stands alone."""
    pty = pytest.importorskip("pty", reason="this system has no pseudo-terminals")
    leader, follower = pty.openpty()
    command = [sys.executable, "-m", "svmdist", "compare", str(golden / "sweep.mcap"), "--method", "centroid"]
    with subprocess.Popen(
        command, stdout=subprocess.DEVNULL, stderr=follower, start_new_session=True
    ) as process:
        os.close(follower)
        shown = b""
        while b"comparing" not in shown:
            shown += os.read(leader, 4096)
        process.send_signal(signal.SIGINT)
        while True:
            try:
                piece = os.read(leader, 4096)
            except OSError:  # the terminal is closed
                break
            if not piece:
                break
            shown += piece
    os.close(leader)
    assert process.returncode == 130
    assert b"Traceback" not in shown
    assert shown.count(INTERRUPTED.encode()) == 1
    assert shown.rindex(b"\x1b[?25h") < shown.index(INTERRUPTED.encode())
