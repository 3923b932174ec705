"""`svmdist estimate -o out.mcap` and `out.mp4`: what was found and measured, drawn on the images of a log."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from svmdist.cli.console import say
from svmdist.cli.progress import progress_bar
from svmdist.report.writers import Writer

if TYPE_CHECKING:
    from svmdist.estimation.alarms import AlarmRules
    from svmdist.recording.log import Recording
    from svmdist.workflows.frame_drawing import DrawnFrame
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


def write_drawn(job: DrawnJob, output: Path, writer: Writer, tally: Tally, *, force: bool) -> None:
    """Measure a recording and write it with its drawings, in the format of the file's ending."""
    from svmdist.cli.lag import told_lag
    from svmdist.workflows.frame_drawing import drawn_frames

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

        assert writer.save is not None
        writer.save(told(), seen, job.setup, output, force)
