"""Many logs: the same outcomes for any number of processes, whatever happens to some of them."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import pytest

from svmdist.errors import UsageError
from svmdist.workflows.batch.pool import ATTEMPTS
from svmdist.workflows.batch.run import How, measured_logs
from svmdist.workflows.batch.store import ResultStore, _checksum, stored_rows
from svmdist.workflows.batch.task import LogFile, Outcome
from tests.recording.faults import mutate_body
from tests.workflows.batch.jobs import Counted, CountJob

Logs = list[LogFile]


def told(outcomes: list[Outcome[Counted]]) -> list[object]:
    """What outcomes say, without the places of their files."""
    return [
        (
            one.log.name,
            one.result,
            one.failure,
            one.losses,
            one.notes,
            dict(one.metadata),
            list(stored_rows(one.rows)) if one.rows and one.failure is None else [],
        )
        for one in outcomes
    ]


def run(job: CountJob, logs: Logs, how: How) -> list[object]:
    with measured_logs(job, logs, how) as outcomes:
        return told(outcomes)


def test_outcomes_are_the_same_for_any_number_of_processes(small_logs: Logs, tmp_path: Path) -> None:
    """In the order of the logs, with their rows, remarks, metadata and failures."""
    found = []
    for jobs in (1, 2, 3, 9):
        folder = tmp_path / str(jobs)
        folder.mkdir()
        found.append(run(CountJob(folder, broken=("log2",)), small_logs, How(jobs)))
    assert found[0] == found[1] == found[2] == found[3]
    names = [one[0] for one in found[0]]  # type: ignore[index]
    assert names == [log.name for log in small_logs]
    assert [one[2] for one in found[0] if one[2]] == ["log2: broken on purpose"]  # type: ignore[index]


def test_a_fault_is_told_with_its_place_and_stops_nothing(small_logs: Logs, tmp_path: Path) -> None:
    with measured_logs(CountJob(tmp_path, faulty=("log0",)), small_logs, How(2)) as outcomes:
        assert outcomes[0].failure is not None
        assert "KeyError: 'a fault' (jobs.py:" in outcomes[0].failure
        assert [one.failure for one in outcomes[1:]] == [None] * 5


@pytest.mark.parametrize("jobs", [1, 2])
def test_what_every_log_would_meet_ends_all(small_logs: Logs, tmp_path: Path, jobs: int) -> None:
    with pytest.raises(UsageError, match="nothing can be measured so"):
        run(CountJob(tmp_path, refused=("log3",)), small_logs, How(jobs))


def test_a_process_that_is_killed_costs_nothing(small_logs: Logs, tmp_path: Path) -> None:
    """Its log is measured once more; one that kills every process is left out with a reason."""
    job = CountJob(tmp_path, killed_once=("log1", "log4"), killed=("log3",))
    outcomes = run(job, small_logs, How(2))
    failures = {one[0]: one[2] for one in outcomes if one[2]}  # type: ignore[index]
    assert list(failures) == ["log3"]
    assert "killed by signal 9" in failures["log3"]
    assert [len(job.pids_of(f"log{number}")) for number in range(6)] == [1, 2, 1, ATTEMPTS, 2, 1]
    calm = tmp_path / "calm"
    calm.mkdir()
    undisturbed = run(CountJob(calm), small_logs, How(1))
    assert [a for a in outcomes if not a[2]] == [b for b in undisturbed if b[0] != "log3"]  # type: ignore[index]


def test_what_is_there_is_not_measured_again(small_logs: Logs, tmp_path: Path) -> None:
    """A failure is; so is what was measured with another request, or of another content."""
    results = tmp_path / "results"
    job = CountJob(tmp_path, broken=("log5",))
    first = run(job, small_logs, How(2, folder=results))
    assert [len(job.pids_of(log.name)) for log in small_logs] == [1] * 6
    assert run(job, small_logs, How(2, folder=results)) == first
    assert [len(job.pids_of(log.name)) for log in small_logs] == [1, 1, 1, 1, 1, 2]
    run(replace(job, broken=()), small_logs, How(2, folder=results))
    assert [len(job.pids_of(log.name)) for log in small_logs] == [2, 2, 2, 2, 2, 3]
    moved = [LogFile(small_logs[4].path, "log0")]
    run(job, moved, How(1, folder=results))
    assert len(job.pids_of("log0")) == 3


@pytest.mark.parametrize(
    "harm", ["cut rows", "changed rows", "cut document", "other type", "changed document", "no rows"]
)
def test_a_result_that_is_not_whole_is_measured_again(small_logs: Logs, tmp_path: Path, harm: str) -> None:
    results = tmp_path / "results"
    job = CountJob(tmp_path)
    first = run(job, small_logs[:1], How(1, folder=results))
    (document,) = results.glob("*.json")
    rows = document.with_suffix(".jsonl")
    match harm:
        case "cut rows":
            rows.write_bytes(rows.read_bytes()[:-3])
        case "changed rows":
            rows.write_bytes(rows.read_bytes().replace(b'"count":', b'"count":1'))
        case "cut document":
            document.write_bytes(document.read_bytes()[:-3])
        case "other type":
            stored = json.loads(document.read_text()) | {"result": {"messages": "7"}}
            stored.pop("sha256")
            document.write_text(json.dumps(stored | {"sha256": _checksum(stored)}))
        case "changed document":
            document.write_text(document.read_text().replace('"messages": ', '"messages": 1'))
        case "no rows":
            rows.unlink()
    assert run(job, small_logs[:1], How(1, folder=results)) == first
    assert len(job.pids_of("log0")) == 2


def test_leftovers_of_killed_processes_are_removed(small_logs: Logs, tmp_path: Path) -> None:
    results = tmp_path / "results"
    results.mkdir()
    (results / ".log0-abc.jsonl.999999.part").write_text("half")
    run(CountJob(tmp_path), small_logs[:1], How(1, folder=results))
    assert not list(results.glob(".*"))


def test_no_mutant_of_a_document_changes_a_value(small_logs: Logs, tmp_path: Path) -> None:
    """It is what was written, or it is not taken; whatever it holds, nothing is raised."""
    import random

    job = CountJob(tmp_path)
    run(job, small_logs[:1], How(1, folder=tmp_path / "results"))
    (document,) = (tmp_path / "results").glob("*.json")
    store = ResultStore(tmp_path / "results", job)
    intact, data = store.load(document, small_logs[0]), document.read_bytes()
    assert intact is not None
    rng = random.Random(5)
    taken = 0
    for _ in range(400):
        document.write_bytes(mutate_body(data, rng))
        found = store.load(document, small_logs[0])
        assert found in (None, intact)
        taken += found is not None
    assert taken < 40
