"""`svmdist blur-bench`: Table I, measured; or the grid of degradations and severities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Annotated

import typer

from svmdist.cli.console import Summary, require_output, write_summary
from svmdist.cli.degradation_grid import (
    DegradationsOption,
    GridMethodOption,
    SeveritiesOption,
    grid_conditions_of,
    grid_summary,
    grid_summary_of_logs,
)
from svmdist.cli.many import Many, ResumeOption, SchedulerOption
from svmdist.cli.options import (
    CalibrationOption,
    JobsOption,
    Method,
    OptionalFiles,
    OutputOption,
    PlotOption,
    ProfileOption,
    SummaryFormatOption,
    TopicOption,
    topics_of,
)
from svmdist.cli.outputs import summary_format
from svmdist.cli.plots import GridPlotOption, require_plot
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
GridOption = Annotated[
    bool,
    typer.Option(
        "--grid", help="Give error and coverage for each degradation and severity, instead of Table I."
    ),
]


def blur_bench_command(
    files: OptionalFiles = None,
    kernel: KernelOption = None,
    grid: GridOption = False,
    method: GridMethodOption = None,
    degradations: DegradationsOption = None,
    severities: SeveritiesOption = None,
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
    save_plot: PlotOption = None,
    plot: GridPlotOption = None,
) -> None:
    """Measure features and error under blur.

    This reproduces Table I of the paper. With --grid it gives the error and coverage of one method under every
    degradation and severity. Without FILE, every log in recordings/ is measured.
    """
    from svmdist.workflows.request import prepare

    logs = logs_or_golden(files)
    require_output(output, local_logs(logs))
    chosen_form = summary_format(form, output)
    require_plot("blur-bench --grid", plot, save_plot, local_logs(logs))
    if grid:
        _refuse("--kernel is for Table I: it cannot be used with --grid", kernel)
        conditions = grid_conditions_of(degradations, severities)
    else:
        for option, value in (
            ("--method", method),
            ("--degradations", degradations),
            ("--severities", severities),
        ):
            _refuse(f"{option} is for --grid: Table I is always measured with the paper's method", value)
        _refuse(
            "--save-plot draws error and coverage over severity: it is for --grid, Table I has no severities",
            save_plot,
        )
        kernels_px = _kernels(kernel or [])
    setup = prepare(profile, (method or Method.OVERLAY).value, "corrected", calibration)
    window = window_of(start, end, every)
    many = Many(logs, jobs, scheduler, resume)
    if many.is_asked_for or (many.fills_cores if grid else len(logs) > 1):
        from svmdist.cli.log_jobs import BlurJob, GridJob

        if grid:
            grid_job = GridJob(setup, tuple(conditions), topics_of(topic), window)
            with many.measured(grid_job, "measuring") as runs:
                summary, code = grid_summary_of_logs(runs, setup, conditions, save_plot), runs.code
        else:
            blur_job = BlurJob(setup, dict(kernels_px), topics_of(topic), window)
            with many.measured(blur_job, "measuring") as counted:
                tallies = [result.tallies for _, result in counted.measured]
                summary, code = _blur_summary(tallies, kernels_px), counted.code
        write_summary(summary, chosen_form, output)
        raise typer.Exit(code())
    opened = open_recordings(logs, setup.profile, topics_of(topic), window)
    recordings = opened.recordings
    summary = (
        grid_summary(recordings, setup, conditions, jobs, save_plot)
        if grid
        else _table_one(recordings, setup, kernels_px, jobs)
    )
    write_summary(summary, chosen_form, output)
    raise typer.Exit(opened.health_code())


def _refuse(message: str, value: object) -> None:
    """Refuse an option that would be ignored; raises UsageError where it was given."""
    if value is not None:
        raise UsageError(message)


def _table_one(
    recordings: list[Recording], setup: Setup, kernels_px: Mapping[Blur, int], jobs: int | None
) -> Summary:
    from svmdist.workflows.blur_bench import blur_tallies
    from svmdist.workflows.parallel import Steps, image_total

    with progress_bar("Table I", "images") as advance:
        steps = Steps(advance, image_total(recordings))
        tallies = [blur_tallies(one, setup, kernels_px, jobs, steps) for one in recordings]
    return _blur_summary(tallies, kernels_px)


def _blur_summary(tallies: Sequence[Mapping[Blur, BlurTally]], kernels_px: Mapping[Blur, int]) -> Summary:
    from svmdist.report.scores import BLUR_COLUMNS, BLUR_KEYS, BLUR_NOTE, blur_row
    from svmdist.report.tables import counted, rich_table
    from svmdist.workflows.blur_bench import blur_rows

    measured = blur_rows(tallies, kernels_px)
    title = f"{measured[0].frame_count} frames of {counted(len(tallies), 'recording')}"
    rows = [blur_row(row) for row in measured]
    return Summary([rich_table(title, BLUR_COLUMNS, rows)], BLUR_KEYS, rows, [BLUR_NOTE])


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
