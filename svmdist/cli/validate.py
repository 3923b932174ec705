"""`svmdist validate`: score the estimates against kinematics and against the simulator's truth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from svmdist.cli.console import (
    ExitCode,
    files_or_golden,
    report_health,
    require_output_folder,
    say,
    write_lines,
    write_table,
)
from svmdist.cli.options import (
    CalibrationOption,
    EquationsChoice,
    EquationsOption,
    Method,
    MethodOption,
    OptionalFiles,
    OutputOption,
    ProfileOption,
    TableFormat,
    TableFormatOption,
)

if TYPE_CHECKING:
    from svmdist.workflows.validate import Validation

PlotOption = Annotated[
    Path | None,
    typer.Option(
        "--save-plot",
        metavar="FIG",
        help="Draw truth, estimate and error (png, svg, pdf).",
        show_default=False,
    ),
]
BaselineOption = Annotated[
    Path | None,
    typer.Option(
        "--baseline", metavar="FILE", help="Exit 4 when a figure is worse than stored.", show_default=False
    ),
]
WriteBaselineOption = Annotated[
    Path | None,
    typer.Option("--write-baseline", metavar="FILE", help="Store the figures.", show_default=False),
]


def validate_command(
    files: OptionalFiles = None,
    method: MethodOption = Method.OVERLAY,
    equations: EquationsOption = EquationsChoice.CORRECTED,
    calibration: CalibrationOption = None,
    profile: ProfileOption = "psm13",
    form: TableFormatOption = TableFormat.TABLE,
    output: OutputOption = None,
    save_plot: PlotOption = None,
    baseline: BaselineOption = None,
    write_baseline: WriteBaselineOption = None,
) -> None:
    """Score estimates against the truth.

    Without FILE, on every log in recordings/. Each recording is compared with DH kinematics of its joint
    states, as in the paper, and with the simulator's ground truth.
    """
    from svmdist.recording.reader import open_recording
    from svmdist.workflows.baseline import find_regressions, load_baseline, make_baseline, save_baseline
    from svmdist.workflows.setup import prepare
    from svmdist.workflows.validate import validate

    for target in (output, save_plot, write_baseline):
        require_output_folder(target)
    paths = files_or_golden(files)
    stored = load_baseline(baseline) if baseline else None
    setup = prepare(profile, method.value, equations.value, calibration)
    recordings = [open_recording(path, setup.profile) for path in paths]
    result = validate(recordings, setup)
    _write(result, form, output)
    if save_plot:
        from svmdist.report.plot import save_plot as draw_to

        draw_to(result, save_plot)
    code = report_health(recordings)
    if write_baseline:
        save_baseline(make_baseline(result), write_baseline)
    if stored:
        regressions = find_regressions(result, stored, complete=not files)
        for regression in regressions:
            say(f"svmdist: worse: {regression}")
        if regressions:
            code = ExitCode.WORSE
        else:
            say(f"svmdist: no figure is worse than in {baseline}")
    raise typer.Exit(code)


def _write(result: Validation, form: TableFormat, output: Path | None) -> None:
    import json

    from svmdist.report.table import csv_lines
    from svmdist.report.validation import (
        PAPER_NOTE,
        VALIDATION_KEYS,
        score_row,
        validation_document,
        validation_table,
    )

    for note in result.notes:
        say(f"svmdist: note: {note}")
    match form:
        case TableFormat.TABLE:
            write_table(validation_table(result), [PAPER_NOTE], output)
        case TableFormat.CSV:
            scores = (*result.scores, *result.overall)
            write_lines(csv_lines(VALIDATION_KEYS, (score_row(score) for score in scores)), output)
        case TableFormat.JSON:
            write_lines(
                [json.dumps(validation_document(result), indent=1, ensure_ascii=False) + "\n"], output
            )
