"""Files: regular ones to read, and outputs that get their name when they are complete."""

from __future__ import annotations

import codecs
import errno
import io
import os
import re
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import IO, BinaryIO, cast

from svmdist.errors import OutputError, SvmdistError
from svmdist.remote import LogPath, RemoteFile

BAD_CHARACTER = "the path has a character that no path can have"
NAME_BYTES = 255 - len("..part")  # nearly every file system allows 255 bytes for a name
ASCII = str.maketrans(
    dict(zip("─–—−µ×’“”\N{REPLACEMENT CHARACTER}", '----ux\'""?', strict=True))
    | {"…": "...", "±": "+-", "°": " deg", "²": "2", "³": "3", "≥": ">=", "≤": "<=", "→": "->"}
)
COLLAPSED_URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+:/")  # as a Path has it; C:/ is a drive
FALLBACK = "svmdist.fallback"  # for `errors=` of a text stream: writing never fails for want of a character


def _fall_back(problem: UnicodeError) -> tuple[str | bytes, int]:
    """Replace characters that an encoding does not have by similar ones in ASCII, else by question marks."""
    if not isinstance(problem, UnicodeEncodeError):
        raise problem
    lost = problem.object[problem.start : problem.end]
    # A surrogate is a byte of a file's name that is not UTF-8; UTF-8 has a character for what cannot be read.
    if problem.encoding.lower().replace("_", "-") in {"utf-8", "utf8"}:
        return "\N{REPLACEMENT CHARACTER}".encode() * len(lost), problem.end
    return "".join(c if c.isascii() else "?" for c in lost.translate(ASCII)), problem.end


codecs.register_error(FALLBACK, _fall_back)


def why(problem: OSError | ValueError) -> str:
    """What was wrong with a file, without its name, in a few words; of a missing one also the nearest name there."""
    missing = isinstance(problem, FileNotFoundError) and problem.filename
    return f"{getattr(problem, 'strerror', None) or problem}{nearest_file(missing) if missing else ''}"


def nearest_file(path: str | bytes | os.PathLike[str]) -> str:
    """What a file that is not there may be instead, as the end of a sentence; empty where nothing is alike."""
    from difflib import get_close_matches

    path = os.fsdecode(path)
    if COLLAPSED_URL.match(path):
        return ": a URL, which only logs may be; fetch the file first"
    if os.path.islink(path):
        return f": it is a link to {os.readlink(path)}"
    folder, name = os.path.split(os.path.abspath(path))
    if not os.path.isdir(folder):
        return f": there is no folder {folder}"
    with suppress(OSError):
        if near := get_close_matches(name, os.listdir(folder), n=1, cutoff=0.8):
            return f": did you mean {os.path.join(os.path.dirname(path), near[0])}?"
    return ""


@contextmanager
def reading(path: LogPath, error: type[SvmdistError], what: str = "") -> Iterator[None]:
    """Turn an OSError into an error of one line that names the file."""
    try:
        yield
    except OSError as problem:
        raise error(f"{path}: cannot read{what}: {why(problem)}") from None


def open_regular(path: LogPath) -> BinaryIO:
    """Open a regular file, or one behind a URL, to read; OSError with a reason where that cannot be done."""
    if isinstance(path, RemoteFile):
        return path.open()
    # Without waiting, and checked when open: a pipe may have no writer, and a path can lead elsewhere a moment later.
    try:
        file = open(path, "rb", opener=lambda name, flags: os.open(name, flags | getattr(os, "O_NONBLOCK", 0)))  # noqa: SIM115
    except ValueError:  # NUL; no other character is impossible in a path
        raise OSError(errno.EINVAL, BAD_CHARACTER) from None
    if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
        file.close()
        raise OSError(errno.EINVAL, "it is no regular file")
    return file


def read_regular(path: Path, limit_bytes: int) -> bytes:
    """Read a whole regular file; OSError with a reason where it is none, cannot be read, or is above the limit."""
    with open_regular(path) as file:
        data = file.read(limit_bytes + 1)
    if len(data) > limit_bytes:
        raise OSError(errno.EFBIG, f"it has more than {limit_bytes} bytes, the limit")
    return data


def files_of(path: LogPath) -> list[LogPath]:
    """A file, or the files of a folder in the order of their names."""
    if isinstance(path, RemoteFile) or not path.is_dir():
        return [path]
    return [*sorted(file for file in path.iterdir() if file.is_file())]


def make_folder(folder: Path, what: str) -> None:
    """Make a folder unless it is there; raises OutputError, which says `what` cannot be done without it."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as problem:
        raise OutputError(f"{folder}: cannot {what}: {why(problem)}") from None


@contextmanager
def atomic_file(path: Path) -> Iterator[BinaryIO]:
    """Give a temporary file beside `path`, renamed to `path` when the block ends, and removed when it fails.

    A device, a pipe, and a file in a folder without new files are written in place. Raises OutputError.
    """
    try:
        mode = None
        try:
            target = Path(os.path.realpath(path))  # a link stays a link
            with suppress(FileNotFoundError):
                mode = os.stat(path).st_mode
        except ValueError:
            raise OSError(errno.EINVAL, BAD_CHARACTER) from None
        if (mode is not None and not stat.S_ISREG(mode)) or not os.access(target.parent, os.W_OK):
            with open(path, "wb") as file:  # by this name: that of a pipe leads nowhere
                yield file
            return
        beside = target.with_name(f".{os.fsdecode(os.fsencode(target.name)[:NAME_BYTES])}.part")
        beside.unlink(missing_ok=True)  # what a killed process left
        try:
            with open(beside, "xb") as file:  # which follows no link that somebody has put there
                if mode is not None:
                    beside.chmod(stat.S_IMODE(mode))
                yield file
            beside.replace(target)
        finally:
            beside.unlink(missing_ok=True)
    except OSError as problem:
        raise OutputError(f"{path}: cannot write: {why(problem)}") from None


def write_atomically(path: Path, lines: Iterable[str]) -> None:
    """Write text atomically, in UTF-8 and with its own line ends; raises OutputError where that fails."""
    with atomic_file(path) as part, io.TextIOWrapper(cast(IO[bytes], part), "utf-8", FALLBACK, newline="") as file:
        file.writelines(lines)
