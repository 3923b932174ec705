"""What is done with each log, here or in a worker, with its progress and remarks. Commands import it when they run."""

from __future__ import annotations

import math
from collections.abc import Generator, Iterator, Mapping
from contextlib import closing, suppress
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from svmdist.cli.logs import group_name
from svmdist.cli.output import LOG, progress_bar, watched
from svmdist.errors import RecordingError, SvmdistError
from svmdist.estimation.comparison import Checks
from svmdist.profile import load_profile
from svmdist.recording.log import Recording, open_recording
from svmdist.recording.source import LossKind
from svmdist.recording.summary import inspect_recording
from svmdist.remote import LogPath
from svmdist.report.info import check_rows, info_document
from svmdist.report.rows import estimate_row, pose_rows
from svmdist.report.tables import Row
from svmdist.report.writers import Writer
from svmdist.transforms import Array
from svmdist.workflows.calibrate import SEEING_METHODS
from svmdist.workflows.capabilities import IMAGES, look_for_tag, method_capabilities, misfit
from svmdist.workflows.check import check_log
from svmdist.workflows.compare import MethodScore, measure_runs
from svmdist.workflows.ending import Ending
from svmdist.workflows.estimate import Keep, Measured, estimate, with_lag
from svmdist.workflows.fk import fk_blocks
from svmdist.workflows.frame_drawing import DrawnFrame, drawn_frames
from svmdist.workflows.request import Request, Setup


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
            with suppress(RecordingError):  # a calibration that is not usable: the summary says so
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
