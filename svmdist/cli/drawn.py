"""`svmdist estimate -o out.mcap` and `out.mp4`: what was found and measured, drawn on the images of a log."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from svmdist.cli.console import say
from svmdist.cli.outputs import FileFormat
from svmdist.cli.progress import progress_bar

if TYPE_CHECKING:
    from svmdist.estimation.alarms import AlarmRules
    from svmdist.recording.log import Recording
    from svmdist.workflows.annotate import DrawnFrame
    from svmdist.workflows.lag import Lag
    from svmdist.workflows.request import Setup

Tally = Counter[tuple[str, str]]
"""How many frames ended with a status and a detail."""


@dataclass(frozen=True)
class DrawnJob:
    """What is to be measured and drawn."""

    recording: Recording
    setup: Setup
    rules: AlarmRules | None
    wanted: tuple[str, ...] | None
    lag: Lag | None
    jobs: int | None


def write_drawn(job: DrawnJob, output: Path, form: FileFormat, tally: Tally, *, force: bool) -> None:
    """Measure a recording and write it with its drawings, in the format of the file's ending."""
    from svmdist.cli.lag import told_lag
    from svmdist.report.video import require_av, write_video
    from svmdist.workflows.annotate import drawn_frames, write_annotated

    if form is FileFormat.MP4:
        require_av()  # before the work rather than after it

    for warning in job.setup.degeneracies(job.recording.camera):
        say(f"svmdist: warning: {warning}")
    seen = told_lag(job.recording, job.setup, job.lag, job.wanted, job.jobs)
    with progress_bar(f"drawing {job.recording.name}", "images") as advance:

        def told() -> Iterator[DrawnFrame]:
            total = job.recording.image_count()
            for frame in drawn_frames(seen, job.setup, job.rules, job.wanted, job.jobs):
                for result in frame.replayed.results:
                    tally[str(result.status), result.detail] += 1
                yield frame
                advance(frame.number + 1, total)

        match form:
            case FileFormat.MCAP:
                write_annotated(seen, told(), job.setup, output, force=force)
            case FileFormat.MP4:
                camera = seen.logged_camera
                write_video(told(), output, (camera.width_px, camera.height_px))
            case FileFormat.HTML:
                raise AssertionError("a report is written from rows")
