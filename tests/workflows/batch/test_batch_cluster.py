"""A real cluster: nothing is lost and nothing counted twice, whichever of its processes is killed."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path
from threading import Thread

import pytest

from svmdist.errors import SvmdistError, UsageError
from svmdist.workflows.batch.run import How, measured_logs
from svmdist.workflows.batch.store import stored_rows
from svmdist.workflows.batch.task import LogFile
from tests.workflows.batch.dask_cluster import DaskCluster, wait_until
from tests.workflows.batch.jobs import CountJob

pytest.importorskip("distributed", reason="the extra cluster is not installed")
pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="kills processes as POSIX does"),
    pytest.mark.filterwarnings("default"),  # of Dask's own
]
Logs = list[LogFile]
Told = list[tuple[str, object, str | None, list[object]]]


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[DaskCluster]:
    made = DaskCluster(tmp_path)
    made.start_scheduler()
    made.start_worker()
    made.start_worker()
    yield made
    made.close()


def run(job: CountJob, logs: Logs, how: How) -> Told:
    with measured_logs(job, logs, how) as outcomes:
        return [
            (one.log.name, one.result, one.failure, list(stored_rows(one.rows)) if one.rows else [])
            for one in outcomes
        ]


def many(small_logs: Logs, count: int = 18) -> Logs:
    return [
        LogFile(small_logs[number % len(small_logs)].path, f"log{number}-{number % len(small_logs)}")
        for number in range(count)
    ]


def test_a_worker_that_is_killed_costs_nothing(
    cluster: DaskCluster, small_logs: Logs, tmp_path: Path
) -> None:
    """On the way: it is at a log that waits at a gate; another worker measures that log again."""
    logs = many(small_logs)
    held = logs[5].name
    job = CountJob(tmp_path, held=(held,), broken=(logs[3].name,))
    found: list[Told] = []
    thread = Thread(target=lambda: found.append(run(job, logs, How(scheduler=cluster.address))), daemon=True)
    thread.start()
    wait_until(lambda: bool(job.pids_of(held)), "no worker began the log")
    (pid,) = job.pids_of(held)
    (victim,) = [worker for worker in cluster.workers if worker.pid == pid]
    victim.kill()
    (tmp_path / "open").touch()
    thread.join(120)
    calm = tmp_path / "calm"
    calm.mkdir()
    assert found == [run(CountJob(calm, broken=(logs[3].name,)), logs, How(1))]
    assert len(job.pids_of(held)) == 2
    assert len(set(job.pids_of(held))) == 2


def test_a_scheduler_that_is_restarted_costs_nothing(
    cluster: DaskCluster, small_logs: Logs, tmp_path: Path
) -> None:
    """What was not back is given out again; what was, is not."""
    logs = many(small_logs)
    held = logs[7].name
    results = tmp_path / "results"
    job = CountJob(tmp_path, held=(held,))
    found: list[Told] = []
    how = How(scheduler=cluster.address, folder=results)
    thread = Thread(target=lambda: found.append(run(job, logs, how)), daemon=True)
    thread.start()
    wait_until(
        lambda: bool(job.pids_of(held)) and len(list(results.glob("*.json"))) >= 3, "no log was measured"
    )
    cluster.kill_scheduler()
    done = {path.name for path in results.glob("*.json")}
    (tmp_path / "open").touch()
    for worker in cluster.workers:
        worker.kill()
    cluster.start_scheduler()
    cluster.start_worker()
    thread.join(120)
    calm = tmp_path / "calm"
    calm.mkdir()
    assert found == [run(CountJob(calm), logs, How(1))]
    begun = {log.name: len(job.pids_of(log.name)) for log in logs}
    assert all(begun[name.rpartition("-")[0]] == 1 for name in done), (begun, done)
    assert len(list(results.glob("*.json"))) == len(logs)


def test_what_is_no_cluster_is_told(
    small_logs: Logs, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import svmdist.workflows.batch.cluster as cluster_module

    monkeypatch.setattr(cluster_module, "CONNECT_S", 0.2)
    job = CountJob(tmp_path)
    with pytest.raises(SvmdistError, match=r"--scheduler tcp://127\.0\.0\.1:1: cannot connect"):
        run(job, small_logs, How(scheduler="tcp://127.0.0.1:1"))
    with pytest.raises(UsageError, match="expected an address as in tcp://host:8786"):
        run(job, small_logs, How(scheduler="nonsense://x"))
    assert not any(job.pids_of(log.name) for log in small_logs)
    assert os.getpid()
