"""Files that a command writes: a name belongs to a whole file, whatever happens while it is written."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from svmdist.errors import OutputError


@contextmanager
def whole_file(path: Path) -> Iterator[Path]:
    """Give the path to write to, beside `path`; it takes that name when the block ends, and is removed where it fails.

    So an interrupt, an error or a full disk leaves what stood under the name before. A device, a pipe, and a file in a
    folder that takes no other file, are written in place. Raises OutputError where the file cannot be written.
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


def write_whole(path: Path, lines: Iterable[str]) -> None:
    """Write text as it comes, in UTF-8 and with the line ends that it has; raises OutputError where that fails."""
    with whole_file(path) as target, target.open("w", encoding="utf-8", newline="") as file:
        file.writelines(lines)
