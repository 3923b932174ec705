"""`svmdist validate`: score the estimates against kinematics and against the simulator's truth."""

from __future__ import annotations

from dataclasses import replace
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import typer

from svmdist.cli.logs import Logs, Run
from svmdist.cli.options import (
    PLOT,
    REPORT,
    GoldenLogOptions,
    GroupOption,
    MeasureOptions,
    format_option,
    option,
    output_option,
)
from svmdist.cli.output import (
    LOG,
    ExitCode,
    command_line,
    progress_bar,
    require_output,
    require_plot,
    require_report,
    write_results,
)
from svmdist.report.writers import Holds, choose_writer

if TYPE_CHECKING:
    from svmdist.recording.log import Recording
    from svmdist.workflows.estimate import Keep, Measured
    from svmdist.workflows.request import Request
    from svmdist.workflows.validate import Baseline, Scored, Validation


TruthChoice = StrEnum("TruthChoice", "ground_truth tf pose kinematics")
PlotKind = Literal["fig6", "time", "residuals", "bland-altman", "calibration"]


class ValidateOptions(GoldenLogOptions, MeasureOptions, GroupOption):
    """What `validate` takes."""

    form: str | None = format_option(Holds.FIGURES)
    output: Path | None = output_option()
    truth: list[TruthChoice] | None = option(
        None,
        f"--truth {'|'.join(TruthChoice)}",
        "Reference to compare with; may be repeated. Default: every reference that the log has.",
    )
    truth_tf: list[str] | None = option(
        None,
        "--truth-tf PARENT:CHILD",
        "Transform that is the truth of the tool or the tissue, as in camera:tool; may be given twice.",
    )
    max_gap: float = option(
        0.1, "--max-gap SECONDS", "Longest gap in the truth to interpolate across.", min=0.0, max=60.0
    )
    baseline: Path | None = option(
        None, "--baseline FILE", "Exit with code 4 if a metric is worse than in this file."
    )
    write_baseline: Path | None = option(None, "--write-baseline FILE", "Store the metrics in this file.")
    report: Path | None = REPORT
    save_plot: Path | None = PLOT
    plot: PlotKind | None = option(
        None,
        f"--plot {'|'.join(get_args(PlotKind))}",
        "What --save-plot draws: fig6, truth, estimate and error over time as in the paper's figure; time, the distance"
        " with its interval; residuals over time and distance; bland-altman; calibration of the interval. Default:"
        " fig6.",
    )


def validate_command(given: ValidateOptions) -> None:
    """Score estimates against the truth.

    Without FILE, every log in recordings/ is scored. Each recording is compared with the DH kinematics of its joint
    states, as in the paper, and with the simulator's ground truth. With --alarm-below, alarms are scored against
    the true clearance: recall, precision, share of the safe frames that are alarmed, false alarms per minute and
    lead time.

    Examples:
      Errors against the truth:
        svmdist validate log.mcap --method fused
      A page with plots and the worst frames:
        svmdist validate log.mcap --method fused --report report.html
      A figure for a paper:
        svmdist validate log.mcap --save-plot error.pdf --plot residuals
      In CI: fail where a figure gets worse:
        svmdist validate log.mcap --baseline baseline.json
    """
    from svmdist.report.scores import validation_results
    from svmdist.workflows.batch import Job
    from svmdist.workflows.validate import (
        Scored,
        combine,
        load_baseline,
        make_baseline,
        require_same_alarms,
        require_truth_for_alarms,
        save_baseline,
    )

    logs = Logs(given)
    for target in (given.output, given.write_baseline):
        require_output(target, logs.paths)
    require_report(given.report, logs.paths)
    require_plot(given.save_plot, logs.paths, given.plot)
    keys = given.group_keys
    writer = choose_writer(given.form, given.output, Holds.FIGURES)
    stored = load_baseline(given.baseline) if given.baseline else None
    if stored:
        require_same_alarms(stored, given.rules(given.method))
    request = _request(given)
    require_truth_for_alarms(request)
    measured: list[Measured] = []
    draws_series = given.save_plot is not None and given.plot not in (None, "fig6")
    keep = measured.append if given.report or draws_series else None
    run = Run(logs, Job(score_log, request, Scored), "validating")
    run.finish(keep)
    result = combine(run.results, request, run.groups(keys))
    if keep is not None:
        run.measure_again(keep)
    for note in result.notes:
        LOG.info("note: %s", note)
    write_results(validation_results(result), writer, given.output)
    if given.save_plot:
        _save_plot(result, measured, request, given.plot or "fig6", given.save_plot)
    if given.report:
        _write_report(result, measured, request, logs, run, keys, given.report)
    code = run.exit_code()
    if given.write_baseline:
        save_baseline(make_baseline(result), given.write_baseline)
    if stored and _is_worse(result, stored, given.baseline, complete=not given.files):
        code = ExitCode.WORSE
    raise typer.Exit(code)


def _request(given: ValidateOptions) -> Request:
    from svmdist.workflows.references import Reference, truth_rules

    request = given.request()
    references = tuple(Reference(str(choice)) for choice in dict.fromkeys(given.truth or [])) or None
    pairs = tuple(given.truth_tf or ())
    return replace(
        request, rules=truth_rules(pairs, request.setup.profile, references, round(given.max_gap * 1e9))
    )


def score_log(recording: Recording, request: Request, threads: int, keep: Keep | None = None) -> Scored:
    """Score one recording, with progress."""
    from svmdist.workflows.parallel import Steps, image_total
    from svmdist.workflows.validate import score_recording, step_count

    with progress_bar(f"validating {request.setup.method}", "rows") as advance:
        steps = Steps(advance, image_total([recording], lambda one: step_count(one, request)))
        return score_recording(recording, request, threads, steps, keep)


def _save_plot(
    result: Validation, measured: list[Measured], request: Request, kind: PlotKind, path: Path
) -> None:
    from svmdist.report.plots import draw, draw_series, save_figure
    from svmdist.workflows.series import series_of

    if kind == "fig6":
        save_figure(path, draw, result)
        return
    series, below_m = (
        series_of(measured, request, result.reference),
        request.alarms and request.alarms.below_m,
    )
    save_figure(path, draw_series, series, kind, below_m)


def _write_report(
    result: Validation,
    measured: list[Measured],
    request: Request,
    logs: Logs,
    run: Run[Scored],
    keys: tuple[str, ...],
    path: Path,
) -> None:
    from svmdist.report.html import make_report, write_report
    from svmdist.report.scores import log_results

    ranking = None if logs.is_one else log_results(run.figures(keys))
    with progress_bar("drawing the worst frames", "images") as advance:
        page = make_report(
            measured, request, command_line(), result, jobs=logs.jobs, logs=ranking, on_progress=advance
        )
    write_report(page, path)


def _is_worse(result: Validation, stored: Baseline, path: Path | None, *, complete: bool) -> bool:
    """Say which figures are worse than those stored."""
    from svmdist.workflows.validate import find_regressions

    regressions = find_regressions(result, stored, complete=complete)
    for regression in regressions:
        LOG.info("worse: %s", regression)
    if not regressions:
        LOG.info("no figure is worse than in %s", path)
    return bool(regressions)
