"""Running the command line in a process of its own, as a shell would."""

from __future__ import annotations

import os
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


def _text(argument: object) -> str:
    return os.fspath(argument) if isinstance(argument, Path) else str(argument)


def one_line(err: str) -> str:
    """The only line of stderr."""
    lines = err.strip().splitlines()
    assert len(lines) == 1, err
    assert "Traceback" not in err
    return lines[0]
