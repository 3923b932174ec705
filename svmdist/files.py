"""Atomic writes: an output file gets its name when it is complete, and never before.

A file is written beside its place, as `.NAME.PID.part`, and locked meanwhile. What a killed process left there is
removed by the next one that writes the same file: its lock went with it.
"""

from __future__ import annotations

import codecs
import errno
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
"""What a file system says that knows no locks."""
ASCII = str.maketrans(
    {
        "─": "-",
        "–": "-",
        "—": "-",
        "−": "-",
        "…": "...",
        "±": "+-",
        "°": " deg",
        "²": "2",
        "³": "3",
        "µ": "u",
        "×": "x",
    }
    | {"≥": ">=", "≤": "<=", "→": "->", "’": "'", "“": '"', "”": '"', "\N{REPLACEMENT CHARACTER}": "?"}
)


def _fall_back(problem: UnicodeError) -> tuple[str | bytes, int]:
    """What stands for characters that an encoding does not have: their likes in ASCII, else question marks."""
    if not isinstance(problem, UnicodeEncodeError):
        raise problem
    lost = problem.object[problem.start : problem.end]
    # A surrogate is a byte of a file's name that is not UTF-8; UTF-8 has a character for what cannot be read.
    if problem.encoding.lower().replace("_", "-") in {"utf-8", "utf8"}:
        return "\N{REPLACEMENT CHARACTER}".encode() * len(lost), problem.end
    plain = lost.translate(ASCII)
    return "".join(character if character.isascii() else "?" for character in plain), problem.end


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
        _remove_stale(target)
        beside = _beside(target, str(os.getpid()))
        with locked_file(beside, "wb"):
            try:
                yield beside
                if target.exists():
                    shutil.copymode(target, beside)
                beside.replace(target)
            finally:
                beside.unlink(missing_ok=True)
    except OSError as problem:
        raise OutputError(f"{path}: cannot write: {why(problem)}") from None


def write_atomically(path: Path, lines: Iterable[str]) -> None:
    """Write text atomically, in UTF-8 and with its own line ends; raises OutputError where that fails."""
    with (
        atomic_file(path) as target,
        target.open("w", encoding="utf-8", errors=FALLBACK, newline="") as file,
    ):
        file.writelines(lines)


class BusyError(OSError):
    """Another process holds the file."""


@contextmanager
def locked_file(path: Path, mode: str) -> Iterator[int]:
    """Create or open a file and lock it; give its descriptor. The lock ends with the block, or with the process.

    `mode` is "xb" for a file that must be new, or "wb" for one that may be there, which is emptied once it is locked.
    Raises BusyError where another process has it. Where the system knows no locks, the file is opened all the same.
    """
    number = lock(path, mode)
    try:
        yield number
    finally:
        with suppress(OSError):
            os.close(number)


def lock(path: Path, mode: str) -> int:
    """Do what `locked_file` does, for a caller that closes the descriptor itself."""
    flags = os.O_RDWR | os.O_CREAT | getattr(os, "O_CLOEXEC", 0) | getattr(os, "O_BINARY", 0)
    flags |= os.O_EXCL if mode == "xb" else 0
    while True:
        number = os.open(path, flags, 0o666)
        try:
            is_ours = _try_lock(number)
            if is_ours and _is_at(path, number):
                os.ftruncate(number, 0)
                return number
        except BaseException:
            os.close(number)
            raise
        os.close(number)
        if not is_ours:
            raise BusyError(errno.EBUSY, "another process is writing it")
        # Between opening and locking, its owner gave it its final name, or removed it: there is a new one to make.


def is_held(path: Path) -> bool:
    """Whether another process holds the lock of a file; false where there is no such file."""
    try:
        number = os.open(path, os.O_RDWR)
    except OSError:
        return False
    try:
        return not _try_lock(number)
    finally:
        os.close(number)


def _try_lock(number: int) -> bool:
    """Whether the lock of an open file is ours now; true, too, where there are no locks."""
    if sys.platform == "win32":
        return True
    try:
        fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as problem:
        if problem.errno in NO_LOCKS:
            return True
        if problem.errno in {errno.EWOULDBLOCK, errno.EACCES}:
            return False
        raise
    return True


def _is_at(path: Path, number: int) -> bool:
    """Whether a path still leads to an open file."""
    try:
        there, open_one = os.stat(path), os.fstat(number)
    except FileNotFoundError:
        return False
    return (there.st_dev, there.st_ino) == (open_one.st_dev, open_one.st_ino)


def _beside(target: Path, process: str) -> Path:
    """The temporary file of a process; of a long name only as much as still fits into one."""
    room = MAX_NAME_BYTES - len(f"..{process}.part")
    name = os.fsdecode(os.fsencode(target.name)[:room])
    return target.with_name(f".{name}.{process}.part")


def _remove_stale(target: Path) -> None:
    """Remove what killed processes left beside a file: temporary files that nobody holds the lock of."""
    if sys.platform == "win32":
        return
    for process in _processes_beside(target):
        beside = _beside(target, process)
        if beside.is_symlink():
            continue
        with suppress(OSError):
            number = os.open(beside, os.O_RDWR | os.O_NONBLOCK)
            try:
                fcntl.flock(number, fcntl.LOCK_EX | fcntl.LOCK_NB)
                if _is_at(beside, number):
                    beside.unlink()
            finally:
                os.close(number)


def _processes_beside(target: Path) -> list[str]:
    """Numbers of the processes whose temporary files of a target are in its folder."""
    found = []
    with suppress(OSError), os.scandir(target.parent) as entries:
        for entry in entries:
            process = entry.name.removesuffix(".part").rpartition(".")[2]
            if process.isascii() and process.isdigit() and entry.name == _beside(target, process).name:
                found.append(process)
    return found
