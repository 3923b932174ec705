"""`svmdist blur-bench`: Table I, measured."""

from __future__ import annotations

from typing import Annotated

import typer

from svmdist.cli.console import Summary, files_or_golden, report_health, require_output_folder, write_summary
from svmdist.cli.options import (
    CalibrationOption,
    OptionalFiles,
    OutputOption,
    ProfileOption,
    TableFormat,
    TableFormatOption,
    TopicOption,
    topics_of,
)
from svmdist.errors import UsageError, did_you_mean


def blur_bench_command(
    files: OptionalFiles = None,
    kernel: Annotated[
        list[str] | None,
        typer.Option(
            "--kernel",
            metavar="BLUR=PX",
            help="Kernel of one blur, odd; may be repeated.",
            show_default=False,
        ),
    ] = None,
    calibration: CalibrationOption = None,
    profile: ProfileOption = "psm13",
    topic: TopicOption = None,
    form: TableFormatOption = TableFormat.TABLE,
    output: OutputOption = None,
) -> None:
    """Measure features and error under blur.

    Table I of the paper, reproducible. Without FILE, on every log in recordings/.
    """
    from svmdist.recording.reader import open_recording
    from svmdist.report.blur import BLUR_COLUMNS, BLUR_KEYS, BLUR_NOTE, blur_row
    from svmdist.workflows.blur_bench import DEFAULT_KERNELS_PX, blur_bench
    from svmdist.workflows.setup import prepare

    require_output_folder(output)
    kernels_px = {str(blur): size for blur, size in DEFAULT_KERNELS_PX.items()} | _kernels(
        kernel or [], [str(blur) for blur in DEFAULT_KERNELS_PX]
    )
    setup = prepare(profile, "overlay", "corrected", calibration)
    recordings = [
        open_recording(path, setup.profile, topics=topics_of(topic)) for path in files_or_golden(files)
    ]
    measured = blur_bench(recordings, setup, {blur: kernels_px[str(blur)] for blur in DEFAULT_KERNELS_PX})
    rows = [blur_row(row) for row in measured]
    title = f"{measured[0].frame_count} frames of {len(recordings)} recordings"
    write_summary(Summary(title, BLUR_COLUMNS, BLUR_KEYS, rows, [BLUR_NOTE]), form, output)
    raise typer.Exit(report_health(recordings))


def _kernels(options: list[str], blurs: list[str]) -> dict[str, int]:
    """Parse BLUR=PX; raises UsageError that says what was expected."""
    kernels = {}
    for option in options:
        name, _, size = option.partition("=")
        if name not in blurs or name == "none":
            raise UsageError(
                f"--kernel {option}: {did_you_mean(name, [blur for blur in blurs if blur != 'none'])}"
            )
        if not size.isdecimal() or int(size) % 2 == 0 or not 1 <= int(size) <= 101:
            raise UsageError(f"--kernel {option}: expected an odd size from 1 to 101 px, as in {name}=5")
        kernels[name] = int(size)
    return kernels
