"""A Dask cluster that measures logs, a task each. What a lost worker or a lost scheduler was at is given out again."""

from __future__ import annotations

import logging
import pickle
import tempfile
import time
import zlib
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from svmdist.errors import SvmdistError, UsageError
from svmdist.files import atomic_file
from svmdist.workflows.batch.identity import code_version
from svmdist.workflows.batch.pool import ATTEMPTS, Task
from svmdist.workflows.batch.task import LogFile, LogJob, Stored, failed, measure_log
from svmdist.workflows.parallel import one_opencv_thread

CONNECT_S = 10.0
RETURN_S = 120.0
"""A scheduler that is gone, and workers that are, may take so long to come back."""
LOOK_S = 0.25
TASKS_PER_THREAD = 2
"""Logs that are given out for each thread of the cluster: one is measured, one waits."""

Say = Callable[[str], None]
Waiting = tuple[Task, int]


def measured_on_cluster(
    job: LogJob[Any], tasks: Sequence[Task], address: str, say: Say
) -> Iterator[tuple[Task, Stored]]:
    """Yield tasks with their outcomes as they end; their rows are written here.

    Workers read the logs by the paths and URLs that they have here, and run the same svmdist. Raises SvmdistError where
    the scheduler does not answer, or does not come back.
    """
    waiting: deque[Waiting] = deque((task, 0) for task in tasks)
    client = _connected(address, CONNECT_S, say)
    try:
        while waiting:
            yield from _until_lost(client, job, waiting)
            if waiting:
                _put_away(client)
                say(
                    f"the scheduler {address} is gone: {len(waiting)} logs are given out again when it is back"
                )
                client = _connected(address, RETURN_S, say)
    finally:
        _put_away(client)


def _until_lost(client: Any, job: LogJob[Any], waiting: deque[Waiting]) -> Iterator[tuple[Task, Stored]]:
    """Measure until all is done or the scheduler is lost; `waiting` then has what is left."""
    given: dict[Any, Waiting] = {}
    packed = pickle.dumps(job)
    try:
        while waiting or given:
            _give(client, packed, waiting, given)
            done = [future for future in given if future.status != "pending"]
            if not done:
                if client.status != "running":
                    return
                time.sleep(LOOK_S if len(given) > 1 else LOOK_S / 5)
            for future in done:
                if future.status not in {"finished", "error"}:  # lost or cancelled: its scheduler was
                    return
                found = _result(future)
                task, attempt = given.pop(future)
                if found is not None:
                    stored, rows = found
                    with atomic_file(task.rows) as target:
                        target.write_bytes(zlib.decompress(rows))
                    yield task, stored
                elif attempt + 1 < ATTEMPTS:
                    waiting.append((task, attempt + 1))
                else:
                    yield task, failed("the workers that measured it were lost, every one")
    except (OSError, TimeoutError):
        return  # of the connection: OutputError is none of these
    except Exception as problem:
        if type(problem).__name__ not in {"CancelledError", "FutureCancelledError", "FuturesCancelledError"}:
            raise
    finally:
        waiting.extendleft(reversed(given.values()))


def _give(client: Any, packed: bytes, waiting: deque[Waiting], given: dict[Any, Waiting]) -> None:
    """Give out as many logs as the cluster has threads for."""
    threads = max(sum(client.nthreads().values()), 1)
    while waiting and len(given) < TASKS_PER_THREAD * threads:
        task, attempt = waiting.popleft()
        given[_submit(client, packed, task)] = (task, attempt)


def _result(future: Any) -> tuple[Stored, bytes] | None:
    """What a task gave; None where its workers were lost. Raises what ends all work."""
    from distributed import KilledWorker

    if future.status == "finished":
        found: tuple[Stored, bytes] = future.result()
        return found
    problem = future.exception()
    if isinstance(problem, KilledWorker):
        return None
    raise problem


def _submit(client: Any, packed: bytes, task: Task) -> Any:
    return client.submit(
        measure_on_worker,
        packed,
        pickle.dumps(task.log),
        code_version(),
        pure=False,
        key=f"svmdist-{task.number}-{time.monotonic_ns()}",
    )


def measure_on_worker(packed: bytes, log: bytes, expected_version: str) -> tuple[Stored, bytes]:
    """Run on a worker: measure a log, and give its outcome and its rows, compressed."""
    if code_version() != expected_version:
        raise SvmdistError(
            f"a worker has another svmdist: {code_version()}, here {expected_version}; install the same on both"
        )
    job: LogJob[Any] = pickle.loads(packed)
    one: LogFile = pickle.loads(log)
    with tempfile.TemporaryDirectory(prefix="svmdist-") as folder, one_opencv_thread():
        rows = Path(folder) / "rows.jsonl"
        stored = measure_log(job, one, 1, rows)
        return stored, zlib.compress(rows.read_bytes(), 1)


def _connected(address: str, within_s: float, say: Say) -> Any:
    """A client of the scheduler, once there are workers; SvmdistError where it does not answer in time."""
    try:
        from distributed import Client
    except ImportError:
        raise UsageError(
            "--scheduler needs the package distributed, which is not installed: pip install 'svmdist[cluster]'"
        ) from None
    for name in (
        "distributed",
        "tornado.application",
        "asyncio",
    ):  # they print tracebacks of what is handled here
        logging.getLogger(name).setLevel(logging.CRITICAL)
    end_s = time.monotonic() + within_s
    told = False
    while True:
        client = None
        try:
            client = Client(address, timeout=f"{CONNECT_S}s", set_as_default=False)  # type: ignore[no-untyped-call]
            client.wait_for_workers(1, timeout=1)
            return client
        except ValueError as problem:
            raise UsageError(
                f"--scheduler {address}: {problem}; expected an address as in tcp://host:8786"
            ) from None
        except (OSError, TimeoutError) as problem:
            has_scheduler = client is not None
            if client is not None:
                _put_away(client)
            if time.monotonic() > end_s:
                what = (
                    "it has no worker"
                    if has_scheduler
                    else f"cannot connect: {' '.join(str(problem).split())}"
                )
                raise SvmdistError(f"--scheduler {address}: {what}") from None
            if has_scheduler and not told:
                say(f"the cluster {address} has no worker: waiting for one")
                told = True
            time.sleep(LOOK_S)


def _put_away(client: Any) -> None:
    with suppress(Exception):
        client.close(timeout=2)
