"""Ctrl-C: one line, exit code 130, no traceback, whatever the command is doing."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NoReturn

import pytest

from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from svmdist.samples import ImageSample
from tests.cli.conftest import Cli

INTERRUPTED = "svmdist: interrupted"
TERMINATED = "svmdist: terminated"
LIMIT_S = 120.0
"""A process that has not ended by then is killed, which fails its test; all of them need a few seconds."""


@contextmanager
def running(*arguments: object, **streams: Any) -> Iterator[subprocess.Popen[str]]:
    """`svmdist` in a process that hears interrupts and that ends, so that nothing need wait with a limit of its own.

    A shell starts what it runs in the background with interrupts ignored, and so do its children begin: also
    the tests', then. They do not inherit a handler, and begin with the default where their parent has one.
    """
    command = [sys.executable, "-u", "-m", "svmdist", *map(str, arguments)]
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    try:
        process = subprocess.Popen(command, text=True, start_new_session=True, **streams)
    finally:
        signal.signal(signal.SIGINT, before)
    watchdog = threading.Timer(LIMIT_S, process.kill)
    watchdog.start()
    try:
        with process:
            try:
                yield process
            finally:
                process.kill()  # does nothing to one that has ended
    finally:
        watchdog.cancel()


@pytest.mark.parametrize(
    ("arguments", "busy"),
    [
        (["info", "x.mcap"], "svmdist.workflows.request.open_recording"),
        (["estimate", "x.mcap"], "svmdist.workflows.request.open_recording"),
        (["validate", "x.mcap"], "svmdist.workflows.request.open_recording"),
        (["compare", "x.mcap"], "svmdist.workflows.request.open_recording"),
        (["blur-bench", "x.mcap"], "svmdist.workflows.request.open_recording"),
        (["calibrate", "x.mcap", "-o", "c.toml"], "svmdist.workflows.request.open_recording"),
        (["fk", "x.mcap"], "svmdist.workflows.request.open_recording"),
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


@pytest.mark.parametrize(
    ("number", "code", "said"),
    [(signal.SIGINT, 130, INTERRUPTED), (signal.SIGTERM, 143, TERMINATED), (signal.SIGHUP, 129, TERMINATED)],
    ids=["INT", "TERM", "HUP"],
)
@pytest.mark.parametrize("jobs", [1, 2])
def test_while_a_log_is_recorded(
    tmp_path: Path, number: signal.Signals, code: int, said: str, jobs: int
) -> None:
    """A real signal between two frames: no log under its name, and what there is stays in its `.part`, readable."""
    pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
    path, part = tmp_path / "r.mcap", tmp_path / "r.mcap.part"
    with running("record", "--duration", 60, "-j", jobs, "-o", path, stderr=subprocess.PIPE) as process:
        while process.poll() is None and not (part.exists() and part.stat().st_size > 100_000):
            time.sleep(0.02)
        process.send_signal(number)
        _, err = process.communicate()
    assert process.returncode == code
    assert err.splitlines() == [f"{said}; what was recorded until then is in {part}"]
    assert list(tmp_path.iterdir()) == [part]
    assert any(isinstance(image, ImageSample) for image in open_recording(part, load_profile()).images())


def test_with_a_progress_bar_on_a_terminal(golden: Path) -> None:
    """The bar is taken off the terminal, the cursor comes back, and the line stands alone.

    All methods on all logs take a minute, of which the interrupt leaves the first moment.
    """
    pty = pytest.importorskip("pty", reason="this system has no pseudo-terminals")
    leader, follower = pty.openpty()
    logs = sorted(golden.glob("*.mcap"))
    with running("compare", *logs, stdout=subprocess.DEVNULL, stderr=follower) as process:
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
        process.wait()
    os.close(leader)
    assert process.returncode == 130, shown.decode(errors="replace")
    assert b"Traceback" not in shown
    assert shown.count(INTERRUPTED.encode()) == 1
    assert shown.rindex(b"\x1b[?25h") < shown.index(INTERRUPTED.encode())
