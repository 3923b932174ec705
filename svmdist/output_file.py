"""Atomic writes: an output file gets its name when it is complete, and never before."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from svmdist.errors import OutputError


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path`. It is renamed to `path` when the block ends, and removed when it fails.

    An interrupt, an error or a full disk leaves the earlier file as it was. A device, a pipe, and a file in a folder
    that accepts no new files are written in place. Raises OutputError where the file cannot be written.
    """
    target = path.resolve()  # a link stays a link
    beside = target.with_name(f".{target.name}.{os.getpid()}.part")
    in_place = (target.exists() and not target.is_file()) or not os.access(target.parent, os.W_OK)
    try:
        if in_place:
            yield target
            return
        try:
            yield beside
            if target.exists():
                shutil.copymode(target, beside)
            beside.replace(target)
        finally:
            beside.unlink(missing_ok=True)
    except OSError as problem:
        raise OutputError(f"{path}: cannot write: {problem.strerror or problem}") from None


def write_atomically(path: Path, lines: Iterable[str]) -> None:
    """Write text atomically, in UTF-8 and with its own line ends; raises OutputError where that fails."""
    with atomic_file(path) as target, target.open("w", encoding="utf-8", newline="") as file:
        file.writelines(lines)
