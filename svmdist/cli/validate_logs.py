"""`svmdist validate` of several logs: the scores of all, and the logs ranked by what went wrong."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from svmdist.cli.console import ExitCode, hearing, say
from svmdist.cli.estimate_logs import MAX_REPORTED
from svmdist.cli.log_jobs import ValidateJob
from svmdist.cli.many import Many, Outcomes, group_name
from svmdist.cli.progress import progress_bar
from svmdist.cli.recordings import open_log, open_recordings
from svmdist.report.scores import LogFigures, log_results, pooled_log_figures, ranked
from svmdist.report.writers import Results
from svmdist.workflows.batch.task import LogFile, Outcome
from svmdist.workflows.validate import (
    Measured,
    Scored,
    Validation,
    combine,
    require_truth_for_alarms,
    score_recording,
    validate,
)


@dataclass(frozen=True)
class ScoredLogs:
    """The scores of logs; the frames of those that are shown, and a table of all, where these are asked for.

    `finish` says what was lost and left out, and gives the exit code.
    """

    validation: Validation
    measured: list[Measured]
    ranking: Results | None
    finish: Callable[[], ExitCode]


def score_logs(many: Many, job: ValidateJob, keys: Sequence[str], *, keeps_frames: bool) -> ScoredLogs:
    """Score one log here, or several one by one."""
    require_truth_for_alarms(job.alarms, job.setup, job.rules)
    measured: list[Measured] = []
    if len(many.logs) == 1 and not many.is_asked_for and not keys:
        opened = open_recordings(many.logs, job.setup.profile, job.topics, job.window)
        with progress_bar(f"validating {job.setup.method}", "rows") as advance:
            result = validate(
                opened.recordings,
                job.setup,
                job.rules,
                job.lag,
                job.alarms,
                job.wanted,
                many.jobs,
                measured.append if keeps_frames else None,
                on_progress=advance,
            )
        return ScoredLogs(result, measured, None, opened.health_code)
    ranking = None
    with many.measured(job, "validating") as outcomes:
        result = validation_of(outcomes, job, keys)
        if keeps_frames:
            ranking, chosen = log_ranking(outcomes, keys)
            measured = measured_again(job, chosen, many.jobs)
        return ScoredLogs(result, measured, ranking, outcomes.code)


def validation_of(outcomes: Outcomes[Scored], job: ValidateJob, keys: Sequence[str]) -> Validation:
    """The scores of all logs together, and of groups of them."""
    groups = [group_name(one.metadata, keys) for one, _ in outcomes.measured] if keys else ()
    return combine([result for _, result in outcomes.measured], job.setup, job.rules, job.alarms, groups)


def log_ranking(outcomes: Outcomes[Scored], keys: Sequence[str]) -> tuple[Results, list[LogFile]]:
    """A table of all logs, what went wrong most first; and those that are shown frame by frame."""
    each = [_figures(one, keys) for one in outcomes.all]
    worst = ranked(each)
    by_name = {one.log.name: one.log for one, _ in outcomes.measured}
    names = [one.recording for one in worst if one.recording in by_name]
    if len(names) > MAX_REPORTED:
        say(f"svmdist: note: the report and the plot show {MAX_REPORTED} of {len(names)} logs frame by frame")
        names = names[:MAX_REPORTED]
    else:
        names = list(by_name)
    return log_results(worst, pooled_log_figures(each)), [by_name[name] for name in names]


def measured_again(job: ValidateJob, logs: Sequence[LogFile], jobs: int | None) -> list[Measured]:
    """The frames of some logs, which results that are kept do not have."""
    measured: list[Measured] = []
    with hearing():
        for log in logs:
            recording = open_log(log, job.setup.profile, job.topics, job.window)
            score_recording(
                recording, job.setup, job.rules, job.lag, job.alarms, job.wanted, jobs, None, measured.append
            )
    return measured


def _figures(one: Outcome[Scored], keys: Sequence[str]) -> LogFigures:
    statuses: dict[str, int] = {}
    # Every reference scores the same frames.
    for score in one.result.scores if one.result else ():
        if score.reference is one.result.scores[0].reference:  # type: ignore[union-attr]
            for status, count in (("ok", score.frame_count - score.rejected_count), *score.rejected.items()):
                statuses[status] = statuses.get(status, 0) + count
    return LogFigures(
        recording=one.log.name,
        path=str(one.path),
        failure=one.failure,
        statuses=statuses,
        loss_count=len(one.losses),
        group=group_name(one.metadata, keys) if keys and one.failure is None else "",
    )
