"""`svmdist info`, `check`, `show` and `surface`: what is in a log, whether its profile fits, and what images show."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

from svmdist.cli import options, output
from svmdist.cli.logs import LogOptions, OneLogOptions, log_losses
from svmdist.cli.options import JOBS, option
from svmdist.cli.output import LOG, ExitCode
from svmdist.errors import UsageError
from svmdist.files import make_folder
from svmdist.report.writers import Holds

if TYPE_CHECKING:
    from svmdist.recording.log import Recording
    from svmdist.workflows.request import Request

PICTURE_ENDINGS = (".png", ".jpg", ".jpeg", ".svg", ".pdf", ".gif", ".bmp", ".tif", ".tiff", ".webp")
"""Names that mean a picture, and not a folder."""
DEFAULT_COUNT = 6  # pictures where none is asked for: enough to see a log from its beginning to its end


class Info(LogOptions, options.ReadOptions, options.OutputOptions):
    """Show topics, rates, cameras, frames and health.

    It also lists the commands and methods that the recording can serve, and what is missing for the others. Of several
    recordings there is a line each; csv has the topics of all, and json an array with everything.

    Examples:
      Topics, cameras, and the methods that the log can serve:
        svmdist info log.mcap
      The same of a log with a profile of one's own:
        svmdist info log.mcap --profile mine.toml
      For a program:
        svmdist info log.mcap -f json
    """

    def _run(self) -> ExitCode:
        from svmdist.cli.jobs import Run, inspect_log
        from svmdist.report.info import info_results, logs_results
        from svmdist.workflows.request import Request, Setup

        writer = self.writer(self.paths, Holds.TABLES)
        request = Request(Setup.reading(self.profile, self.hand_eye), self.topics)
        run = Run(self, inspect_log, request, dict[str, Any], "inspecting", options=(writer.name != "csv",))
        run.finish()
        found = [(log.name, document) for log, _, document in run.measured]
        output.write_results(info_results(found[0][1]) if self.is_one else logs_results(found), writer, self.output)
        return run.exit_code()


class Check(LogOptions, options.ReadOptions, options.OutputOptions):
    """Compare what a log and its profile show more than once.

    Disparities against the baseline, the tissue by both views against the profile's, the tool by kinematics, shaft, tag
    and disparity against each other and against the image, sizes against an endoscope's field of view. There is a line
    for each comparison: the difference, over its standard deviation, and what could be wrong where it contradicts. The
    same is looked at before the first row of every estimate.

    Exit code 4 if something contradicts.

    Examples:
      Whether a log fits the profile:
        svmdist check log.mcap --profile mine.toml
      In a script:
        svmdist check log.mcap -f json -o check.json
    """

    def _run(self) -> ExitCode:
        from svmdist.cli.jobs import Run, compared_rows
        from svmdist.report.info import check_results
        from svmdist.workflows.request import Request, Setup

        writer = self.writer(self.paths, Holds.TABLES)
        request = Request(Setup.reading(self.profile, self.hand_eye), self.topics)
        run = Run(self, compared_rows, request, list[dict[str, Any]], "comparing")
        rows = [row for found in run.finish() for row in found]
        output.write_results(check_results(rows), writer, self.output)
        code = run.exit_code()  # which also says what was lost
        return ExitCode.WORSE if any(row["verdict"] == "contradicts" for row in rows) else code


class FrameOptions(OneLogOptions):
    """Which image is looked at."""

    frame: int | None = option("--frame N", "The image of this number, from 0.", min=0)
    at: float | None = option("--at SECONDS", "The image nearest to this time after the first.", min=0.0)

    def image_number(self, recording: Recording) -> int | None:
        """The number of the chosen image, None where none is chosen; raises UsageError."""
        from svmdist.workflows.replay import image_stamps_ns

        frame, at_s = self.frame, self.at
        if frame is not None and at_s is not None:
            raise UsageError("--frame and --at choose an image: give one of them")
        if frame is None and at_s is None:
            return None
        stamps_ns = image_stamps_ns(recording)
        if at_s is not None:
            last_s = round((max(stamps_ns) - stamps_ns[0]) * 1e-9, 3)
            if at_s > last_s:
                raise UsageError(f"--at {at_s:g}: the log has {last_s:g} s")
            return min(range(len(stamps_ns)), key=lambda n: abs((stamps_ns[n] - stamps_ns[0]) * 1e-9 - at_s))
        if frame is not None and frame >= len(stamps_ns):
            last = len(stamps_ns) - 1
            raise UsageError(f"--frame {frame}: {recording.path} has {last + 1} images, 0 to {last}")
        return frame


class Show(options.MethodOptions, options.InstrumentOption, options.LagOption, FrameOptions):
    """Show images with what was found in them.

    The pictures are PNG files, with a panel for each phase of the method: six of them, from the first image to the
    last, where none is chosen. The names of the files are printed.

    Examples:
      Each step of a method in one frame:
        svmdist show log.mcap --frame 40 --method fused
      The three worst frames:
        svmdist show log.mcap --worst 3 --method fused -o pictures
      What is segmented, in six frames:
        svmdist show log.mcap --masks
    """

    masks: bool = option("--masks", "Only what is segmented: tissue, shaft, distal part, border.", False)
    worst: int | None = option(
        "--worst N", "The N of largest error, a second apart; of widest interval without truth.", min=1
    )
    output: Path = option("--output -o PATH", "Folder of the pictures, or FILE.png for one.", Path())
    jobs: int | None = JOBS

    def _run(self) -> ExitCode:
        from svmdist.cli.jobs import corrected
        from svmdist.report.on_image import write_picture
        from svmdist.report.panels import masks_picture, phases_picture
        from svmdist.workflows.frame_drawing import Segmented, drawn_frames
        from svmdist.workflows.request import Request, prepare

        if sum(choice is not None for choice in (self.frame, self.at, self.worst)) > 1:
            raise UsageError("--frame, --at and --worst choose images: give one of them")
        if self.masks and self.worst is not None:
            raise UsageError("--worst needs what a method measured, which --masks does not show")
        lag, folder = self.given_lag, self.output
        method = Segmented() if self.masks else self.chosen_method([self.log.path])
        setup = prepare(self.profile, method, "corrected", self.calibration, self.hand_eye)
        request = Request(setup, self.topics, instruments=self.instruments(setup.profile), lag=lag)
        recording = request.open(self.log.path, self.log.name)
        seen = corrected(recording, request, self.jobs)
        numbers = self._numbers(seen, request)
        count = left = len(numbers)
        is_one = folder.suffix.lower() in PICTURE_ENDINGS and not folder.is_dir()
        if is_one and folder.suffix.lower() != ".png":
            raise UsageError(f"{folder}: pictures are PNG files: give a name in .png, or a folder")
        if is_one and count > 1:
            raise UsageError(f"{folder}: is one picture, and {count} are asked for: give --frame, --at, or a folder")
        make_folder(folder.parent if is_one else folder, "make the folder")
        with output.watched(seen, f"drawing {seen.name}") as log:
            for shown in drawn_frames(log, setup, self.jobs, numbers):
                where = f"{log.name}  frame {shown.number}"
                if self.masks:
                    picture = masks_picture(shown, f"{where}  {shown.seconds:.2f} s  masks")
                else:
                    picture = phases_picture(shown, f"{where}  method {setup.method}", setup.method)
                path = folder if is_one else folder / f"{recording.name}-{shown.number:05d}.png"
                write_picture(path, picture)
                output.write_lines([f"{path}\n"], None)
                left -= 1
        self.say_choice()
        if left:
            LOG.info("%d of %d images cannot be read, and are not drawn", left, count)
        return log_losses(recording.path, recording.health)

    def _numbers(self, recording: Recording, request: Request) -> set[int]:
        """The numbers of the images to draw; says of each of the worst how bad it is."""
        from svmdist.workflows.estimate import Measured, estimate, series_of, worst_frames
        from svmdist.workflows.replay import image_stamps_ns

        if (chosen := self.image_number(recording)) is not None:
            return {chosen}
        if self.worst is None:
            last = len(image_stamps_ns(recording)) - 1
            gaps = min(last, DEFAULT_COUNT - 1)  # between the pictures
            return {round(at * last / max(gaps, 1)) for at in range(gaps + 1)}
        with output.watched(recording, f"measuring {recording.name}") as log:
            rows = tuple(estimate(log, request.setup, self.jobs))
        worst = worst_frames(series_of([Measured(recording, recording, rows, recording.lag)], request), self.worst)
        for one in worst:
            LOG.info("%s", one.in_words)
        return {one.number for one in worst}


class Surface(options.ReadOptions, FrameOptions, options.OutputOptions):
    """Measure the tissue's surface by both views.

    A point for every few pixels of the tissue that both views show, in the left camera's frame: x, y and z in m,
    the normal, the standard deviation along the line of sight, and the colour. What instruments and highlights hide,
    and what does not match, is left open. No instrument, and no [tissue] in the profile, is needed.

    Examples:
      As a point cloud that viewers show:
        svmdist surface log.mcap --frame 40 -o tissue.ply
      As a table:
        svmdist surface log.mcap --at 4.5 -o tissue.csv
    """

    form: str | None = options.format_option(Holds.CLOUD)

    def _run(self) -> ExitCode:
        import numpy as np

        from svmdist.report.rows import cloud_results
        from svmdist.workflows.check import tissue_surface
        from svmdist.workflows.request import Request, Setup

        writer = self.writer([self.log.path], Holds.CLOUD)
        setup = Setup.reading(self.profile, self.hand_eye)
        with output.progress_bar(f"looking at {self.log.name}"):
            recording = Request(setup, self.topics).open(self.log.path, self.log.name)
            found = tissue_surface(recording, self.image_number(recording) or 0)
        output.write_results(cloud_results(found), writer, self.output)
        near_m, far_m = np.percentile(found.points_m[:, 2], (1.0, 99.0))  # of all but the outermost points
        LOG.info(
            "frame %d: %d points, %.0f %% of the tissue in view, %.0f to %.0f mm away, deviation %.2f mm (median)",
            *(found.number, len(found.points_m), 100.0 * found.share),
            *(1e3 * length_m for length_m in (near_m, far_m, np.median(found.std_m))),
        )
        return log_losses(recording.path, recording.health)
