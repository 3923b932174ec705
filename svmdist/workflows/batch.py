"""Many logs, each measured by itself: here, in processes, or on a cluster, with results kept for another run."""

from __future__ import annotations

import hashlib
import json
import logging
import pickle
import re
import threading
import time
import traceback
import zlib
from collections import Counter
from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import CancelledError
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from functools import partial
from importlib.metadata import version
from pathlib import Path
from typing import Any, Generic, TypeVar

from pydantic import Base64Bytes, TypeAdapter

from svmdist.errors import ProfileError, SvmdistError, UsageError, optional_package
from svmdist.files import files_of, make_folder, write_atomically
from svmdist.recording.source import Health, Loss
from svmdist.remote import LogPath, RemoteFile, without_secrets
from svmdist.workflows.parallel import Progress, each_in_processes, one_opencv_thread, unwatched, usable_cores
from svmdist.workflows.request import LOG, Request

Result = TypeVar("Result")

ATTEMPTS = 2  # a log whose process is killed is measured once more: it may have been another that took the memory
MAX_REPEATED = 3  # logs with the same note, each of which says it


@dataclass(frozen=True, slots=True)
class LogFile:
    """A log to measure, and the name that it goes by."""

    path: LogPath
    name: str


@dataclass(frozen=True)
class Job(Generic[Result]):
    """What is done with each log; it travels between processes, and results depend on nothing else but the log."""

    measure: Callable[..., Any]
    """Gives a result of (recording, request, threads, *options); a generator yields rows, and returns the result."""
    request: Request
    result_type: type[Result]  # a dataclass that pydantic can store
    options: tuple[Any, ...] = ()


@dataclass(frozen=True)
class Outcome(Generic[Result]):
    """What came of a log: a result, or why there is none: the others are measured all the same."""

    result: Result | None
    failure: str | None = None
    losses: tuple[Loss, ...] = ()
    unlisted_count: int = 0  # of losses
    metadata: dict[str, str] = field(default_factory=dict)
    notes: tuple[tuple[int, str], ...] = ()  # level and text
    packed_rows: Base64Bytes = b""  # as it is stored

    @property
    def health(self) -> Health:
        """What was lost while the log was read."""
        health = Health(self.unlisted_count)
        for loss in self.losses:
            health.add(loss)
        return health

    def rows(self) -> Iterator[dict[str, Any]]:
        """The rows of the log; values that do not exist are left out."""
        return map(json.loads, zlib.decompress(self.packed_rows).splitlines())


def measured(
    job: Job[Result], log: LogFile, threads: int, on_progress: Progress = unwatched, **more: Any
) -> Generator[Mapping[str, Any], None, Outcome[Result]]:
    """Measure a log in this process: yield its rows, return its outcome. Raises what measuring it raises."""
    recording = replace(job.request.open(log.path, log.name), on_progress=on_progress)
    found = job.measure(recording, job.request, threads, *job.options, **more)
    result = (yield from found) if isinstance(found, Generator) else found
    return Outcome(result, None, recording.health.losses, recording.health.unlisted_count, dict(recording.metadata))


def outcome_of(job: Job[Result], threads: int, log: LogFile) -> Outcome[Result]:
    """Measure a log, and keep its rows and remarks; what goes wrong with every log is raised, else its outcome."""
    packer, packed = zlib.compressobj(1), b""
    steps = measured(job, log, threads)
    with collected_notes() as notes, one_opencv_thread():
        try:
            while True:
                row = {key: value for key, value in next(steps).items() if value is not None}
                packed += packer.compress(json.dumps(row, separators=(",", ":")).encode() + b"\n")
        except StopIteration as end:
            return replace(end.value, notes=tuple(notes), packed_rows=packed + packer.flush())
        except (UsageError, ProfileError):
            raise
        except SvmdistError as problem:
            return Outcome(None, str(problem))
        except MemoryError:
            return Outcome(None, "there is not enough memory")
        except Exception as problem:  # a fault of svmdist's own, or of the machine
            last, said = traceback.extract_tb(problem.__traceback__)[-1], " ".join(str(problem).split())
            what = f"{type(problem).__name__}: {said} ({Path(last.filename).name}:{last.lineno})"
            return Outcome(None, f"svmdist failed on it, please report this: {what}")


@contextmanager
def collected_notes() -> Iterator[list[tuple[int, str]]]:
    """Collect what this thread logs, in place of printing it: the remarks on a log travel with its outcome."""
    notes: list[tuple[int, str]] = []
    thread, level = threading.get_ident(), LOG.level

    def collect(record: logging.LogRecord) -> bool:
        if record.thread == thread:
            notes.append((record.levelno, record.getMessage()))
        return record.thread != thread

    LOG.addFilter(collect)
    LOG.setLevel(logging.DEBUG)
    try:
        yield notes
    finally:
        LOG.removeFilter(collect)
        LOG.setLevel(level)


def log_notes(outcomes: Sequence[Outcome[Any]]) -> None:
    """Log what was noted on logs; what is true of more than a few is said once."""
    counts = Counter(note for one in outcomes for note in dict.fromkeys(one.notes))
    for (level, text), count in counts.items():
        if count > MAX_REPEATED:
            LOG.log(level, "%s (so in %d logs)", text, count)
    for level, text in (note for one in outcomes for note in one.notes if counts[note] <= MAX_REPEATED):
        LOG.log(level, "%s", text)


def measure_logs(
    job: Job[Result],
    logs: Sequence[LogFile],
    jobs: int | None = None,
    scheduler: str | None = None,
    folder: Path | None = None,
    on_progress: Progress = unwatched,
) -> list[Outcome[Result]]:
    """Measure logs by `jobs` processes, or by the cluster of a scheduler; their outcomes are the same.

    `folder` keeps results for another run with the same request. Raises what ends all work: UsageError and
    ProfileError, OutputError where results cannot be kept, SvmdistError where the cluster is lost.
    """
    store = None if folder is None else _Store(folder, job)
    found = {log: known for log in logs if store and (known := store.load(log))}
    if store is not None and len(logs) > 1:
        LOG.info("%d of %d logs are done", len(found), len(logs))
    on_progress(len(found), len(logs))
    left = [log for log in logs if log not in found]
    if scheduler is not None and left:
        ended = measured_on_cluster(partial(outcome_of, job, 1), left, scheduler)
    else:
        jobs = usable_cores() if jobs is None else jobs
        in_memory = any(isinstance(log.path, RemoteFile) and log.path.url.startswith("memory:") for log in left)
        workers = 1 if in_memory else max(1, min(jobs, len(left)))  # what is in a process's memory is its own
        killed = Outcome[Result](None, f"its process was killed, perhaps for want of memory, {ATTEMPTS} times")
        work = partial(outcome_of, job, max(1, jobs // workers))
        ended = each_in_processes(work, left, workers, attempts=ATTEMPTS, died=killed)
    for at, outcome in ended:
        found[left[at]] = outcome
        if store is not None and outcome.failure is None:
            store.save(left[at], outcome)
        on_progress(len(found), len(logs))
    return [found[log] for log in logs]


class _Store:
    """A folder of results: one document per log, by request, name and path; valid while the log is the same."""

    def __init__(self, folder: Path, job: Job[Any]) -> None:
        self._folder = folder
        self._outcomes = TypeAdapter(Outcome[job.result_type])  # type: ignore[name-defined]
        # All that results depend on beside the log; files that the profile names count by size and time.
        named = _paths_in(job.request.setup.profile.model_dump())
        files = [[str(path), _identity(path)] for path in named if path.is_file()]
        said = (version("svmdist"), job.measure.__module__, job.measure.__qualname__, job.request, job.options)
        self._request = _hashed(repr((said, files)))
        make_folder(folder, "keep results there")

    def _place(self, log: LogFile) -> Path:
        path = log.path.url if isinstance(log.path, RemoteFile) else str(log.path.absolute())
        stem = re.sub(r"[^A-Za-z0-9._-]+", "-", log.name).strip(".-")[-80:] or "log"
        key = _hashed(f"{self._request}\0{log.name}\0{path}")
        return self._folder / f"{stem}-{key[:24]}.json"

    def save(self, log: LogFile, outcome: Outcome[Any]) -> None:
        stored = self._outcomes.dump_python(outcome, mode="json")
        document = {"request": self._request, "log": _identity(log.path), "outcome": stored}
        write_atomically(self._place(log), [json.dumps(document) + "\n"])

    def load(self, log: LogFile) -> Outcome[Any] | None:
        """Read an outcome; None where it is not there or not whole, or the log has changed since."""
        try:
            document = json.loads(self._place(log).read_bytes())
            if (document["request"], document["log"]) != (self._request, _identity(log.path)):
                return None
            found: Outcome[Any] = self._outcomes.validate_json(json.dumps(document["outcome"]))
            sum(1 for _ in found.rows())
        except (OSError, ValueError, KeyError, TypeError, zlib.error):
            return None
        return found


def _identity(path: LogPath) -> list[list[Any]]:
    """Size and time of change of the files of a log; of one behind a URL what its store says of it."""
    if isinstance(path, RemoteFile):
        return [[path.size_bytes(), path.version()]]
    files = [file for file in files_of(path) if isinstance(file, Path)]
    return [[file.name, (stat := file.stat()).st_size, stat.st_mtime_ns] for file in files]


def _hashed(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "replace")).hexdigest()


def _paths_in(value: object) -> list[Path]:
    inner = value.values() if isinstance(value, Mapping) else value if isinstance(value, list | tuple) else ()
    return [value] if isinstance(value, Path) else [path for item in inner for path in _paths_in(item)]


CONNECT_S, LOOK_S = 10.0, 0.25


def measured_on_cluster(
    measure: Callable[[LogFile], Outcome[Result]], logs: Sequence[LogFile], address: str
) -> Iterator[tuple[int, Outcome[Result]]]:
    """Yield (place, outcome) of logs as they end, read by the same paths; SvmdistError where the cluster is lost."""
    distributed = optional_package("distributed", "cluster", "--scheduler", UsageError)
    client = _connected(address)
    try:
        packed = [pickle.dumps((measure, log)) for log in logs]  # the scheduler need not know what is measured
        futures = client.map(measure_on_worker, packed, expected=version("svmdist"), pure=False, retries=1)
        places = {future.key: place for place, future in enumerate(futures)}
        for future in distributed.as_completed(futures, loop=client.loop):
            try:
                yield places[future.key], future.result()  # one that its worker took along is measured again
            except distributed.KilledWorker:
                yield places[future.key], Outcome(None, "the workers that measured it were lost, every one")
            except (CancelledError, OSError):
                lost = f"the scheduler {address} is lost; --resume keeps the results of logs that ended"
                raise SvmdistError(lost) from None
    finally:
        with suppress(Exception):
            client.close(timeout=2)


def measure_on_worker(packed: bytes, expected: str) -> Any:
    """Run on a worker: measure a log."""
    if (own := version("svmdist")) != expected:
        raise SvmdistError(f"a worker has svmdist {own}, here it is {expected}; install the same on both")
    measure, log = pickle.loads(packed)
    return measure(log)


def _connected(address: str) -> Any:
    """A client of the scheduler, once there are workers; SvmdistError where it does not answer in time."""
    from distributed import Client
    from distributed.comm.addressing import get_address_host_port

    for name in ("distributed", "distributed.client", "tornado.application", "asyncio"):  # they print what is handled
        logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        get_address_host_port(address)  # a client of a wrong one could not be closed
        client: Any = Client(address, timeout=f"{CONNECT_S}s", set_as_default=False)
    except ValueError as problem:
        reason = without_secrets(str(problem), address)
        raise UsageError(f"--scheduler {address}: {reason}; expected one as in tcp://host:8786") from None
    except OSError as problem:
        reason = without_secrets(" ".join(str(problem).split()), address)
        raise SvmdistError(f"--scheduler {address}: cannot connect: {reason}") from None
    end_s = time.monotonic() + CONNECT_S
    while not client.nthreads():
        if time.monotonic() > end_s:
            client.close(timeout=2)
            raise SvmdistError(f"--scheduler {address}: it has no worker")
        LOG.debug("the cluster %s has no worker: waiting for one", address)
        time.sleep(LOOK_S)
    return client
