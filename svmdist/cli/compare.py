"""`svmdist compare`: all methods on the same logs."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Annotated

import typer

from svmdist.cli.console import ExitCode, require_output, write_results
from svmdist.cli.degradations import parse_degradations
from svmdist.cli.many import GroupOption, Many, ResumeOption, SchedulerOption, group_keys, group_name
from svmdist.cli.options import (
    CalibrationOption,
    HandEyeOption,
    JobsOption,
    LagOption,
    Method,
    OptionalFiles,
    OutputOption,
    PlotOption,
    ProfileOption,
    SummaryFormatOption,
    TopicOption,
    parse_lag,
    topics_of,
)
from svmdist.cli.perturbations import parse_perturb_groups
from svmdist.cli.plots import ComparePlotOption, require_plot
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
from svmdist.report.writers import Holds, choose_writer


def compare_command(
    files: OptionalFiles = None,
    method: Annotated[
        list[Method] | None,
        typer.Option(
            "--method",
            metavar="|".join(Method),
            help="A method to compare; may be repeated. Default: all.",
            show_default=False,
        ),
    ] = None,
    degrade: Annotated[
        list[str] | None,
        typer.Option(
            "--degrade",
            metavar="NAME=SEVERITY",
            help="Also measure with the images degraded, as in smoke=3. May be repeated; each is applied alone.",
            show_default=False,
        ),
    ] = None,
    perturb: Annotated[
        list[str] | None,
        typer.Option(
            "--perturb",
            metavar="NAME=STRENGTH",
            help="Also measure in a world that is not as log and profile say, as in focal=1 or lag=30. May be "
            "repeated; each is applied alone, NAME=STRENGTH,NAME=STRENGTH together. Names: docs/simulation.md.",
            show_default=False,
        ),
    ] = None,
    calibration: CalibrationOption = None,
    profile: ProfileOption = "psm13",
    hand_eye: HandEyeOption = None,
    topic: TopicOption = None,
    lag: LagOption = None,
    form: SummaryFormatOption = None,
    output: OutputOption = None,
    jobs: JobsOption = None,
    start: StartOption = 0.0,
    end: EndOption = None,
    every: EveryOption = 1,
    scheduler: SchedulerOption = None,
    resume: ResumeOption = None,
    group: GroupOption = None,
    save_plot: PlotOption = None,
    plot: ComparePlotOption = None,
) -> None:
    """Measure with all methods side by side.

    Each image is read once for all methods. The metrics are given per scenario and degradation or perturbation,
    and over all frames. Without FILE, every log in recordings/ is measured.
    """
    from svmdist.cli.lag import told_lag
    from svmdist.report.scores import compare_results
    from svmdist.vision.degradations import require_degradation
    from svmdist.workflows.compare import compare, compared
    from svmdist.workflows.conditions import CLEAN, Condition, LogCondition, PerturbedCondition
    from svmdist.workflows.request import prepare

    logs = logs_or_golden(files)
    require_output(output, local_logs(logs))
    writer = choose_writer(form, output, Holds.FIGURES)
    keys = group_keys(group)
    drawn = require_plot("compare", plot, save_plot, local_logs(logs))
    given = parse_lag(lag)
    conditions: list[LogCondition] = [CLEAN]
    conditions += [
        Condition(require_degradation(name, severity), severity)
        for name, severity in dict.fromkeys(parse_degradations("--degrade", degrade))
    ]
    worlds = dict.fromkeys(parse_perturb_groups("--perturb", perturb))
    conditions += [PerturbedCondition(perturbations) for perturbations in worlds]
    methods = list(dict.fromkeys(method)) if method else list(Method)
    planar = (Method.OVERLAY, Method.CENTROID)
    setups = [
        prepare(profile, chosen.value, "corrected", calibration if chosen in planar else None, hand_eye)
        for chosen in methods
    ]
    window = window_of(start, end, every)
    many = Many(logs, jobs, scheduler, resume)
    code: Callable[[], ExitCode]
    if many.is_asked_for or many.fills_cores:
        from svmdist.cli.log_jobs import CompareJob

        job = CompareJob(tuple(setups), tuple(conditions), topics_of(topic), window, given, keys)
        with many.measured(job, "comparing") as outcomes:
            scores = compared([run for _, result in outcomes.measured for run in result.runs], setups)
            code = outcomes.code
    else:
        opened = open_recordings(logs, setups[0].profile, topics_of(topic), window)
        recordings = [told_lag(recording, setups[0], given, None, jobs) for recording in opened.recordings]
        by = partial(group_name, keys=keys) if keys else None
        with progress_bar("comparing", "measurements") as advance:
            scores = compare(recordings, setups, conditions, jobs=jobs, on_progress=advance, by=by)
        code = opened.health_code
    write_results(compare_results(scores), writer, output)
    if save_plot and drawn:
        from svmdist.report.plots import save_compare_plot

        save_compare_plot(scores, save_plot)
    raise typer.Exit(code())
