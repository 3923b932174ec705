"""`svmdist estimate`, `calibrate`, `hand-eye` and `fk`: commands that measure; and plots and reports of all rows."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

from svmdist.cli import options, output
from svmdist.cli.logs import GroupOption, LogOptions, OneLogOptions, log_losses
from svmdist.cli.options import FORCE, option
from svmdist.cli.output import LOG, ExitCode, next_command
from svmdist.errors import RecordingError, UsageError, concealed
from svmdist.files import write_atomically
from svmdist.report.writers import Holds, Results, Writer, choose_writer

if TYPE_CHECKING:
    from svmdist.cli.jobs import Run
    from svmdist.remote import LogPath
    from svmdist.workflows.estimate import Ending
    from svmdist.workflows.request import Request
    from svmdist.workflows.validate import Validation


class PictureOptions(options.OutputOptions):
    """What is drawn of all rows together."""

    report: Path | None = option("--report FILE.html", "Page with interactive plots and the worst frames.")
    save_plot: Path | None = options.PLOT

    def require_pictures(self, inputs: list[LogPath], kind: str | None = None) -> None:
        """Check names and packages before the work; raises UsageError or OutputError."""
        output.require_plot(self.save_plot, inputs, kind)
        if self.report is not None:
            output.require_output(self.report, inputs)
            if self.report.suffix.lower() not in (".html", ".htm"):
                raise UsageError(f"--report {self.report}: a report is a page: give it the ending .html")
            choose_writer(None, self.report, Holds.REPORT)

    def draw(self, run: Run[Any], request: Request, result: Validation | None = None, kind: str = "") -> None:
        """Draw the plot and the report of what was measured, and validated."""
        from svmdist.workflows.estimate import series_of

        measured = run.kept()
        series = series_of(measured, request, result.reference if result else None)
        if self.save_plot:
            from svmdist.report import plots

            if result and kind == "fig6":
                plots.save_figure(self.save_plot, plots.draw, result)
            else:
                plots.save_figure(self.save_plot, plots.draw_series, series, kind or "time")
        if self.report:
            from svmdist.report.html import make_report, page

            command = next_command(*map(concealed, sys.argv[1:]))
            jobs, logs = run.given.jobs, None if run.given.is_one else run.ranking()
            with output.progress_bar("drawing the worst frames", "images") as advance:
                watched = [replace(one, read=replace(one.read, on_progress=advance)) for one in measured]
                report = make_report(series, watched, request, command, result, jobs, logs)
            write_atomically(self.report, [page(report)])


class Estimate(LogOptions, options.MeasureOptions, GroupOption, PictureOptions):
    """Estimate the distance in every frame.

    A row per frame and instrument. -o FILE.mcap writes a copy of the log with what was found drawn on its images, for
    Foxglove and Lichtblick; .rrd the same for Rerun, .mp4 a video, .html a report.

    Examples:
      A row per frame, as CSV:
        svmdist estimate log.mcap --method fused -o rows.csv
      Alarms where the clearance may be below 5 mm:
        svmdist estimate log.mcap --method fused --alarm-below 5mm
      For Foxglove and Lichtblick:
        svmdist estimate log.mcap --method fused -o seen.mcap
      Seconds 2 to 5, every fourth image, as a video:
        svmdist estimate log.mcap --start 2 --end 5 --every 4 -o seen.mp4
    """

    form: str | None = options.format_option(Holds.ROWS)
    force: bool = option("--force", "Replace a log that exists; other files are anyway.", False)
    summary: Path | None = option("--summary FILE", "Figures of each log, worst first; as .csv, .md, ….")

    def _run(self) -> ExitCode:
        from svmdist.cli.jobs import Run, draw_log, log_ending, log_tally, measure_rows
        from svmdist.workflows.estimate import Ending

        writer = self.writer(self.paths, Holds.ROWS | Holds.FRAMES | Holds.REPORT)
        self._require_one_kind(writer)
        if writer.holds is Holds.REPORT:
            self.report = self.output
        keys = self.group_keys
        self.require_pictures(self.paths)
        if keys and self.summary is None:
            raise UsageError(f"--group {self.group}: groups the figures of logs: give --summary FILE for them")
        output.require_output(self.summary, self.paths)
        summary_writer = choose_writer(None, self.summary, Holds.FIGURES, "--summary")
        request = self.request(self.paths)
        if writer.name == "tum" and request.setup.is_planar:
            raise UsageError(f"--format tum writes the tool's pose: choose a method in 3D, not {request.setup.method}")
        draws = self.report is not None or self.save_plot is not None
        if writer.holds is Holds.FRAMES:
            run = Run(self, draw_log, request, Ending, "drawing", options=(writer, self.output, self.force))
        else:
            run = Run(self, measure_rows, request, Ending, "measuring", keeps=draws, keys=keys)
        if writer.holds & (Holds.FRAMES | Holds.REPORT):
            run.finish()
        else:
            self._write_rows(run, request, writer)
        if self.summary is not None:
            output.write_results(run.ranking(), summary_writer, self.summary)
        self.say_choice()
        measured = log_tally(run.results)
        log_ending({log.name: ending for log, _, ending in run.measured}, request)
        self._say_next({str(log.path): ending for log, _, ending in run.measured}, request)
        if draws:
            self.draw(run, request)
        return run.exit_code(measured)

    def _say_next(self, endings: Mapping[str, Ending], request: Request) -> None:
        """Log the smallest clearance, and the command that shows it; without any, the one that says why."""
        from svmdist.profile import DEFAULT_PROFILE

        reading = ["--profile", self.profile] if self.profile != DEFAULT_PROFILE else []
        reading += ["--hand-eye", str(self.hand_eye)] if self.hand_eye else []
        reading += [word for topic in self.topic or [] for word in ("--topic", topic)]
        found = [(path, ending, ending.least) for path, ending in endings.items() if ending.least is not None]
        if (guesses := request.setup.profile.guesses) and not request.setup.is_planar:
            LOG.info("guessed in %s, so that distances are as unsure: %s", self.profile, guesses)
        if found:
            path, ending, least = min(found, key=lambda one: one[2].distances.clearance.value_m)  # type: ignore[union-attr]
            frame = ["--frame", str(least.number), "--method", request.setup.method]
            where = f"{path}: " if len(endings) > 1 else ""
            LOG.info("%s%s: %s", where, ending.least_in_words, next_command("show", path, *frame, *reading))
            return
        statuses = set().union(*(ending.statuses for ending in endings.values()))
        for path in list(endings)[:1]:
            command = ["info", path]  # says what each method lacks
            if statuses & {"no_tissue", "no_instrument"}:
                command = ["show", path, "--masks"]
            elif statuses & {"inconsistent", "uncertain"}:
                command = ["check", path]
            LOG.info("next: %s", next_command(*command, *reading))

    def _require_one_kind(self, writer: Writer) -> None:
        """Raise UsageError where a file of images or a report is asked for, and something else, too."""
        name = self.output
        if writer.holds is Holds.FRAMES:
            if self.report or self.save_plot:
                raise UsageError(f"--report and --save-plot go with rows: write {name} by itself")
            if len(self.logs) > 1:
                raise UsageError(f"{name}: holds one recording, and {len(self.logs)} are given")
            if not self.is_one or self.summary is not None:
                raise UsageError(f"--scheduler, --resume and --summary go with rows: write {name} by itself")
        elif writer.holds is Holds.REPORT and self.report is not None:
            raise UsageError(f"--report {self.report} and -o {name}: both are the report; leave out one")

    def _write_rows(self, run: Run[Ending], request: Request, writer: Writer) -> None:
        from svmdist.report.rows import ESTIMATE_COLUMNS, shown_columns
        from svmdist.report.tables import text_lines

        head, every = run.begun(2, self.output)
        several = len({row.get("instrument") for row in head}) > 1 or any(
            len(ending.events) > 1 for ending in run.results
        )
        if writer.name == "tum" and several:
            raise UsageError("--format tum writes one trajectory: choose an instrument with --instrument")

        def text(width: int | None) -> Iterator[str]:
            planar, alarms = request.setup.is_planar, request.alarms is not None
            return text_lines(shown_columns(width, planar=planar, several=several, alarms=alarms), every)

        output.write_results(Results(ESTIMATE_COLUMNS, every, text), writer, self.output)


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
