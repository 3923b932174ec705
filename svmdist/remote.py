"""Files behind URLs: found, listed and read by fsspec, with errors of one line that show no secrets."""

from __future__ import annotations

import errno
import io
import os
import re
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache, partial
from pathlib import Path, PurePosixPath
from threading import Thread
from typing import Any, BinaryIO, TypeVar, cast
from urllib.parse import quote, unquote, urlsplit
from weakref import finalize

from svmdist.errors import QUERY, USER, concealed

Answer = TypeVar("Answer")

ANSWER_S = 20.0  # a server that sends nothing for so long is taken for dead
LEAST_BYTES_PER_S = 50e3  # a piece of a file may take the longer, the larger it is
BLOCK_BYTES = 256 << 10  # a chunk of a recording: one that is left out is not fetched
FILES_KEPT = 4
# Characters; shorter ones stand in other words, and number versions and pages.
LEAST_PASSWORD, LEAST_VALUE = 3, 6
URL = re.compile(r"[A-Za-z][A-Za-z0-9+.-]+://")
PARTS = re.compile(r"([^:/]*):/*([^/]*)(.*)", re.DOTALL)  # of any text: urlsplit refuses some
BEFORE_GLOB = re.compile(r"((?:https?://)?[^/]*(?:/[^*?\[/]*(?=/))*)/")


def is_url(text: str) -> bool:
    """Whether this is the URL of a file that is not on this machine; `file://` is on it."""
    return URL.match(text) is not None and not text.lower().startswith(("file://", "local://"))


@contextmanager
def plain_errors(url: str) -> Iterator[None]:
    """Turn whatever a store raises into an OSError of one line, without the secrets of a URL."""
    try:
        yield
    except MemoryError:
        raise
    except ImportError as problem:
        reason = f"{problem}: URLs need a package that is missing: pip install 'svmdist[cloud]'"
        raise OSError(errno.ENOSYS, reason) from None
    except Exception as problem:
        found = problem
        if isinstance(problem, FileNotFoundError):
            # For fsspec whatever a web server does not give is not found; a store's own answer has a `response`.
            cause = problem.__cause__
            if cause is None or hasattr(cause, "response") or getattr(cause, "status", 0) in (404, 410):
                raise FileNotFoundError(errno.ENOENT, "no such file") from None
            found = cast(Exception, cause)
        if status := getattr(found, "status", None):
            reason = f"{status} {getattr(found, 'message', '')}"
        elif isinstance(found, TimeoutError):
            reason = f"no answer within {ANSWER_S:.0f} s"
        else:
            reason = getattr(found, "strerror", None) or str(found)
        reason = without_secrets(" ".join(reason.split()), url)[:300] or type(found).__name__
        raise OSError(errno.EIO, reason) from None


def without_secrets(text: str, url: str) -> str:
    """What others say of a URL, without what must not be shown of it, however they write it."""
    found = [user[0].lstrip("/").removesuffix("@") for user in USER.finditer(url)]
    found += [user.partition(":")[2] for user in found]
    for _, query in QUERY.findall(url):
        values = [part.partition("=")[2] for part in re.split("[&#]", query[1:])]
        found += [query[1:], *(value for value in values if len(value) >= LEAST_VALUE)]
    every = {form for one in found for form in (one, quote(one), quote(one, safe=""), unquote(one))}
    for secret in sorted(every, key=len, reverse=True):
        text = text.replace(secret, "***") if len(secret) >= LEAST_PASSWORD else text
    return concealed(text)


def _answered(ask: Callable[..., Answer], *arguments: Any, size_bytes: int = 0) -> Answer:
    """What a store answers; TimeoutError where it does not in time, whatever retries it makes by itself."""
    answer: Future[Answer] = Future()

    def wait() -> None:
        try:
            answer.set_result(ask(*arguments))
        except BaseException as problem:
            answer.set_exception(problem)

    Thread(target=wait, daemon=True).start()
    return answer.result(ANSWER_S + size_bytes / LEAST_BYTES_PER_S)


def filesystem_of(url: str) -> tuple[Any, str]:
    """The fsspec file system of a URL, and the path in it; OSError where there is none for its protocol."""
    with plain_errors(url):
        import fsspec

        protocol = url.partition(":")[0].lower()
        # Not by `url_to_fs`, which takes the `::` of an IPv6 address for its own.
        if protocol in {"http", "https"}:
            from aiohttp import ClientTimeout

            _ = urlsplit(url).port  # ValueError says what is wrong with an address
            # A large file may take longer than aiohttp allows by itself.
            timeout = ClientTimeout(total=None, connect=ANSWER_S, sock_read=ANSWER_S)
            given = fsspec.config.conf.get(protocol, {}).get("client_kwargs", {})
            return fsspec.filesystem(protocol, client_kwargs={"timeout": timeout, **given}), url
        if re.search(r"s3[an]?:/", url) and USER.search(url):
            keys = "AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY"
            raise OSError(errno.EACCES, f"S3 takes no key in a URL: set {keys}")
        filesystem, path = fsspec.core.url_to_fs(url, **({"timeout": ANSWER_S} if protocol == "ftp" else {}))
    return filesystem, path


@dataclass(frozen=True, slots=True, repr=False)
class RemoteFile:
    """A file behind a URL, where others take a `Path`."""

    url: str

    @property
    def name(self) -> str:
        """The last part of its path."""
        return PurePosixPath(self.parts[2]).name or str(self)

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
        return (self.parts[1], *PurePosixPath(self.parts[2]).parent.parts[1:])

    @property
    def parts(self) -> tuple[str, str, str]:
        """Protocol, host or bucket, and path."""
        return cast(tuple[str, str, str], PARTS.findall(str(self))[0])

    def __str__(self) -> str:
        """The URL without user, password and query, which may be secrets."""
        return concealed(self.url)

    __repr__ = __str__

    def open(self, mode: str = "rb") -> BinaryIO:
        """Open it to read; OSError of one line where that, or reading later, fails."""
        filesystem, path = filesystem_of(self.url)
        with plain_errors(self.url):
            # Of servers only the web's may give a file whole, whatever part is asked for.
            is_web = self.url.lower().startswith(("http:", "https:"))
            if is_web and not _answered(filesystem.info, path).get("partial"):
                return open(_copy_of(self.url, os.getpid()).path, "rb")
            file = _answered(partial(filesystem.open, path, mode, block_size=BLOCK_BYTES, cache_type="blockcache"))
            if isinstance(file, io.BytesIO):  # of a store in memory, which has one position for all readers
                return io.BytesIO(file.getvalue())
            if fetch := getattr(getattr(file, "cache", None), "fetcher", None):
                file.cache.fetcher = lambda start, end: self._fetched(fetch, start, min(end, file.size))
        return cast(BinaryIO, file)

    def _fetched(self, fetch: Callable[[int, int], Any], start: int, end: int) -> bytes:
        with plain_errors(self.url):
            data = bytes(_answered(fetch, start, end, size_bytes=end - start))
            if len(data) != end - start:
                raise OSError(errno.EIO, f"{len(data)} bytes came of {end - start} at byte {start}")
        return data

    def size_bytes(self) -> int:
        """Its size."""
        with self.open() as file:
            return file.seek(0, io.SEEK_END)

    def version(self) -> str | None:
        """What the store says that changes with the content, as an ETag; None where it says nothing."""
        filesystem, path = filesystem_of(self.url)
        with plain_errors(self.url):
            info = _answered(filesystem.info, path)
        found = next((info[key] for key in ("ETag", "etag", "md5", "checksum") if info.get(key)), None)
        return None if found is None else f"{found} {info.get('size')}"


LogPath = Path | RemoteFile  # where a log may be: a file or folder, or a URL


@dataclass(frozen=True, slots=True, weakref_slot=True)
class _Copy:
    """A copy of a file, by the path to open it by; it goes with this."""

    path: str


@lru_cache(FILES_KEPT)
def _copy_of(url: str, process: int) -> _Copy:  # noqa: ARG001  (each process has its own connections)
    """A copy of a file that its server gives whole only."""
    filesystem, path = filesystem_of(url)
    kept: Any
    if sys.platform == "linux":  # without a name: nothing is left of it when the process is killed
        kept = tempfile.TemporaryFile()  # noqa: SIM115
        copied = _Copy(f"/proc/self/fd/{kept.fileno()}")
        finalize(copied, kept.close)
    else:
        kept = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        copied = _Copy(os.path.join(kept.name, "copy"))
        finalize(copied, kept.cleanup)
    with filesystem.open(path, "rb", block_size=0) as file, open(copied.path, "wb") as copy:
        shutil.copyfileobj(file, copy, BLOCK_BYTES)
    return copied


def listed_urls(url: str, endings: tuple[str, ...], *, is_glob: bool) -> list[RemoteFile]:
    """The files of a glob, or those with some endings in a folder, by name; else the file itself. Raises OSError."""
    filesystem, path = filesystem_of(url)
    with plain_errors(url):
        if is_glob:
            folder = BEFORE_GLOB.match(path)
            with suppress(FileNotFoundError):  # whether it answers: a long listing may take its time
                _answered(filesystem.isdir, folder[1] if folder else path)
            paths = filesystem.glob(path)
        elif RemoteFile(url).suffix.lower() not in endings and _answered(filesystem.isdir, path):
            paths = filesystem.ls(path, detail=False)
        else:
            return [RemoteFile(url)]
        logs = sorted(str(one) for one in paths if PurePosixPath(str(one)).suffix.lower() in endings)
        return [RemoteFile(filesystem.unstrip_protocol(one)) for one in logs]
