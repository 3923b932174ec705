"""`svmdist calibrate`: fit the mapping from pixels to the plane."""

from __future__ import annotations

import os
from pathlib import Path
from typing import Annotated

import typer

from svmdist.cli.console import report_health, require_output, say
from svmdist.cli.options import Files, PlanarMethod, ProfileOption, TopicOption, topics_of
from svmdist.cli.progress import progress_bar
from svmdist.cli.recordings import EndOption, EveryOption, StartOption, window_of
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
) -> None:
    """Fit the mapping from pixels to the plane.

    This fits eqs. (5) and (6) of the paper, one quadratic polynomial per axis, to recordings with ground truth.
    """
    from svmdist.estimation.planar.calibration import save_calibration
    from svmdist.profile import load_profile
    from svmdist.recording.reader import open_recording
    from svmdist.recording.reading import Reading
    from svmdist.workflows.calibrate import calibrate

    require_output(output, files)
    if os.path.exists(output) and not force:
        raise UsageError(f"{output} exists; --force replaces it")
    window = window_of(start, end, every)
    loaded = load_profile(profile)
    recordings = [
        open_recording(path, loaded, topics=topics_of(topic)).read_as(Reading(window=window))
        for path in files
    ]
    with progress_bar("calibrating", "images") as advance:
        calibration = calibrate(recordings, loaded, method.value, advance)
    save_calibration(calibration, output)
    fit = calibration.fit
    say(
        f"svmdist: {output}: {fit.sample_count} frames, residual RMSE x {fit.rmse_x_m * 1e3:.3f} mm,"
        f" y {fit.rmse_y_m * 1e3:.3f} mm, max {fit.max_error_m * 1e3:.3f} mm; pixels"
        f" x {fit.span_x_px[0]:.0f}–{fit.span_x_px[1]:.0f}, y {fit.span_y_px[0]:.0f}–{fit.span_y_px[1]:.0f}"
    )
    raise typer.Exit(report_health(recordings))
