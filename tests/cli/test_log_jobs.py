"""Jobs of commands: they travel between processes, their results survive storing, and remarks travel with them."""

from __future__ import annotations

import json
import pickle
from pathlib import Path
from typing import Any

import pytest
from svmdist.cli.console import say
from svmdist.cli.estimate_logs import MAX_REPORTED, EstimateJob, figures_of_logs, reported_logs
from svmdist.cli.log_jobs import BlurJob, CalibrateJob, CompareJob, ValidateJob
from svmdist.cli.log_summary import LogSummary
from svmdist.cli.many import Outcomes, group_keys, group_name, heard_notes
from svmdist.cli.validate_logs import validation_of
from svmdist.workflows.batch.identity import fingerprint
from svmdist.workflows.batch.plain import from_plain, to_plain
from svmdist.workflows.batch.task import LogFile, Note, Outcome

from svmdist.cli.fk import FkJob
from svmdist.cli.info import InfoJob
from svmdist.errors import OutputError, RecordingError, UsageError
from svmdist.profile import load_profile
from svmdist.recording.observations import Window
from svmdist.report.scores import LogFigures
from svmdist.vision.degradations import Blur
from svmdist.workflows.conditions import CLEAN
from svmdist.workflows.request import prepare
from svmdist.workflows.scoring.truth import TruthRules

PROFILE = load_profile()
SETUP = prepare(method="overlay")
SHORT = Window(end_s=0.2)
JOBS = [
    EstimateJob(SETUP, {}, SHORT, None, None, None, True),
    ValidateJob(SETUP, {}, SHORT, TruthRules(), None, None, None, True),
    CompareJob((SETUP, prepare(method="kinematic")), (CLEAN,), {}, SHORT, None, ("scenario",)),
    BlurJob(SETUP, {Blur.NONE: 1, Blur.GAUSSIAN: 5}, {}, SHORT),
    CalibrateJob(PROFILE, "overlay", {}, SHORT),
    FkJob(PROFILE, {}, False),
    InfoJob(PROFILE, {}, True),
]


@pytest.mark.parametrize("job", JOBS, ids=lambda job: type(job).__name__)
def test_a_job_travels_and_its_result_survives_storing(job: Any, synthetic_log: Path) -> None:
    """What is read again is what was measured: as plain data both are the same text."""
    sent = pickle.loads(pickle.dumps(job))
    assert fingerprint(sent) == fingerprint(job)
    rows: list[Any] = []
    measured = sent.measure(LogFile(synthetic_log, "log"), 1, rows.append)
    text = json.dumps(to_plain(measured.result))
    again = from_plain(job.result_type, json.loads(text))
    assert type(again) is type(measured.result)
    assert json.dumps(to_plain(again)) == text
    assert measured.health.is_clean
    if isinstance(job, EstimateJob | FkJob):
        assert rows == json.loads(json.dumps(rows))
        assert rows


def outcome(
    name: str, result: Any = None, *, failure: str | None = None, notes: tuple[Note, ...] = ()
) -> Outcome[Any]:
    return Outcome(LogFile(Path(f"{name}.mcap"), name), result, failure, notes=notes)


def test_remarks_are_collected_and_told_later(capsys: pytest.CaptureFixture[str]) -> None:
    """In the order of the logs; what more than three share is told once."""
    with heard_notes() as notes:
        say("svmdist: note: shared")
        say("svmdist: note: mine")
    assert capsys.readouterr().err == ""
    shared, mine = notes
    outcomes = Outcomes(
        [outcome(str(at), 1, notes=(shared, mine) if at == 2 else (shared,)) for at in range(5)]
    )
    outcomes.say_notes()
    assert capsys.readouterr().err == "svmdist: note: shared (so in 5 logs)\nsvmdist: note: mine\n"


def test_where_nothing_was_measured_every_reason_is_told(capsys: pytest.CaptureFixture[str]) -> None:
    """Of one log it is the error itself; a reason that does not name its log gets its path."""
    with pytest.raises(RecordingError, match=r"^a\.mcap: broken$"):
        Outcomes([outcome("a", failure="broken")]).require_any()
    with pytest.raises(RecordingError, match="no recording could be used"):
        Outcomes([outcome("a", failure="a: broken"), outcome("b", failure="cut")]).require_any()
    assert capsys.readouterr().err.splitlines() == [
        "svmdist: left out: a: broken",
        "svmdist: left out: b.mcap: cut",
    ]


def test_groups_are_named_by_metadata() -> None:
    assert group_keys(None) == ()
    assert group_keys("scenario, world") == ("scenario", "world")
    assert group_name({"scenario": "sweep"}, ("scenario", "world")) == "scenario=sweep world=none"
    with pytest.raises(UsageError, match="expected names of metadata"):
        group_keys("scenario,,world")


def test_the_summary_is_checked_before_the_work(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="say where they go with --summary FILE"):
        LogSummary.of(None, "scenario", [])
    with pytest.raises(OutputError, match="there is no folder"):
        LogSummary.of(tmp_path / "none" / "a.csv", None, [])
    assert not LogSummary.of(None, None, []).is_asked_for


def test_a_report_shows_all_logs_or_the_worst(capsys: pytest.CaptureFixture[str]) -> None:
    """Of few all, in their own order; of many those with which most went wrong, the worst first."""
    logs = [LogFile(Path(f"{at}.mcap"), str(at)) for at in range(MAX_REPORTED + 3)]
    worst_first = [LogFigures(log.name, statuses={"ok": 1}) for log in reversed(logs)]
    assert reported_logs(logs[:4], worst_first[-4:]) == logs[:4]
    assert [log.name for log in reported_logs(logs, worst_first)] == [one.recording for one in worst_first][
        :12
    ]
    assert "show 12 of 15 logs frame by frame" in capsys.readouterr().err


def test_scores_of_logs_together_are_those_of_validate(synthetic_log: Path) -> None:
    from svmdist.recording.log import open_recording
    from svmdist.workflows.validate import validate

    job = ValidateJob(SETUP, {}, None, TruthRules(), None, None, None, True)
    scored = job.measure(LogFile(synthetic_log, "synthetic"), 1, lambda row: None)
    one = Outcome(LogFile(synthetic_log, "synthetic"), scored.result, metadata=scored.metadata)
    found = validation_of(Outcomes([one]), job, ("scenario",))
    expected = validate([open_recording(synthetic_log, PROFILE)], SETUP, TruthRules())
    assert [score.statistics for score in found.overall] == [score.statistics for score in expected.overall]
    assert {score.recording for score in found.groups} == {"scenario=synthetic"}
    each, together = figures_of_logs(Outcomes([outcome("a", failure="broken")]), ())
    assert (each[0].state, together[-1].failed_count) == ("failed", 1)
