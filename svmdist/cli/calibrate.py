"""`svmdist calibrate`, `hand-eye` and `fk`: the mapping to the plane, the camera-to-base transform, tool poses."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

from svmdist.cli import options, output
from svmdist.cli.logs import LogOptions, OneLogOptions, log_losses
from svmdist.cli.options import FORCE, option
from svmdist.cli.output import LOG, ExitCode
from svmdist.errors import RecordingError, UsageError
from svmdist.report.writers import Holds, Results, choose_writer


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
        from svmdist.cli.jobs import Run
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
        from svmdist.cli.jobs import corrected, served_methods
        from svmdist.profile.hand_eye import save_hand_eye
        from svmdist.report.info import hand_eye_file, hand_eye_results
        from svmdist.results import Failure
        from svmdist.workflows.calibrate import hand_eye
        from svmdist.workflows.request import Request, prepare

        log, path = self.log, self.output
        output.require_toml(path, [log.path], force=self.force)
        writer = choose_writer(self.form, None, Holds.TABLES)
        lag, window, topics = self.given_lag, self.window, self.topics
        failures: list[str] = []
        for method in [self.method] if self.method else served_methods(log.path, self.profile, topics, lag is not None):
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
        from svmdist.cli.jobs import Run, pose_rows_of
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
