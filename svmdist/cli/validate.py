"""`svmdist validate`: score the estimates against kinematics and against the simulator's truth."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from svmdist.cli.alarms import AlarmBelowOption, AlarmConfidenceOption, alarm_rules
from svmdist.cli.console import (
    ExitCode,
    require_output,
    say,
    write_results,
)
from svmdist.cli.many import GroupOption, Many, ResumeOption, SchedulerOption, group_keys
from svmdist.cli.options import (
    CalibrationOption,
    EquationsChoice,
    EquationsOption,
    HandEyeOption,
    InstrumentOption,
    JobsOption,
    LagOption,
    Method,
    MethodOption,
    OptionalFiles,
    OutputOption,
    PlotOption,
    ProfileOption,
    ReportOption,
    SummaryFormatOption,
    TopicOption,
    instruments_of,
    parse_lag,
    topics_of,
)
from svmdist.cli.outputs import command_line, require_report
from svmdist.cli.plots import PlotKind, ValidatePlotOption, require_plot
from svmdist.cli.progress import progress_bar
from svmdist.cli.recordings import (
    EndOption,
    EveryOption,
    StartOption,
    local_logs,
    logs_or_golden,
    window_of,
)
from svmdist.report.writers import Holds, choose_writer

if TYPE_CHECKING:
    from svmdist.workflows.request import Setup
    from svmdist.workflows.scoring.baseline import Baseline
    from svmdist.workflows.scoring.truth import TruthRules
    from svmdist.workflows.validate import Measured, Validation


BaselineOption = Annotated[
    Path | None,
    typer.Option(
        "--baseline",
        metavar="FILE",
        help="Exit with code 4 if a metric is worse than in this file.",
        show_default=False,
    ),
]
WriteBaselineOption = Annotated[
    Path | None,
    typer.Option(
        "--write-baseline", metavar="FILE", help="Store the metrics in this file.", show_default=False
    ),
]


class TruthChoice(StrEnum):
    """`--truth`."""

    GROUND_TRUTH = "ground_truth"
    TF = "tf"
    POSE = "pose"
    KINEMATICS = "kinematics"


TruthOption = Annotated[
    list[TruthChoice] | None,
    typer.Option(
        "--truth",
        metavar="|".join(TruthChoice),
        help="Reference to compare with; may be repeated. Default: every reference that the log has.",
        show_default=False,
    ),
]
TruthTfOption = Annotated[
    list[str] | None,
    typer.Option(
        "--truth-tf",
        metavar="PARENT:CHILD",
        help="Transform that is the truth of the tool or the tissue, as in camera:tool; may be given twice.",
        show_default=False,
    ),
]
MaxGapOption = Annotated[
    float,
    typer.Option(
        "--max-gap",
        metavar="SECONDS",
        min=0.0,
        max=60.0,
        help="Longest gap in the truth to interpolate across.",
    ),
]


def validate_command(
    files: OptionalFiles = None,
    method: MethodOption = Method.OVERLAY,
    equations: EquationsOption = EquationsChoice.CORRECTED,
    calibration: CalibrationOption = None,
    profile: ProfileOption = "psm13",
    hand_eye: HandEyeOption = None,
    form: SummaryFormatOption = None,
    output: OutputOption = None,
    topic: TopicOption = None,
    truth: TruthOption = None,
    truth_tf: TruthTfOption = None,
    max_gap: MaxGapOption = 0.1,
    lag: LagOption = None,
    save_plot: PlotOption = None,
    baseline: BaselineOption = None,
    write_baseline: WriteBaselineOption = None,
    alarm_below: AlarmBelowOption = None,
    alarm_confidence: AlarmConfidenceOption = None,
    instrument: InstrumentOption = None,
    jobs: JobsOption = None,
    report: ReportOption = None,
    plot: ValidatePlotOption = None,
    start: StartOption = 0.0,
    end: EndOption = None,
    every: EveryOption = 1,
    scheduler: SchedulerOption = None,
    resume: ResumeOption = None,
    group: GroupOption = None,
) -> None:
    """Score estimates against the truth.

    Without FILE, every log in recordings/ is scored. Each recording is compared with the DH kinematics of its joint
    states, as in the paper, and with the simulator's ground truth. With --alarm-below, alarms are scored against
    the true clearance: recall, precision, share of the safe frames that are alarmed, false alarms per minute and
    lead time.
    """
    from svmdist.cli.log_jobs import ValidateJob
    from svmdist.cli.validate_logs import score_logs
    from svmdist.report.scores import validation_results
    from svmdist.workflows.request import prepare
    from svmdist.workflows.scoring.baseline import (
        load_baseline,
        make_baseline,
        require_same_alarms,
        save_baseline,
    )
    from svmdist.workflows.scoring.truth import Reference, truth_rules

    logs = logs_or_golden(files)
    for target in (output, write_baseline, report):
        require_output(target, local_logs(logs))
    keys = group_keys(group)
    require_report(report)
    writer = choose_writer(form, output, Holds.FIGURES)
    drawn = require_plot("validate", plot, save_plot, local_logs(logs))
    alarms = alarm_rules(alarm_below, alarm_confidence, method.value)
    stored = load_baseline(baseline) if baseline else None
    if stored:
        require_same_alarms(stored, alarms)
    setup = prepare(profile, method.value, equations.value, calibration, hand_eye)
    references = tuple(Reference(choice.value) for choice in dict.fromkeys(truth)) if truth else None
    rules = truth_rules(tuple(truth_tf or ()), setup.profile, references, round(max_gap * 1e9))
    window = window_of(start, end, every)
    wanted = instruments_of(instrument, setup.profile)
    frames = bool(report) or drawn not in (None, PlotKind.FIG6)
    job = ValidateJob(setup, topics_of(topic), window, rules, parse_lag(lag), alarms, wanted, bool(keys))
    scored = score_logs(Many(logs, jobs, scheduler, resume), job, keys, keeps_frames=frames)
    result, measured = scored.validation, scored.measured
    for note in result.notes:
        say(f"svmdist: note: {note}")
    write_results(validation_results(result), writer, output)
    if save_plot and drawn:
        _save_plot(result, measured, setup, rules, drawn, save_plot)
    if report:
        from svmdist.report.html import validation_report, write_report

        with progress_bar("drawing the worst frames", "images") as advance:
            page = validation_report(
                result, measured, setup, rules, command_line(), jobs, scored.ranking, advance
            )
        write_report(page, report)
    code = scored.finish()
    if write_baseline:
        save_baseline(make_baseline(result), write_baseline)
    if stored and _is_worse(result, stored, baseline, complete=not files):
        code = ExitCode.WORSE
    raise typer.Exit(code)


def _is_worse(result: Validation, stored: Baseline, path: Path | None, *, complete: bool) -> bool:
    """Say which figures are worse than those stored."""
    from svmdist.workflows.scoring.baseline import find_regressions

    regressions = find_regressions(result, stored, complete=complete)
    for regression in regressions:
        say(f"svmdist: worse: {regression}")
    if not regressions:
        say(f"svmdist: no figure is worse than in {path}")
    return bool(regressions)


def _save_plot(
    result: Validation, measured: list[Measured], setup: Setup, rules: TruthRules, kind: PlotKind, path: Path
) -> None:
    if kind is PlotKind.FIG6:
        from svmdist.report.plots import save_plot

        save_plot(result, path)
        return
    from svmdist.report.plots import SeriesPlot, save_series_plot
    from svmdist.workflows.series import make_series

    reference = result.primary.reference if result.primary else result.scores[0].reference
    series = [
        made
        for one in measured
        for made in make_series(one.rows, one.recording, setup, rules, reference, one.lag)
    ]
    below_m = result.alarm_rules.below_m if result.alarm_rules else None
    save_series_plot(series, SeriesPlot(kind.value), path, below_m)
