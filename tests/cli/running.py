"""Running the command line in a process of its own, as a shell would."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

LIMIT_S = 120.0
"""A process that has not ended by then hangs; all of them need a few seconds, on a busy machine too."""


def ended(
    *arguments: object,
    cwd: Path | None = None,
    environment: Mapping[str, str] | None = None,
    before: Callable[[], None] | None = None,
    **streams: Any,
) -> subprocess.CompletedProcess[Any]:
    """Run `svmdist` to its end, with what it wrote; `before` is called in the process before it starts."""
    streams = {
        "stdout": subprocess.PIPE,
        "stderr": subprocess.PIPE,
        "encoding": "utf-8",
        "errors": "replace",
    } | streams
    return subprocess.run(
        [sys.executable, "-m", "svmdist", *map(_text, arguments)],
        cwd=cwd,
        env={**os.environ, **(environment or {})},
        preexec_fn=before,
        timeout=LIMIT_S,
        check=False,
        **streams,
    )


def started(*arguments: str) -> subprocess.Popen[str]:
    """Begin `svmdist` in a session of its own, where it hears an interrupt; its stderr is kept."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)  # children shall hear it
    try:
        return subprocess.Popen(
            [sys.executable, "-m", "svmdist", *arguments],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
            start_new_session=True,
        )
    finally:
        signal.signal(signal.SIGINT, before)


def require_no_traceback(err: str) -> None:
    """Of svmdist: an interrupt may find Python itself still starting, which prints where it was."""
    assert "Traceback" not in err or "/svmdist/" not in err, err


def _text(argument: object) -> str:
    return os.fspath(argument) if isinstance(argument, Path) else str(argument)


def one_line(err: str) -> str:
    """The only line of stderr."""
    lines = err.strip().splitlines()
    assert len(lines) == 1, err
    assert "Traceback" not in err
    return lines[0]
