"""`svmdist calibrate`: fit the mapping from pixels to the plane."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from svmdist.cli.logs import Logs
from svmdist.cli.options import (
    FORCE,
    LogOptions,
    PlanarMethod,
    ReadOptions,
    WindowOptions,
    option,
    output_option,
)
from svmdist.cli.output import LOG, progress_bar, require_new, require_output

if TYPE_CHECKING:
    from svmdist.recording.log import Recording
    from svmdist.workflows.calibrate import CalibrationPart
    from svmdist.workflows.request import Request


class CalibrateOptions(LogOptions, ReadOptions, WindowOptions):
    """What `calibrate` takes."""

    output: Path = output_option("FILE.toml", "Calibration file to write.", ...)
    method: PlanarMethod = option("overlay", "--method", "The planar method that will use the mapping.")
    force: bool = FORCE


def calibrate_command(given: CalibrateOptions) -> None:
    """Fit the mapping from pixels to the plane.

    This fits eqs. (5) and (6) of the paper, one quadratic polynomial per axis, to recordings with ground truth.

    Examples:
      Fit on a log with ground truth:
        svmdist calibrate calibration.mcap -o camera.toml
      On its second half, and use the result:
        svmdist calibrate calibration.mcap --start 4 -o half.toml
      Use a calibration:
        svmdist validate log.mcap --calibration camera.toml
    """
    from svmdist.estimation.plane_mapping import save_calibration
    from svmdist.profile import load_profile
    from svmdist.workflows.batch import Job
    from svmdist.workflows.calibrate import CalibrationPart, fit_parts
    from svmdist.workflows.request import Request, Setup

    logs = Logs(given)
    require_output(given.output, logs.paths)
    require_new(given.output, force=given.force)
    setup = Setup(load_profile(given.profile, given.hand_eye), given.method)
    request = Request(setup, given.topics, given.window)
    run = logs.run(Job(collect_log, request, CalibrationPart), "measuring")
    calibration = fit_parts(run.results, setup.method)
    save_calibration(calibration, given.output)
    fit = calibration.fit
    LOG.info(
        "%s: %d frames, residual RMSE x %.3f mm, y %.3f mm, max %.3f mm; pixels x %.0f–%.0f, y %.0f–%.0f",
        given.output,
        fit.sample_count,
        *(1e3 * error_m for error_m in (fit.rmse_x_m, fit.rmse_y_m, fit.max_error_m)),
        *fit.span_x_px,
        *fit.span_y_px,
    )
    raise typer.Exit(run.exit_code())


def collect_log(recording: Recording, request: Request, threads: int) -> CalibrationPart:
    """Measure one recording for a calibration, with progress."""
    from svmdist.workflows.calibrate import collect_part
    from svmdist.workflows.parallel import Steps

    with progress_bar("calibrating", "images") as advance:
        steps = Steps(advance, recording.image_count())
        return collect_part(recording, request.setup.profile, request.setup.method, threads, steps)
