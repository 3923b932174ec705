"""A Dask cluster that measures logs, one task per log; Dask gives the tasks of a lost worker to another one."""

from __future__ import annotations

import logging
import pickle
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from importlib.metadata import version
from typing import Any, TypeVar

from svmdist.errors import SvmdistError, UsageError
from svmdist.workflows.batch import LogFile, Outcome
from svmdist.workflows.request import LOG

Result = TypeVar("Result")

CONNECT_S = 10.0
LOOK_S = 0.25
RETRIES = 1


def measured_on_cluster(
    measure: Callable[[LogFile], Outcome[Result]], logs: Sequence[LogFile], address: str
) -> Iterator[tuple[int, Outcome[Result]]]:
    """Yield (place, outcome) of logs as they end.

    Workers read the logs by the paths and URLs that they have here, and run the same svmdist. Raises SvmdistError where
    the scheduler does not answer, or is lost.
    """
    client = _connected(address)
    from distributed import KilledWorker, as_completed

    try:
        # Packed, so that the scheduler need not know what is measured.
        packed = [pickle.dumps((measure, log)) for log in logs]
        futures = client.map(
            measure_on_worker, packed, expected=version("svmdist"), pure=False, retries=RETRIES
        )
        places = {future.key: place for place, future in enumerate(futures)}
        for future in as_completed(futures, loop=client.loop, raise_errors=False):
            if future.status == "finished":
                yield places[future.key], future.result()
            elif future.status != "error":  # cancelled: its scheduler is gone
                raise SvmdistError(
                    f"the scheduler {address} is lost; --resume keeps the results of logs that ended"
                )
            elif isinstance(problem := future.exception(), KilledWorker):
                yield places[future.key], Outcome(None, "the workers that measured it were lost, every one")
            else:
                raise problem
    finally:
        with suppress(Exception):
            client.close(timeout=2)


def measure_on_worker(packed: bytes, expected: str) -> Any:
    """Run on a worker: measure a log."""
    if version("svmdist") != expected:
        raise SvmdistError(
            f"a worker has svmdist {version('svmdist')}, here it is {expected}; install the same on both"
        )
    measure, log = pickle.loads(packed)
    return measure(log)


def _connected(address: str) -> Any:
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
    try:
        client: Any = Client(address, timeout=f"{CONNECT_S}s", set_as_default=False)
    except ValueError as problem:
        raise UsageError(f"--scheduler {address}: {problem}; expected one as in tcp://host:8786") from None
    except (OSError, TimeoutError) as problem:
        reason = " ".join(str(problem).split())
        raise SvmdistError(f"--scheduler {address}: cannot connect: {reason}") from None
    end_s = time.monotonic() + CONNECT_S
    while not client.nthreads():
        if time.monotonic() > end_s:
            client.close(timeout=2)
            raise SvmdistError(f"--scheduler {address}: it has no worker")
        LOG.debug("the cluster %s has no worker: waiting for one", address)
        time.sleep(LOOK_S)
    return client
