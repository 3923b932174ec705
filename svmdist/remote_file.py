"""Files behind URLs, read through fsspec in blocks that are kept for a while and shared by all passes of a process."""

from __future__ import annotations

import errno
import io
import os
import re
import tempfile
import weakref
from dataclasses import dataclass
from functools import lru_cache
from pathlib import PurePosixPath
from threading import Lock
from typing import Any, BinaryIO, cast
from urllib.parse import urlsplit

BLOCK_BYTES = 256 << 10
"""As large as a chunk of a recording: a chunk that is left out is not fetched, and few requests wait for each other."""
BLOCKS_KEPT = 64
FILES_KEPT = 4
URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://")
CLOUD_EXTRA = "pip install 'svmdist[cloud]'"


def is_url(text: str) -> bool:
    """Whether this is the URL of a file that is not on this machine; `file://` is on it."""
    return URL.match(text) is not None and not text.lower().startswith(("file://", "local://"))


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

    def exists(self) -> bool:
        """Whether it can be looked for, as `Path` has it; opening it says whether it is there."""
        return True

    def open(self, mode: str = "rb") -> BinaryIO:  # noqa: ARG002  (as `Path` has it)
        """Open it to read; OSError with a reason where that fails."""
        stream = _RemoteStream(_shared(self.url, os.getpid()))
        return cast(BinaryIO, io.BufferedReader(stream, BLOCK_BYTES // 4))

    def size_bytes(self) -> int:
        """Its size."""
        return _shared(self.url, os.getpid()).size_bytes

    def version(self) -> str | None:
        """What the store says that changes with the content, as an ETag; None where it says nothing."""
        filesystem, path = filesystem_of(self.url)
        with plain_errors():
            info = filesystem.info(path)
        found = next((info[key] for key in ("ETag", "etag", "md5", "checksum") if info.get(key)), None)
        return None if found is None else f"{found} {info.get('size')}"


class plain_errors:  # noqa: N801  (used as a function)
    """Turn whatever a store raises into an OSError of one line."""

    def __enter__(self) -> None:
        """Begin."""

    def __exit__(self, kind: object, problem: BaseException | None, trace: object) -> None:
        """Raise OSError in place of what was raised; interrupts and missing memory stay what they are."""
        if problem is None or not isinstance(problem, Exception) or isinstance(problem, MemoryError):
            return
        if isinstance(problem, FileNotFoundError):
            raise FileNotFoundError(errno.ENOENT, "no such file") from None
        if isinstance(problem, ImportError):
            raise OSError(
                errno.ENOSYS, f"{problem}: URLs need a package that is missing: {CLOUD_EXTRA}"
            ) from None
        said = " ".join(str(getattr(problem, "strerror", None) or problem).split()) or type(problem).__name__
        raise OSError(errno.EIO, said[:300]) from None


def filesystem_of(url: str) -> tuple[Any, str]:
    """The fsspec file system of a URL, and the path in it; OSError where there is none for its protocol."""
    try:
        import fsspec
    except ImportError:
        raise OSError(errno.ENOSYS, f"URLs need fsspec, which is not installed: {CLOUD_EXTRA}") from None
    with plain_errors():
        filesystem, path = fsspec.core.url_to_fs(url)
    return filesystem, path


def listed_urls(url: str, endings: tuple[str, ...], *, is_glob: bool) -> list[RemoteFile]:
    """The files of a glob, or those with some endings in a folder, by name; else the file itself. Raises OSError."""
    filesystem, path = filesystem_of(url)
    if not is_glob and RemoteFile(url).suffix.lower() in endings:
        return [RemoteFile(url)]
    with plain_errors():
        if is_glob:
            paths = filesystem.glob(path)
        elif filesystem.isdir(path):
            paths = filesystem.ls(path, detail=False)
        else:
            return [RemoteFile(url)]
        found = sorted(str(one) for one in paths)
        logs = [one for one in found if PurePosixPath(one).suffix.lower() in endings]
        return [RemoteFile(filesystem.unstrip_protocol(one)) for one in logs]


class _Shared:
    """One open file behind a URL, with the blocks that were asked for last."""

    def __init__(self, url: str) -> None:
        filesystem, path = filesystem_of(url)
        with plain_errors():
            # Of servers only the web's may give a file whole, whatever part is asked for.
            if url.lower().startswith(("http:", "https:")) and not filesystem.info(path).get("partial"):
                self._file = _downloaded(filesystem.open(path, "rb", block_size=0))
            else:
                kept = {"maxblocks": BLOCKS_KEPT}
                self._file = filesystem.open(
                    path, "rb", block_size=BLOCK_BYTES, cache_type="blockcache", cache_options=kept
                )
            self.size_bytes = int(self._file.seek(0, io.SEEK_END))
        self._lock = Lock()
        weakref.finalize(self, self._file.close)

    def read(self, start: int, size_bytes: int) -> bytes:
        """Read at a place; OSError where less comes than the file has."""
        with self._lock, plain_errors():
            self._file.seek(start)
            data = bytes(self._file.read(size_bytes))
            if len(data) != size_bytes:
                raise OSError(errno.EIO, f"{len(data)} bytes came of {size_bytes} at byte {start}")
        return data


def _downloaded(file: Any) -> Any:
    """A copy of a file that its server gives whole only."""
    copy = tempfile.TemporaryFile()  # noqa: SIM115  (it is closed with the blocks that are read of it)
    try:
        while piece := file.read(BLOCK_BYTES):
            copy.write(piece)
    except BaseException:
        copy.close()
        raise
    return copy


@lru_cache(FILES_KEPT)
def _shared(url: str, process: int) -> _Shared:  # noqa: ARG001  (a forked process makes its own connections)
    return _Shared(url)


class _RemoteStream(io.RawIOBase):
    """A place in a shared file."""

    def __init__(self, shared: _Shared) -> None:
        super().__init__()
        self._shared = shared
        self._position = 0

    def readable(self) -> bool:
        return True

    def seekable(self) -> bool:
        return True

    def tell(self) -> int:
        return self._position

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        origin = {io.SEEK_SET: 0, io.SEEK_CUR: self._position, io.SEEK_END: self._shared.size_bytes}[whence]
        self._position = max(origin + offset, 0)
        return self._position

    def readinto(self, buffer: Any) -> int:
        wanted = min(len(buffer), self._shared.size_bytes - self._position)
        if wanted <= 0:
            return 0
        data = self._shared.read(self._position, wanted)
        buffer[:wanted] = data
        self._position += wanted
        return wanted
