"""Many logs: outcomes do not depend on where they are measured, a bad one stops nothing, and results can stay."""

import os
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import pytest

from svmdist.errors import SvmdistError, UsageError
from svmdist.recording.observations import Window
from svmdist.workflows.batch import ATTEMPTS, Job, LogFile, Outcome, collected_notes, log_notes, measure_logs
from svmdist.workflows.request import LOG, Request, Setup
from tests.conftest import REPOSITORY
from tests.synthetic import write_log
from tests.workflows.jobs import Counted, count_images


@pytest.fixture
def logs(tmp_path: Path) -> list[LogFile]:
    paths = [write_log(tmp_path / f"log{number}.mcap", frame_count=2 + number) for number in range(4)]
    return [LogFile(path, path.stem) for path in paths]


def job_in(folder: Path, **fates: str) -> Job[Counted]:
    folder.mkdir(exist_ok=True)
    for name, fate in fates.items():
        (folder / f"{name}.fate").write_text(fate)
    return Job(count_images, Request(Setup.reading("psm13")), Counted, (str(folder),))


def attempts(folder: Path, name: str) -> int:
    path = folder / f"{name}.attempts"
    return len(path.read_text().splitlines()) if path.exists() else 0


def seen(outcomes: list[Outcome[Counted]]) -> list[Any]:
    return [
        (
            one.failure,
            one.result and (one.result.images, one.result.values.tobytes(), one.result.names),
            list(one.rows()) if one.result else [],
            one.notes,
            one.metadata,
        )
        for one in outcomes
    ]


def test_outcomes_are_the_same_for_any_number_of_jobs(logs, tmp_path):
    """In the order of the logs, with rows and remarks; what breaks is told by its reason, a fault by its place."""
    job = job_in(tmp_path / "fates", log1="broken", log2="fault")
    alone = seen(measure_logs(job, logs, jobs=1))
    assert seen(measure_logs(job, logs, jobs=3)) == alone
    assert [one[0] is None for one in alone] == [True, False, False, True]
    assert alone[1][0] == "log1 is broken"
    assert "please report this: ZeroDivisionError: a fault (jobs.py:" in alone[2][0]
    assert [len(one[2]) for one in alone] == [2, 0, 0, 5]
    assert alone[0][2][1] == {"recording": "log0", "number": 1}
    assert [text for _, text in alone[0][3]][-1] == "only of log0"
    who = {line for path in (tmp_path / "fates").glob("*.attempts") for line in path.read_text().split()}
    assert 1 <= len(who - {str(os.getpid())}) <= 3


def test_what_every_log_would_meet_ends_the_work(logs, tmp_path):
    for jobs in (1, 2):
        with pytest.raises(UsageError, match="wrong for all"):
            measure_logs(job_in(tmp_path / "fates", log1="usage"), logs, jobs=jobs)


@pytest.mark.skipif(sys.platform == "win32", reason="kills processes as POSIX does")
def test_a_process_that_is_killed_costs_only_its_log(logs, tmp_path):
    """That is tried once more, and then left out; the others come as they do alone."""
    job = job_in(tmp_path / "fates", log2="killed")
    outcomes = measure_logs(job, logs, jobs=2)
    assert [one.failure is None for one in outcomes] == [True, True, False, True]
    assert "killed" in str(outcomes[2].failure)
    assert attempts(tmp_path / "fates", "log2") == ATTEMPTS


def test_results_stay_in_a_folder(logs, tmp_path):
    """They are reused for the same log, request and version; failures, changed logs and broken files are not."""
    fates, results = tmp_path / "fates", tmp_path / "results"
    first = measure_logs(job_in(fates, log1="broken"), logs, jobs=1, folder=results)
    again = measure_logs(job_in(fates), logs, jobs=1, folder=results)
    assert seen(again) == seen(first)
    assert [attempts(fates, log.name) for log in logs] == [1, 2, 1, 1]
    (fates / "log1.fate").unlink()
    (tmp_path / "log0.mcap").unlink()
    write_log(tmp_path / "log0.mcap", frame_count=3)
    broken = next(results.glob("log2-*.json"))
    broken.write_text(broken.read_text()[:-100])
    last = measure_logs(job_in(fates), logs, jobs=2, folder=results)
    assert [one.result and one.result.images for one in last] == [3, 3, 4, 5]
    assert [attempts(fates, log.name) for log in logs] == [2, 3, 2, 1]
    other = Job(count_images, Request(Setup.reading("psm13"), window=Window(every=2)), Counted, (str(fates),))
    measure_logs(other, logs, jobs=1, folder=results)
    assert attempts(fates, "log3") == 2


def test_remarks_are_collected_and_said_once(caplog):
    """What many logs share is said once with their number; levels are kept."""
    with collected_notes() as notes:
        LOG.info("shared")
        LOG.debug("own")
    assert notes == [(20, "shared"), (10, "own")]
    assert not caplog.records
    outcomes = [Outcome(None, notes=((20, "shared"), (20, f"of {at}"))) for at in range(4)]
    with caplog.at_level("INFO", "svmdist"):
        log_notes(outcomes)
    assert caplog.messages == ["shared (so in 4 logs)", "of 0", "of 1", "of 2", "of 3"]


class DaskCluster:
    """A real Dask cluster on this machine: a scheduler and two workers of one thread, each a process of its own."""

    def __init__(self, folder: Path) -> None:
        with socket.socket() as free:
            free.bind(("127.0.0.1", 0))
            port = free.getsockname()[1]
        self._folder = folder
        self.address = f"tcp://127.0.0.1:{port}"
        self.scheduler = self._start("scheduler", "--host", "127.0.0.1", "--port", str(port), "--no-show")
        options = (self.address, "--nthreads", "1", "--no-nanny")
        self.workers = [self._start("worker", *options) for _ in range(2)]

    def close(self) -> None:
        for process in [*self.workers, self.scheduler]:
            process.kill()
            process.wait()

    def kill_worker(self, pid: int) -> None:
        next(worker for worker in self.workers if worker.pid == pid).kill()

    def _start(self, what: str, *arguments: str) -> subprocess.Popen[bytes]:
        command = [sys.executable, "-m", "dask", what, *arguments, "--no-dashboard"]
        there = os.environ | {"PYTHONPATH": str(REPOSITORY)}
        with (self._folder / f"{what}.log").open("ab") as log:
            to = {"stdout": log, "stderr": subprocess.STDOUT}
            return subprocess.Popen(command, **to, cwd=self._folder, env=there)


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[DaskCluster]:
    pytest.importorskip("distributed", reason="the extra cluster is not installed")
    made = DaskCluster(tmp_path)
    yield made
    made.close()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="kills processes as POSIX does")
@pytest.mark.filterwarnings("default")  # of Dask's own
def test_a_cluster_gives_the_same(cluster, logs, tmp_path):
    """Also where a worker is killed on the way; a scheduler that is lost is one line, and results stay."""
    calm = seen(measure_logs(job_in(tmp_path / "calm", log1="broken"), logs, jobs=1))
    fates = tmp_path / "fates"
    job = job_in(fates, log1="broken", log3="held")
    with ThreadPoolExecutor(1) as aside:
        run = aside.submit(measure_logs, job, logs, scheduler=cluster.address)
        end_s = time.monotonic() + 120.0
        while attempts(fates, "log3") != 1:
            assert not run.done(), run.exception()
            assert time.monotonic() < end_s, "no worker began the log"
            time.sleep(0.02)
        cluster.kill_worker(int((fates / "log3.attempts").read_text()))
        (fates / "open").touch()
        assert seen(run.result()) == calm
    assert attempts(fates, "log3") == 2
    cluster.scheduler.kill()
    cluster.scheduler.wait()
    with pytest.raises(SvmdistError, match="cannot connect"):
        measure_logs(job, logs, scheduler=cluster.address)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="kills processes as POSIX does")
@pytest.mark.filterwarnings("default")  # of Dask's own
def test_results_that_go_with_their_worker_come_again(cluster, logs, tmp_path, monkeypatch):
    """A worker holds what it has measured until the client asks for it, and may be killed in between."""
    distributed = pytest.importorskip("distributed")
    calm = seen(measure_logs(job_in(tmp_path / "calm"), logs, jobs=1))
    fates, as_completed = tmp_path / "fates", distributed.as_completed

    def completed_and_lost(futures: list[Any], **options: Any) -> Iterator[Any]:
        ended = list(as_completed(futures, **options))
        cluster.kill_worker(int((fates / "log0.attempts").read_text()))
        end_s = time.monotonic() + 120.0
        while all(future.status == "finished" for future in futures):
            assert time.monotonic() < end_s, "no result was lost"
            time.sleep(0.001)
        return iter(ended)

    monkeypatch.setattr(distributed, "as_completed", completed_and_lost)
    assert seen(measure_logs(job_in(fates), logs, scheduler=cluster.address)) == calm
    assert attempts(fates, "log0") == 2


@pytest.mark.parametrize("address", ["foo", "foo:x", "nonsense://x:1"])
def test_a_scheduler_without_an_address_is_not_asked(monkeypatch, logs, tmp_path, address):
    """A client of it could not be closed: Dask would complain when the process ends."""
    distributed = pytest.importorskip("distributed", reason="the extra cluster is not installed")
    monkeypatch.setattr(distributed, "Client", lambda *_, **__: pytest.fail("a client is made"))
    with pytest.raises(UsageError, match=f"--scheduler {address}: .*expected one as in tcp://host:8786"):
        measure_logs(job_in(tmp_path), logs, scheduler=address)
