"""`svmdist blur-bench`: Table I, measured."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from svmdist.cli.console import require_output, write_results
from svmdist.cli.many import Many, ResumeOption, SchedulerOption
from svmdist.cli.options import (
    CalibrationOption,
    JobsOption,
    OptionalFiles,
    OutputOption,
    ProfileOption,
    SummaryFormatOption,
    TopicOption,
    topics_of,
)
from svmdist.cli.progress import progress_bar
from svmdist.cli.recordings import (
    EndOption,
    EveryOption,
    StartOption,
    local_logs,
    logs_or_golden,
    open_recordings,
    window_of,
)
from svmdist.errors import UsageError, did_you_mean
from svmdist.report.writers import Holds, Results, choose_writer

if TYPE_CHECKING:
    from svmdist.recording.log import Recording
    from svmdist.vision.degradations import Blur
    from svmdist.workflows.blur_bench import BlurTally
    from svmdist.workflows.request import Setup

KernelOption = Annotated[
    list[str] | None,
    typer.Option(
        "--kernel",
        metavar="BLUR=PX",
        help="Kernel size of one blur, an odd number; may be repeated.",
        show_default=False,
    ),
]


def blur_bench_command(
    files: OptionalFiles = None,
    kernel: KernelOption = None,
    calibration: CalibrationOption = None,
    profile: ProfileOption = "psm13",
    topic: TopicOption = None,
    form: SummaryFormatOption = None,
    output: OutputOption = None,
    jobs: JobsOption = None,
    start: StartOption = 0.0,
    end: EndOption = None,
    every: EveryOption = 1,
    scheduler: SchedulerOption = None,
    resume: ResumeOption = None,
) -> None:
    """Measure features and error under blur.

    This reproduces Table I of the paper. Without FILE, every log in recordings/ is measured. For the error under other
    degradations, see svmdist compare --degrade.
    """
    from svmdist.workflows.request import prepare

    logs = logs_or_golden(files)
    require_output(output, local_logs(logs))
    writer = choose_writer(form, output, Holds.FIGURES)
    kernels_px = _kernels(kernel or [])
    setup = prepare(profile, "overlay", "corrected", calibration)
    window = window_of(start, end, every)
    many = Many(logs, jobs, scheduler, resume)
    if many.is_asked_for or len(logs) > 1:
        from svmdist.cli.log_jobs import BlurJob

        job = BlurJob(setup, dict(kernels_px), topics_of(topic), window)
        with many.measured(job, "measuring") as outcomes:
            tallies = [result.tallies for _, result in outcomes.measured]
            write_results(_results(tallies, kernels_px), writer, output)
            raise typer.Exit(outcomes.code())
    opened = open_recordings(logs, setup.profile, topics_of(topic), window)
    write_results(_table_one(opened.recordings, setup, kernels_px, jobs), writer, output)
    raise typer.Exit(opened.health_code())


def _table_one(
    recordings: list[Recording], setup: Setup, kernels_px: Mapping[Blur, int], jobs: int | None
) -> Results:
    from svmdist.workflows.blur_bench import blur_tallies
    from svmdist.workflows.parallel import Steps, image_total

    with progress_bar("Table I", "images") as advance:
        steps = Steps(advance, image_total(recordings))
        tallies = [blur_tallies(one, setup, kernels_px, jobs, steps) for one in recordings]
    return _results(tallies, kernels_px)


def _results(tallies: Sequence[Mapping[Blur, BlurTally]], kernels_px: Mapping[Blur, int]) -> Results:
    from svmdist.report.scores import blur_results
    from svmdist.workflows.blur_bench import blur_rows

    return blur_results(blur_rows(tallies, kernels_px), len(tallies))


def _kernels(options: list[str]) -> dict[Blur, int]:
    """Parse BLUR=PX over the default kernels; raises UsageError that says what was expected."""
    from svmdist.vision.degradations import Blur
    from svmdist.workflows.blur_bench import DEFAULT_KERNELS_PX

    kernels_px = dict(DEFAULT_KERNELS_PX)
    blurs = [str(blur) for blur in Blur if blur is not Blur.NONE]
    for option in options:
        name, _, size = option.partition("=")
        if name not in blurs:
            raise UsageError(f"--kernel {option}: {did_you_mean(name, blurs)}")
        if not size.isdecimal() or int(size) % 2 == 0 or not 1 <= int(size) <= 101:
            raise UsageError(f"--kernel {option}: expected an odd size from 1 to 101 px, as in {name}=5")
        kernels_px[Blur(name)] = int(size)
    return kernels_px
