"""`svmdist calibrate`, `hand-eye` and `fk`: the mapping to the plane, the camera-to-base transform, tool poses."""

from __future__ import annotations

import math
from collections.abc import Generator
from contextlib import closing
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from svmdist.cli import options, output
from svmdist.cli.estimate import corrected
from svmdist.cli.logs import LogOptions, OneLogOptions, Run, log_losses
from svmdist.cli.options import FORCE, option
from svmdist.cli.output import LOG, ExitCode
from svmdist.errors import RecordingError, UsageError
from svmdist.report.writers import Holds, Results, choose_writer

if TYPE_CHECKING:
    from svmdist.profile import Profile
    from svmdist.recording.log import Recording
    from svmdist.remote import LogPath
    from svmdist.report.tables import Row
    from svmdist.transforms import Array
    from svmdist.workflows.request import Request


class Calibrate(LogOptions, options.ReadOptions, options.WindowOptions):
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

    output: Path = option("--output -o FILE.toml", "Calibration file to write.", ...)
    method: Literal["overlay", "centroid"] = option("--method NAME", "overlay (the default) or centroid.", "overlay")
    force: bool = FORCE

    def _run(self) -> ExitCode:
        from svmdist.estimation.plane_mapping import save_calibration
        from svmdist.profile import load_profile
        from svmdist.workflows.calibrate import CalibrationPart, collect_part, fit_parts
        from svmdist.workflows.request import Request, Setup

        output.require_toml(self.output, self.paths, force=self.force)
        request = Request(Setup(load_profile(self.profile, self.hand_eye), self.method), self.topics, self.window)
        run = Run(self, collect_part, request, CalibrationPart, "measuring", "images")
        calibration = fit_parts(run.finish(), self.method)
        save_calibration(calibration, self.output)
        fit = calibration.fit
        LOG.info(
            "%s: %d frames, residual RMSE x %.3f mm, y %.3f mm, max %.3f mm; pixels x %.0f–%.0f, y %.0f–%.0f",
            self.output,
            fit.sample_count,
            *(1e3 * error_m for error_m in (fit.rmse_x_m, fit.rmse_y_m, fit.max_error_m)),
            *fit.span_x_px,
            *fit.span_y_px,
        )
        return run.exit_code()


class HandEye(OneLogOptions, options.TopicOption, options.InstrumentOption, options.LagOption, options.WindowOptions):
    """Fit the camera-to-base transform.

    The tool as the images show it is compared with the joints or poses that the robot reports. The result has a
    covariance, and is used by every command whose profile names the file, or by --hand-eye.

    Examples:
      Fit by the tag on the instrument:
        svmdist hand-eye log.mcap --method fiducial -o hand-eye.toml
      Use the transform:
        svmdist estimate log.mcap --method fused --hand-eye hand-eye.toml
    """

    profile: str = options.PROFILE
    method: Literal["fiducial", "stereo", "shaft"] | None = option(
        "--method NAME", "fiducial, stereo or shaft. Default: the first that finds the tool."
    )
    against: Literal["kinematics", "pose"] | None = option(
        "--against NAME",
        "kinematics (of the joints), or the robot's pose. Default: kinematics where log and profile have them.",
    )
    form: str | None = options.format_option(Holds.TABLES, ", of what is printed. Default: ")
    output: Path | None = option(
        "--output -o FILE.toml", 'For the transforms; a profile names it: hand_eye = "FILE.toml".'
    )
    force: bool = FORCE
    jobs: int | None = options.JOBS

    def _run(self) -> ExitCode:
        from svmdist.profile import load_profile
        from svmdist.profile.hand_eye import save_hand_eye
        from svmdist.report.info import hand_eye_file, hand_eye_results
        from svmdist.results import Failure
        from svmdist.workflows.calibrate import hand_eye
        from svmdist.workflows.request import Request, prepare

        log, path = self.log, self.output
        output.require_toml(path, [log.path], force=self.force)
        writer = choose_writer(self.form, None, Holds.TABLES)
        lag, window, topics = self.given_lag, self.window, self.topics
        profile, has_lag = load_profile(self.profile), lag is not None
        methods = [self.method] if self.method else _served(log.path, profile, topics, has_lag)
        failures: list[str] = []
        for method in methods:
            setup = prepare(self.profile, method)
            request = Request(setup, topics, window, self.instruments(setup.profile), lag)
            recording = request.open(log.path, log.name)
            seen = corrected(recording, request, self.jobs)
            results = []
            for name in recording.measured:
                with output.watched(seen, f"{method} finds {name}") as watched:
                    found = hand_eye(watched, setup, name, self.against, self.jobs)
                if isinstance(found, Failure):
                    failures.append(f"{method}, {name}: {found.reason}")
                else:
                    results.append(found)
            if results:
                break
        else:
            raise RecordingError(f"{log.path}: no transform can be estimated: {'; '.join(failures)}")
        output.write_results(hand_eye_results(results), writer, None)
        for failure in failures:
            LOG.info("note: %s", failure)
        if path is not None:
            save_hand_eye(path, hand_eye_file(results, recording))
            LOG.info('%s: %d transforms; in a profile: hand_eye = "%s"', path, len(results), path.name)
        return log_losses(recording.path, recording.health)


def _served(file: LogPath, profile: Profile, topics: dict[str, str], has_lag: bool) -> list[str]:
    """The methods that log and profile serve, the surest first; RecordingError where there is none."""
    from svmdist.recording.log import open_recording
    from svmdist.recording.summary import inspect_recording
    from svmdist.workflows.calibrate import SEEING_METHODS
    from svmdist.workflows.capabilities import method_capabilities, misfit

    summary = inspect_recording(open_recording(file, profile, topics=topics))
    if said := misfit(summary):
        raise RecordingError(f"{file}: {said}")
    lacks = method_capabilities(summary.at_any_lag() if has_lag else summary)
    if served := [name for name in SEEING_METHODS if not lacks[name]]:
        return served
    lacking = "; ".join(f"{name} lacks {', '.join(lacks[name])}" for name in SEEING_METHODS)
    raise RecordingError(f"{file}: no method can see the tool: {lacking}")


class Fk(LogOptions, options.ReadOptions, options.WindowOptions, options.OutputOptions):
    """Print the tool's pose for every joint state.

    The forward kinematics of the profile's chain, in its base frame. Errors against the log's poses are on stderr.
    --start, --end and --every count joint states in place of images.

    Examples:
      The tool's pose for each joint state:
        svmdist fk log.mcap -o poses.csv
      In the camera's frame, for evo:
        svmdist fk log.mcap --in-camera -o poses.tum
    """

    joints: str | None = option("--joints TOPIC", "Topic of the joint states.")
    in_camera: bool = option("--in-camera", "In the camera's frame.", False)
    form: str | None = options.format_option(Holds.POSES)

    def _run(self) -> ExitCode:
        from svmdist.metrics import TEXT, Column
        from svmdist.report.rows import POSE_COLUMNS
        from svmdist.workflows.request import Request, Setup

        writer = self.writer(self.paths, Holds.POSES)
        several = len(self.logs) > 1
        if writer.name == "tum" and several:
            raise UsageError(f"--format tum writes one trajectory, and {len(self.logs)} logs are given")
        topics = self.topics
        if self.joints and topics.setdefault("joints", self.joints) != self.joints:
            raise UsageError(f"--joints {self.joints} and --topic joints={topics['joints']}: give one of them")
        setup, instruments = Setup.reading(self.profile, self.hand_eye), None
        for other in setup.profile.other_instruments:
            if other.logged_topics.get("joints", "") == topics.get("joints"):
                instruments = (other.name,)
                del topics["joints"]  # which would make them the first one's
        request = Request(setup, topics, self.window, instruments)
        run = Run(self, pose_rows_of, request, int, "computing", options=(self.in_camera, several))
        columns = (*POSE_COLUMNS, Column("recording", TEXT)) if several else POSE_COLUMNS
        _, rows = run.begun(1, self.output)
        output.write_results(Results(columns, rows), writer, self.output)
        return run.exit_code()


def pose_rows_of(
    recording: Recording, request: Request, _threads: int, in_camera: bool, named: bool
) -> Generator[Row, None, int]:
    """The rows of an instrument of one recording, which name it where there are several.

    What they leave out, and errors against its poses, are logged.
    """
    import numpy as np

    from svmdist.report.rows import pose_rows
    from svmdist.workflows.calibrate import fk_blocks

    of, name = f"{recording.name}: " if named else "", recording.measured[0]
    first, *others = [recording.for_instrument(one).topic_of("joints") for one in recording.instruments]
    if request.instruments is None and "joints" not in request.topics and first and any(others):
        choices = ", ".join(filter(None, others))
        LOG.info("note: %sthese are the joints of %s; --joints TOPIC takes another's: %s", of, name, choices)
    recording = recording.for_instrument(name)
    errors, count = [], 0
    with output.progress_bar("reading joint states"), closing(fk_blocks(recording, in_camera=in_camera)) as made:
        for stamps_ns, poses, block_errors in made:
            errors.append(block_errors)
            for row in pose_rows(stamps_ns, poses):
                yield {**row, "recording": recording.name} if named else row
                count += 1
    if lost := sum(map(len, errors)) - count:
        said = "note: %s%d of %d joint states are left out: no transform from camera to base is near them in time"
        LOG.info(said, of, lost, lost + count)
    if recording.topic_of("pose") is not None:
        _log_errors(np.concatenate(errors), recording.pose_track().parent, of)
    return count


def _log_errors(errors: Array, frame_id: str | None, of: str) -> None:
    """Log errors against the poses of a topic, shape (n, 2): position in m and angle in rad, NaN without a pose."""
    import numpy as np

    # What floating point rounds is no error, and differs between processors.
    known = np.round(errors[np.isfinite(errors[:, 0])] * [1e3, math.degrees(1.0)], 9)
    if len(known) == 0:
        LOG.info("%sno pose of the topic (frame %s) is near a joint state in time", of, frame_id)
        return
    (rmse_mm, rmse_deg), (max_mm, max_deg) = np.sqrt(np.mean(known**2, axis=0)), known.max(axis=0)
    LOG.info(
        "%sagainst %d poses in frame %s: position RMSE %.4g mm, max %.4g mm; angle RMSE %.4g°, max %.4g°;"
        " %d joint states without a pose",
        *(of, len(known), frame_id, rmse_mm, max_mm, rmse_deg, max_deg, len(errors) - len(known)),
    )
