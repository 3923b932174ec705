"""One path for all logs of a command, one log being a batch of one; what is done with each, and said of all at the end.

Heavy to import: commands do so when they run.
"""

from __future__ import annotations

import logging
import math
from collections import Counter, defaultdict, deque
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, nullcontext, suppress
from dataclasses import dataclass, field
from functools import partial
from itertools import chain, islice
from pathlib import Path
from typing import Any, Generic, TypeVar

import numpy as np

from svmdist.cli.logs import LogOptions, group_name, log_losses
from svmdist.cli.output import LOG, ExitCode, progress_bar, terminal_width, watched, with_name
from svmdist.errors import RecordingError, SvmdistError, did_you_mean
from svmdist.estimation.comparison import Checks
from svmdist.profile import load_profile
from svmdist.recording.log import Recording, open_recording
from svmdist.recording.source import LossKind
from svmdist.recording.summary import inspect_recording
from svmdist.remote import LogPath
from svmdist.report.info import check_rows, info_document
from svmdist.report.rows import estimate_row, pose_rows
from svmdist.report.scores import LogFigures, log_results, ranked
from svmdist.report.tables import Row
from svmdist.report.writers import Results, Writer
from svmdist.transforms import Array
from svmdist.workflows.batch import Job, LogFile, Outcome, collected_notes, log_notes, measure_logs, measured
from svmdist.workflows.calibrate import SEEING_METHODS, fk_blocks
from svmdist.workflows.capabilities import IMAGES, look_for_tag, method_capabilities, misfit
from svmdist.workflows.check import check_log
from svmdist.workflows.compare import MethodScore, measure_runs
from svmdist.workflows.estimate import Ending, Keep, Measured, endings_in_words, estimate, with_lag
from svmdist.workflows.frame_drawing import DrawnFrame, drawn_frames
from svmdist.workflows.parallel import unwatched, usable_cores
from svmdist.workflows.request import Request, Setup

Result = TypeVar("Result")
MAX_REPORTED = 12  # the most logs whose frames are held at once, and fill a page


@dataclass
class Run(Generic[Result]):
    """What a job makes of the logs of a command: `outcomes` are known when the rows are at their end.

    The arguments are those of `Job`. With a `unit`, the progress of `measure` is shown. With `keeps`, it gives its
    argument `keep` what pictures and pages are made of. By `keys` of their metadata logs are grouped.
    """

    given: LogOptions
    measure: Callable[..., Any]
    request: Request
    result_type: type[Result]
    title: str
    unit: str = ""
    options: tuple[Any, ...] = ()
    keeps: bool = False
    keys: Sequence[str] = ()
    outcomes: list[tuple[LogFile, Outcome[Result]]] = field(default_factory=list, init=False)
    _kept: list[Any] = field(default_factory=list, init=False)

    def rows(self) -> Iterator[Row]:
        """Measure the logs and yield their rows, in the order of the logs; what was remarked is said once.

        Of one log the rows come as they are measured. Raises RecordingError where no log could be measured.
        """
        given = self.given
        if given.is_one:
            outcome = yield from self._measured(given.logs[0])
            self.outcomes = [(given.logs[0], outcome)]
            return
        job = Job(self.measure, self.request, self.result_type, self.options)
        with progress_bar(self.title, "logs") as advance:
            found = measure_logs(job, given.logs, given.jobs, given.scheduler, given.resume, advance)
        self.outcomes = list(zip(given.logs, found, strict=True))
        log_notes(found)
        if not self.measured:
            reasons = [with_name(one.failure or "", log.path, log.name) for log, one in self.outcomes]
            if len(reasons) == 1:
                raise RecordingError(reasons[0])
            for reason in reasons:
                LOG.error("left out: %s", reason)
            raise RecordingError("no recording could be used")
        for _, one, _ in self.measured:
            yield from one.rows()

    def begun(self, count: int, output: Path | None) -> tuple[list[Row], Iterator[Row]]:
        """The first rows, so that a log that cannot be read leaves no header behind; and all."""
        rows = self.rows()
        shows = self.given.is_one and terminal_width(output) is not None  # until rows come there
        with progress_bar(f"looking at {self.given.logs[0].name}") if shows else nullcontext():
            head = list(islice(rows, count))
        return head, chain(head, rows)

    def _measured(self, log: LogFile) -> Generator[Row, None, Outcome[Result]]:
        job = Job(self.measure, self.request, self.result_type, self.options)
        more: dict[str, Any] = {"keep": self._kept.append} if self.keeps else {}
        with progress_bar(self.title, self.unit) if self.unit else nullcontext(unwatched) as advance:
            return (yield from measured(job, log, self.given.jobs or usable_cores(), advance, **more))

    def finish(self) -> list[Result]:
        """Measure the logs with a job that has no rows: its results."""
        deque(self.rows(), maxlen=0)
        return self.results

    @property
    def measured(self) -> list[tuple[LogFile, Outcome[Result], Result]]:
        """Logs with a result."""
        return [(log, one, one.result) for log, one in self.outcomes if one.result is not None]

    @property
    def results(self) -> list[Result]:
        """The results of the logs that have one."""
        return [result for _, _, result in self.measured]

    @property
    def _figures(self) -> list[LogFigures]:
        """How the frames of each log ended, by the `statuses` of its result."""
        figures = []
        for log, one in self.outcomes:
            statuses, failed = Counter(getattr(one.result, "statuses", {})), one.failure is not None
            group = group_name(one.metadata, self.keys) if self.keys and not failed else None
            counts = statuses, len(one.losses)
            figures.append(LogFigures(log.name, str(log.path), group, *counts, one.failure, failed))
        return figures

    def ranking(self) -> Results:
        """The figures of each log, worst first, of groups and of all logs."""
        return log_results(self._figures)

    def kept(self) -> list[Any]:
        """What the job kept of one log; of many, those with which most went wrong are measured again for it."""
        if self.given.is_one or not self.keeps:
            return self._kept
        usable = [one for one in ranked(self._figures) if one.statuses]
        names = {one.recording for one in usable[:MAX_REPORTED]}
        if len(usable) > MAX_REPORTED:
            LOG.info("note: the report and the plot show %d of %d logs frame by frame", MAX_REPORTED, len(usable))
        with collected_notes():
            for log in self.given.logs:
                if log.name in names:
                    deque(self._measured(log), maxlen=0)
        return self._kept

    def exit_code(self, measured: bool = True) -> ExitCode:
        """Say what was lost, which logs were left out and why, and which keys no log has.

        A loss or a contradiction gives its code; else nothing that was `measured` is unusable.
        """
        known = {key for _, one in self.outcomes if one.failure is None for key in one.metadata}
        for key in self.keys:
            if key not in known:
                LOG.warning("warning: --group %s: no log has it: %s", key, did_you_mean(key, known))
        codes = [log_losses(log.path, one.health) for log, one in self.outcomes if one.failure is None]
        for log, one in self.outcomes:
            if one.failure is not None:
                codes.append(ExitCode.LOSS)
                LOG.error("left out: %s", with_name(one.failure, log.path, log.name))
        return max(codes, default=ExitCode.CLEAN) or (ExitCode.CLEAN if measured else ExitCode.UNUSABLE)


def corrected(recording: Recording, request: Request, jobs: int | None) -> Recording:
    """Say where the equations cannot be right, and apply the requested lag, with progress."""
    for warning in request.setup.degeneracies(recording.camera):
        LOG.info("warning: %s", warning)
    if request.lag != "auto":
        return with_lag(recording, request)[0]
    with watched(recording, f"lag of {recording.name}") as log:
        seen, found = with_lag(log, request, jobs)
    said = f"the lag cannot be estimated and none is applied: {found.reason}"
    if found.is_observable:
        said = f"lag {found.lag_s * 1e3:+.1f} ms (confidence {found.confidence:.2f})"
    LOG.info("note: %s: %s", recording.name, said)
    return seen


def measure_rows(
    recording: Recording, request: Request, threads: int, keep: Keep | None = None
) -> Generator[Row, None, Ending]:
    """Yield the rows of one recording; `keep` is given all results where something is made of them."""
    setup, seen = request.setup, corrected(recording, request, threads)
    ending, kept = Ending(), []
    with watched(seen, "measuring") as log:
        for row in estimate(log, setup, threads, rest=keep is not None, alarms=request.alarms):
            ending.add(row)
            if keep is not None:
                kept.append(row)
            yield estimate_row(recording.name, row, setup.method, setup.equations)
    if keep is not None:
        keep(Measured(recording, seen, tuple(kept), seen.lag))
    ending.remarks = seen.remarks
    return ending


def draw_log(
    recording: Recording, request: Request, threads: int, writer: Writer, output_path: Path, force: bool
) -> Ending:
    """Measure a recording and write it with its drawings, as a recording or a video."""
    setup, seen, ending = request.setup, corrected(recording, request, threads), Ending()

    def counted(log: Recording) -> Iterator[DrawnFrame]:
        for frame in drawn_frames(log, setup, threads, alarms=request.alarms):
            for row in frame.replayed.results:
                ending.add(row)
            yield frame

    with watched(seen, f"drawing {recording.name}") as log:
        writer.write(counted(log), output_path, seen, setup, force)
    ending.remarks = seen.remarks
    return ending


def compare_log(
    recording: Recording, request: Request, threads: int, setups: tuple[Setup, ...], keys: tuple[str, ...]
) -> list[MethodScore]:
    """Measure a log with several methods under several conditions."""
    by = partial(group_name, keys=keys) if keys else None
    with watched(corrected(recording, request, threads), "comparing") as log:
        return measure_runs(log, setups, request.conditions, jobs=threads, by=by)


def inspect_log(recording: Recording, _request: Request, _threads: int, looks_for_tag: bool) -> dict[str, Any]:
    """A whole log as a document: what it holds, whether images show the profile's tag, and what contradicts."""
    no_tag = ""
    checks: Mapping[str, Checks] = {}
    with progress_bar(f"looking at {recording.name}"):
        summary = inspect_recording(recording.origin.open())
        if looks_for_tag and set(IMAGES) <= set(summary.roles):
            no_tag = look_for_tag(recording)
        again = recording.origin.open()
        with suppress(SvmdistError):  # what it lacks, or what the profile lacks, stands in the methods' lines
            checks = check_log(again)
        health = summary.recording.health
        for loss in again.health.losses:
            if loss.kind is LossKind.IMAGE:  # what else is lost on the way is in the summary already
                health.add(loss)
        recording.health.join(health)
        return info_document(summary, checks, no_tag)


def compared_rows(recording: Recording, _request: Request, _threads: int) -> list[Row]:
    """What a log and its profile show more than once, compared, as rows."""
    with progress_bar(f"comparing {recording.name}"):
        return list(check_rows(recording.name, check_log(recording)))


def served_methods(path: LogPath, profile_name: str, topics: dict[str, str], has_lag: bool) -> list[str]:
    """The methods of `hand-eye` that log and profile serve, the surest first; RecordingError where there is none."""
    summary = inspect_recording(open_recording(path, load_profile(profile_name), topics=topics))
    if said := misfit(summary):
        raise RecordingError(f"{path}: {said}")
    lacks = method_capabilities(summary.at_any_lag() if has_lag else summary)
    if served := [name for name in SEEING_METHODS if not lacks[name]]:
        return served
    lacking = "; ".join(f"{name} lacks {', '.join(lacks[name])}" for name in SEEING_METHODS)
    raise RecordingError(f"{path}: no method can see the tool: {lacking}")


def pose_rows_of(
    recording: Recording, request: Request, _threads: int, in_camera: bool, named: bool
) -> Generator[Row, None, int]:
    """Yield the tool's poses of one recording, with its name if `named`; log what is left out, and errors."""
    of, name = f"{recording.name}: " if named else "", recording.measured[0]
    first, *others = [recording.for_instrument(one).topic_of("joints") for one in recording.instruments]
    if request.instruments is None and "joints" not in request.topics and first and any(others):
        choices = ", ".join(filter(None, others))
        LOG.info("note: %sthese are the joints of %s; --joints TOPIC takes another's: %s", of, name, choices)
    recording = recording.for_instrument(name)
    errors, count = [], 0
    with progress_bar("reading joint states"), closing(fk_blocks(recording, in_camera=in_camera)) as made:
        for stamps_ns, poses, block_errors in made:
            errors.append(block_errors)
            for row in pose_rows(stamps_ns, poses):
                yield {**row, "recording": recording.name} if named else row
                count += 1
    if lost := sum(map(len, errors)) - count:
        said = "note: %s%d of %d joint states are left out: no transform from camera to base is near them in time"
        LOG.info(said, of, lost, lost + count)
    if recording.topic_of("pose") is not None:
        _log_errors(np.concatenate(errors), recording.pose_track().parent, of)
    return count


def _log_errors(errors: Array, frame_id: str | None, of: str) -> None:
    """Log errors against the poses of a topic, shape (n, 2): position in m and angle in rad, NaN without a pose."""
    # What floating point rounds is no error, and differs between processors.
    known = np.round(errors[np.isfinite(errors[:, 0])] * [1e3, math.degrees(1.0)], 9)
    if len(known) == 0:
        LOG.info("%sno pose of the topic (frame %s) is near a joint state in time", of, frame_id)
        return
    (rmse_mm, rmse_deg), (max_mm, max_deg) = np.sqrt(np.mean(known**2, axis=0)), known.max(axis=0)
    LOG.info(
        "%sagainst %d poses in frame %s: position RMSE %.4g mm, max %.4g mm; angle RMSE %.4g°, max %.4g°;"
        " %d joint states without a pose",
        *(of, len(known), frame_id, rmse_mm, max_mm, rmse_deg, max_deg, len(errors) - len(known)),
    )


def log_ending(endings: Mapping[str, Ending], request: Request) -> None:
    """Log what is to be said last of logs by their names."""
    for line in endings_in_words(endings, request.alarms):
        LOG.info("%s", line)


def log_tally(endings: Iterable[Ending]) -> bool:
    """Log how many frames were measured, and the other statuses with their commonest details; whether any was."""
    counts = defaultdict[str, Counter[str]](Counter)
    for status, details in (item for ending in endings for item in ending.counts.items()):
        counts[status].update(details)
    total = sum(details.total() for details in counts.values())
    measured = counts.pop("ok", Counter()).total()
    lost = []
    for status, details in sorted(counts.items()):
        ((commonest, times),) = details.most_common(1)
        of_some = f"{times} of them: " if len(details) > 1 else ""
        lost.append(f"{details.total()} {status}" + (f" ({of_some}{commonest})" if commonest else ""))
    share = f"{measured} of {total} frames measured ({100 * measured / total:.1f}%)"
    LOG.log(logging.INFO if measured else logging.ERROR, "%s", "; ".join(filter(None, [share, ", ".join(lost)])))
    return measured > 0
