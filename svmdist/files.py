"""Files: regular ones to read, those behind URLs, and outputs that get their name when they are complete."""

from __future__ import annotations

import codecs
import errno
import io
import os
import re
import shutil
import stat
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path, PurePosixPath
from typing import Any, BinaryIO, cast
from urllib.parse import urlsplit

from svmdist.errors import OutputError

BLOCK_BYTES = 256 << 10  # a chunk of a recording: one that is left out is not fetched
FILES_KEPT = 4
URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://")
CLOUD_EXTRA = "pip install 'svmdist[cloud]'"
BAD_CHARACTER = "the path has a character that no path can have"
NAME_BYTES = 255 - len("..part")  # nearly every file system allows 255 bytes for a name
ASCII = str.maketrans(
    dict(zip("─–—−µ×’“”\N{REPLACEMENT CHARACTER}", '----ux\'""?', strict=True))
    | {"…": "...", "±": "+-", "°": " deg", "²": "2", "³": "3", "≥": ">=", "≤": "<=", "→": "->"}
)
FALLBACK = "svmdist.fallback"
"""For `errors=` of a text stream: writing never fails for want of a character."""


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


def is_url(text: str) -> bool:
    """Whether this is the URL of a file that is not on this machine; `file://` is on it."""
    return URL.match(text) is not None and not text.lower().startswith(("file://", "local://"))


def why(problem: OSError | ValueError) -> str:
    """What was wrong with a file, without its name, in a few words."""
    return str(getattr(problem, "strerror", None) or problem)


@contextmanager
def plain_errors() -> Iterator[None]:
    """Turn whatever a store raises into an OSError of one line."""
    try:
        yield
    except MemoryError:
        raise
    except FileNotFoundError:
        raise FileNotFoundError(errno.ENOENT, "no such file") from None
    except ImportError as problem:
        reason = f"{problem}: URLs need a package that is missing: {CLOUD_EXTRA}"
        raise OSError(errno.ENOSYS, reason) from None
    except Exception as problem:
        reason = getattr(problem, "strerror", None) or str(problem)
        raise OSError(errno.EIO, " ".join(reason.split())[:300] or type(problem).__name__) from None


def filesystem_of(url: str) -> tuple[Any, str]:
    """The fsspec file system of a URL, and the path in it; OSError where there is none for its protocol."""
    with plain_errors():
        import fsspec

        filesystem, path = fsspec.core.url_to_fs(url)
    return filesystem, path


@dataclass(frozen=True, slots=True)
class RemoteFile:
    """A file behind a URL, where others take a `Path`."""

    url: str

    @property
    def name(self) -> str:
        """The last part of its path."""
        return PurePosixPath(urlsplit(self.url).path).name or self.url

    @property
    def stem(self) -> str:
        """The name without its ending."""
        return PurePosixPath(self.name).stem

    @property
    def suffix(self) -> str:
        """The ending, with its dot."""
        return PurePosixPath(self.name).suffix

    @property
    def folders(self) -> tuple[str, ...]:
        """The host or bucket, and the folders below it."""
        parts = urlsplit(self.url)
        return (parts.netloc, *PurePosixPath(parts.path).parent.parts[1:])

    def __str__(self) -> str:
        """The URL without user, password and query, which may be secrets."""
        parts = urlsplit(self.url)
        return f"{parts.scheme}://{parts.netloc.rpartition('@')[2]}{parts.path}"

    def open(self, mode: str = "rb") -> BinaryIO:
        """Open it to read; OSError of one line where that, or reading later, fails."""
        filesystem, path = filesystem_of(self.url)
        with plain_errors():
            # Of servers only the web's may give a file whole, whatever part is asked for.
            if self.url.lower().startswith(("http:", "https:")) and not filesystem.info(path).get("partial"):
                return open(_copy_of(self.url, os.getpid())[1], "rb")
            file = filesystem.open(path, mode, block_size=BLOCK_BYTES, cache_type="blockcache")
            if isinstance(file, io.BytesIO):  # of a store in memory, which has one position for all readers
                return io.BytesIO(file.getvalue())
            if fetch := getattr(getattr(file, "cache", None), "fetcher", None):
                file.cache.fetcher = lambda start, end: _fetched(fetch, start, min(end, file.size))
        return cast(BinaryIO, file)

    def size_bytes(self) -> int:
        """Its size."""
        with self.open() as file:
            return file.seek(0, io.SEEK_END)

    def version(self) -> str | None:
        """What the store says that changes with the content, as an ETag; None where it says nothing."""
        filesystem, path = filesystem_of(self.url)
        with plain_errors():
            info = filesystem.info(path)
        found = next((info[key] for key in ("ETag", "etag", "md5", "checksum") if info.get(key)), None)
        return None if found is None else f"{found} {info.get('size')}"


LogPath = Path | RemoteFile
"""Where a log may be: a file or folder, or a URL."""


def _fetched(fetch: Any, start: int, end: int) -> bytes:
    """A piece of a file, fetched by fsspec; OSError where less comes than the file has."""
    with plain_errors():
        data = bytes(fetch(start, end))
        if len(data) != end - start:
            raise OSError(errno.EIO, f"{len(data)} bytes came of {end - start} at byte {start}")
    return data


@lru_cache(FILES_KEPT)
def _copy_of(url: str, process: int) -> tuple[Any, str]:  # noqa: ARG001  (each process has its own connections)
    """A copy of a file that its server gives whole only: what keeps it, and the path to open it by."""
    filesystem, path = filesystem_of(url)
    kept: Any
    if sys.platform == "linux":  # without a name: nothing is left of it when the process is killed
        kept = tempfile.TemporaryFile()  # noqa: SIM115
        name = f"/proc/self/fd/{kept.fileno()}"
    else:
        kept = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        name = os.path.join(kept.name, "copy")
    with filesystem.open(path, "rb", block_size=0) as file, open(name, "wb") as copy:
        shutil.copyfileobj(file, copy, BLOCK_BYTES)
    return kept, name


def listed_urls(url: str, endings: tuple[str, ...], *, is_glob: bool) -> list[RemoteFile]:
    """The files of a glob, or those with some endings in a folder, by name; else the file itself. Raises OSError."""
    filesystem, path = filesystem_of(url)
    with plain_errors():
        if is_glob:
            paths = filesystem.glob(path)
        elif RemoteFile(url).suffix.lower() not in endings and filesystem.isdir(path):
            paths = filesystem.ls(path, detail=False)
        else:
            return [RemoteFile(url)]
        logs = sorted(str(one) for one in paths if PurePosixPath(str(one)).suffix.lower() in endings)
        return [RemoteFile(filesystem.unstrip_protocol(one)) for one in logs]


def open_regular(path: LogPath) -> BinaryIO:
    """Open a regular file, or one behind a URL, to read; OSError with a reason where that cannot be done."""
    # Without waiting, and checked when open: a pipe may have no writer, and a path can lead elsewhere a moment later.
    if isinstance(path, RemoteFile):
        return path.open()
    try:
        number = os.open(path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0))
    except ValueError:  # NUL; no other character is impossible in a path
        raise OSError(errno.EINVAL, BAD_CHARACTER) from None
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


def files_of(path: LogPath) -> list[LogPath]:
    """A file, or the files of a folder in the order of their names."""
    if isinstance(path, RemoteFile) or not path.is_dir():
        return [path]
    return [*sorted(file for file in path.iterdir() if file.is_file())]


@contextmanager
def atomic_file(path: Path) -> Iterator[Path]:
    """Give a temporary path beside `path`, renamed to `path` when the block ends, and removed when it fails.

    A device, a pipe, and a file in a folder without new files are written in place. Raises OutputError.
    """
    try:
        mode = None
        try:
            target = Path(os.path.realpath(path))  # a link stays a link
            with suppress(FileNotFoundError):
                mode = os.stat(target).st_mode
        except ValueError:
            raise OSError(errno.EINVAL, BAD_CHARACTER) from None
        if (mode is not None and not stat.S_ISREG(mode)) or not os.access(target.parent, os.W_OK):
            yield target
            return
        beside = target.with_name(f".{os.fsdecode(os.fsencode(target.name)[:NAME_BYTES])}.part")
        beside.unlink(missing_ok=True)  # what a killed process left
        try:
            yield beside
            if mode is not None:
                beside.chmod(stat.S_IMODE(mode))
            beside.replace(target)
        finally:
            beside.unlink(missing_ok=True)
    except OSError as problem:
        raise OutputError(f"{path}: cannot write: {why(problem)}") from None


def write_atomically(path: Path, lines: Iterable[str]) -> None:
    """Write text atomically, in UTF-8 and with its own line ends; raises OutputError where that fails."""
    with atomic_file(path) as part, part.open("w", encoding="utf-8", errors=FALLBACK, newline="") as file:
        file.writelines(lines)
