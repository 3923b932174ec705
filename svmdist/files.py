"""Output files, written atomically: an output file gets its name when it is complete, and never before.

A file is written beside its place, as `.NAME.PID.part`, and locked meanwhile. What a killed process left there is
removed by the next one that writes the same file: its lock went with it.
"""

from __future__ import annotations

import codecs
import errno
import glob
import os
import shutil
import sys
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from svmdist.errors import OutputError
from svmdist.input_file import why

if sys.platform != "win32":
    import fcntl

MAX_NAME_BYTES = 255
"""Of one name in a folder, on nearly every file system."""
NO_LOCKS = frozenset({errno.ENOLCK, errno.EOPNOTSUPP, errno.ENOSYS, errno.EINVAL})
"""Errors of a file system that knows no locks."""
ASCII = str.maketrans("─–—−µ×’“”\N{REPLACEMENT CHARACTER}", '----ux\'""?') | {
    ord(character): text
    for character, text in {
        "…": "...",
        "±": "+-",
        "°": " deg",
        "²": "2",
        "³": "3",
        "≥": ">=",
        "≤": "<=",
        "→": "->",
    }.items()
}


def _fall_back(problem: UnicodeError) -> tuple[str | bytes, int]:
    """Replace characters that an encoding does not have by similar ones in ASCII, else by question marks."""
    if not isinstance(problem, UnicodeEncodeError):
        raise problem
    lost = problem.object[problem.start : problem.end]
    # A surrogate is a byte of a file's name that is not UTF-8; UTF-8 has a character for what cannot be read.
    if problem.encoding.lower().replace("_", "-") in {"utf-8", "utf8"}:
        return "\N{REPLACEMENT CHARACTER}".encode() * len(lost), problem.end
    return "".join(c if c.isascii() else "?" for c in lost.translate(ASCII)), problem.end


FALLBACK = "svmdist.fallback"
"""For `errors=` of a text stream: writing never fails for want of a character."""
codecs.register_error(FALLBACK, _fall_back)


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path`. It is renamed to `path` when the block ends, and removed when it fails.

    An interrupt, an error or a full disk leaves the earlier file as it was. A device, a pipe, and a file in a folder
    that accepts no new files are written in place. Raises OutputError where the file cannot be written.
    """
    if "\0" in str(path):
        raise OutputError(f"{path}: cannot write: the path has a character that no path can have")
    try:
        target = Path(os.path.realpath(path))  # a link stays a link
        if target.is_symlink():
            raise OSError(errno.ELOOP, os.strerror(errno.ELOOP))
        is_other = os.path.lexists(target) and not target.is_file()
        if is_other or not os.access(target.parent, os.W_OK):
            yield target
            return
        if len(os.fsencode(target.name)) > MAX_NAME_BYTES:
            raise OSError(errno.ENAMETOOLONG, os.strerror(errno.ENAMETOOLONG))
        name = os.fsdecode(os.fsencode(target.name)[: MAX_NAME_BYTES - len("..4194304.part")])
        remove_stale(target.parent, f".{glob.escape(name)}.[0-9]*.part")
        beside = target.with_name(f".{name}.{os.getpid()}.part")
        number = lock(beside, "wb")
        try:
            yield beside
            if target.exists():
                shutil.copymode(target, beside)
            beside.replace(target)
        finally:
            beside.unlink(missing_ok=True)
            os.close(number)
    except OSError as problem:
        raise OutputError(f"{path}: cannot write: {why(problem)}") from None


def write_atomically(path: Path, lines: Iterable[str]) -> None:
    """Write text atomically, in UTF-8 and with its own line ends; raises OutputError where that fails."""
    with (
        atomic_file(path) as target,
        target.open("w", encoding="utf-8", errors=FALLBACK, newline="") as file,
    ):
        file.writelines(lines)


def remove_stale(folder: Path, pattern: str) -> None:
    """Remove temporary files that killed processes left in a folder: those that are locked by nobody."""
    with suppress(OSError):
        for path in folder.glob(pattern):
            if not path.is_symlink() and _try_lock_path(path):
                path.unlink(missing_ok=True)


class BusyError(OSError):
    """Another process holds the file."""


def lock(path: Path, mode: str) -> int:
    """Create or open a file and lock it; give its descriptor. The lock ends when that is closed, or the process ends.

    `mode` is "xb" for a file that must be new, or "wb" for one that may exist, which is emptied once it is locked.
    Raises BusyError where another process has it. Where the system knows no locks, the file is opened all the same.
    """
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
    flags |= os.O_EXCL if mode == "xb" else 0
    while True:
        number = os.open(path, flags, 0o666)
        try:
            if _try_lock(number) is False:
                raise BusyError(errno.EBUSY, "another process is writing it")
            with suppress(FileNotFoundError):
                if os.path.samestat(os.stat(path), os.fstat(number)):
                    os.ftruncate(number, 0)
                    return number
        except BaseException:
            os.close(number)
            raise
        os.close(number)  # its owner renamed or removed it between opening and locking: make a new one


def is_held(path: Path) -> bool:
    """Whether another process holds the lock of a file; false where there is no such file."""
    return _try_lock_path(path) is False


def _try_lock_path(path: Path) -> bool | None:
    try:
        number = os.open(path, os.O_RDWR | getattr(os, "O_NONBLOCK", 0))
    except OSError:
        return None
    try:
        return _try_lock(number)
    finally:
        os.close(number)


def _try_lock(number: int) -> bool | None:
    """Lock an open file: true on success, false where another process has it, None where there are no locks."""
    if sys.platform == "win32":
        return None
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as problem:
        if problem.errno in NO_LOCKS:
            return None
        if problem.errno in {errno.EWOULDBLOCK, errno.EACCES}:
            return False
        raise
    return True
