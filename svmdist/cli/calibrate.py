"""`svmdist calibrate`: fit the mapping from pixels to the plane."""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

import typer

from svmdist.cli.console import ExitCode, require_output, say
from svmdist.cli.many import Many, ResumeOption, SchedulerOption
from svmdist.cli.options import Files, JobsOption, PlanarMethod, ProfileOption, TopicOption, topics_of
from svmdist.cli.progress import progress_bar
from svmdist.cli.recordings import (
    EndOption,
    EveryOption,
    StartOption,
    local_logs,
    named_logs,
    open_recordings,
    window_of,
)
from svmdist.errors import UsageError


def calibrate_command(
    files: Files,
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", metavar="FILE.toml", help="Calibration file to write.", show_default=False
        ),
    ],
    method: Annotated[
        PlanarMethod, typer.Option("--method", help="The planar method that will use the mapping.")
    ] = PlanarMethod.OVERLAY,
    profile: ProfileOption = "psm13",
    topic: TopicOption = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the file if it exists.")] = False,
    start: StartOption = 0.0,
    end: EndOption = None,
    every: EveryOption = 1,
    jobs: JobsOption = None,
    scheduler: SchedulerOption = None,
    resume: ResumeOption = None,
) -> None:
    """Fit the mapping from pixels to the plane.

    This fits eqs. (5) and (6) of the paper, one quadratic polynomial per axis, to recordings with ground truth.
    """
    from svmdist.estimation.plane_mapping import save_calibration
    from svmdist.profile import load_profile
    from svmdist.workflows.calibrate import collect_part, fit_parts
    from svmdist.workflows.parallel import Steps, image_total

    logs = named_logs(files)
    require_output(output, local_logs(logs))
    if os.path.exists(output) and not force:
        raise UsageError(f"{output} exists; --force replaces it")
    window = window_of(start, end, every)
    loaded = load_profile(profile)
    many = Many(logs, jobs, scheduler, resume)
    finish: Callable[[], ExitCode]
    if len(logs) > 1 or many.is_asked_for:
        from svmdist.cli.log_jobs import CalibrateJob

        with many.measured(
            CalibrateJob(loaded, method.value, topics_of(topic), window), "measuring"
        ) as outcomes:
            calibration = fit_parts([part for _, part in outcomes.measured], method.value)
            finish = outcomes.code
    else:
        opened = open_recordings(logs, loaded, topics_of(topic), window)
        with progress_bar("calibrating", "images") as advance:
            steps = Steps(advance, image_total(opened.recordings))
            parts = [collect_part(one, loaded, method.value, jobs, steps) for one in opened.recordings]
        calibration = fit_parts(parts, method.value)
        finish = opened.health_code
    save_calibration(calibration, output)
    fit = calibration.fit
    say(
        f"svmdist: {output}: {fit.sample_count} frames, residual RMSE x {fit.rmse_x_m * 1e3:.3f} mm,"
        f" y {fit.rmse_y_m * 1e3:.3f} mm, max {fit.max_error_m * 1e3:.3f} mm; pixels"
        f" x {fit.span_x_px[0]:.0f}–{fit.span_x_px[1]:.0f}, y {fit.span_y_px[0]:.0f}–{fit.span_y_px[1]:.0f}"
    )
    raise typer.Exit(finish())
