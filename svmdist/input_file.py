"""Files to read, opened so that no path can hang the program or fill its memory: regular files of a bounded size."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Sequence
from pathlib import Path
from typing import BinaryIO

from svmdist.errors import RecordingError
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


def content_sha256(path: LogPath) -> str:
    """Hash a file, or the files of a folder in the order of their names, as hexadecimal digits."""
    import hashlib

    digest = hashlib.sha256()
    for file in files_of(path):
        try:
            with open_regular(file) as stream:
                while piece := stream.read(1 << 20):
                    digest.update(piece)
        except OSError as problem:
            raise RecordingError(f"{file}: cannot read: {why(problem)}") from None
    return digest.hexdigest()


def files_of(path: LogPath) -> list[LogPath]:
    """A file, or the files of a folder in the order of their names."""
    if isinstance(path, RemoteFile) or not path.is_dir():
        return [path]
    return [*sorted(file for file in path.iterdir() if file.is_file())]


def unique_names(paths: Sequence[LogPath]) -> list[str]:
    """A name for each recording: the file's without its ending, with as many folders before it as tell it from others.

    >>> unique_names([Path("logs/a/contact.mcap"), Path("logs/b/contact.mcap"), Path("sweep.mcap")])
    ['a/contact', 'b/contact', 'sweep']
    """
    parts = [(*_folders(path), path.stem) for path in paths]
    depths = dict.fromkeys(parts, 1)
    while True:
        sharing: dict[str, list[tuple[str, ...]]] = {}
        for part, depth in depths.items():
            sharing.setdefault("/".join(part[-depth:]), []).append(part)
        clashing = [part for of in sharing.values() if len(of) > 1 for part in of if depths[part] < len(part)]
        if not clashing:
            return ["/".join(part[-depths[part] :]) for part in parts]
        for part in clashing:
            depths[part] += 1


def _folders(path: LogPath) -> tuple[str, ...]:
    if isinstance(path, RemoteFile):
        return path.folders
    return Path(os.path.abspath(path)).parent.parts[1:]
