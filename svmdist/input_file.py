"""Files to read, opened so that no path can hang the program or fill its memory: regular files of a bounded size."""

from __future__ import annotations

import errno
import os
import stat
from pathlib import Path
from typing import BinaryIO

from svmdist.remote_file import RemoteFile

LogPath = Path | RemoteFile
"""Where a log may be: a file or folder, or a URL."""


def open_regular(path: LogPath) -> BinaryIO:
    """Open a regular file, or one behind a URL, to read; OSError with a reason where it is none, or cannot be opened.

    It is opened without waiting, and looked at when it is open: a pipe would wait for a writer for ever, a device may
    never end, and what a path leads to can change between a look and an opening.
    """
    if isinstance(path, RemoteFile):
        return path.open()
    try:
        number = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except ValueError:  # NUL; no other character is impossible in a path
        raise OSError(errno.EINVAL, "the path has a character that no path can have") from None
    try:
        mode = os.fstat(number).st_mode
        if stat.S_ISDIR(mode):
            raise OSError(errno.EISDIR, os.strerror(errno.EISDIR))
        if not stat.S_ISREG(mode):
            raise OSError(errno.EINVAL, "it is no regular file")
        return os.fdopen(number, "rb")
    except BaseException:
        os.close(number)
        raise


def read_regular(path: Path, limit_bytes: int) -> bytes:
    """Read a whole regular file; OSError with a reason where it is none, cannot be read, or is above the limit."""
    with open_regular(path) as file:
        data = file.read(limit_bytes + 1)
    if len(data) > limit_bytes:
        raise OSError(errno.EFBIG, f"it has more than {limit_bytes} bytes, the limit")
    return data


def why(problem: OSError | ValueError) -> str:
    """What was wrong with a file, without its name, in a few words."""
    return str(getattr(problem, "strerror", None) or problem)
