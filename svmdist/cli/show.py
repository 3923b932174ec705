"""`svmdist show` and `surface`: pictures of what the methods see in a log's images, and the tissue that one shows."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

from svmdist.cli import options, output
from svmdist.cli.estimate import corrected
from svmdist.cli.logs import OneLogOptions, log_losses
from svmdist.cli.options import JOBS, option
from svmdist.cli.output import LOG, ExitCode
from svmdist.errors import UsageError
from svmdist.files import make_folder
from svmdist.report.writers import Holds

if TYPE_CHECKING:
    from svmdist.recording.log import Recording
    from svmdist.samples import Image
    from svmdist.workflows.request import Request

DEFAULT_COUNT = 6  # pictures where none is asked for: enough to see a log from its beginning to its end
PICTURE_ENDINGS = (".png", ".jpg", ".jpeg", ".svg", ".pdf", ".gif", ".bmp", ".tif", ".tiff", ".webp")
"""Names that mean a picture, and not a folder."""


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
        from svmdist.report.on_image import write_picture
        from svmdist.workflows.frame_drawing import Segmented
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
        is_one = _is_one_picture(folder, len(numbers))
        make_folder(folder.parent if is_one else folder, "make the folder")
        left = len(numbers)
        for number, picture in self._pictures(seen, request, numbers):
            path = folder if is_one else folder / f"{recording.name}-{number:05d}.png"
            write_picture(path, picture)
            output.write_lines([f"{path}\n"], None)
            left -= 1
        self.say_choice()
        if left:
            LOG.info("%d of %d images cannot be read, and are not drawn", left, len(numbers))
        return log_losses(recording.path, recording.health)

    def _numbers(self, recording: Recording, request: Request) -> set[int]:
        from svmdist.workflows.replay import image_stamps_ns

        if self.worst is not None:
            return _worst(recording, request, self.worst, self.jobs)
        if (chosen := self.image_number(recording)) is not None:
            return {chosen}
        last = len(image_stamps_ns(recording)) - 1
        gaps = min(last, DEFAULT_COUNT - 1)  # between the pictures
        return {round(at * last / max(gaps, 1)) for at in range(gaps + 1)}

    def _pictures(self, log: Recording, request: Request, numbers: set[int]) -> Iterator[tuple[int, Image]]:
        from svmdist.report.panels import masks_picture, phases_picture
        from svmdist.workflows.frame_drawing import drawn_frames

        setup = request.setup
        with output.watched(log, f"drawing {log.name}") as seen:
            for shown in drawn_frames(seen, setup, self.jobs, numbers):
                where = f"{log.name}  frame {shown.number}"
                if self.masks:
                    yield shown.number, masks_picture(shown, f"{where}  {shown.seconds:.2f} s  masks")
                else:
                    yield shown.number, phases_picture(shown, f"{where}  method {setup.method}", setup.method)


def _is_one_picture(path: Path, count: int) -> bool:
    """Whether the path names a picture, not a folder; raises UsageError where it cannot hold what is asked for."""
    ending = path.suffix.lower()
    if ending not in PICTURE_ENDINGS or path.is_dir():
        return False
    if ending != ".png":
        raise UsageError(f"{path}: pictures are PNG files: give a name in .png, or a folder")
    if count > 1:
        raise UsageError(f"{path}: is one picture, and {count} are asked for: give --frame, --at, or a folder")
    return True


def _worst(recording: Recording, request: Request, count: int, jobs: int | None) -> set[int]:
    """The numbers of the worst frames of any instrument; says of each how bad it is."""
    from svmdist.workflows.estimate import Measured, estimate
    from svmdist.workflows.scoring.series import series_of, worst_frames

    with output.watched(recording, f"measuring {recording.name}") as log:
        rows = list(estimate(log, request.setup, jobs))
    worst = worst_frames(series_of([Measured(recording, recording, tuple(rows), recording.lag)], request), count)
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
