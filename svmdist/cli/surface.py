"""`svmdist surface`: the tissue's surface by both views of one image."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from svmdist.cli import options
from svmdist.cli.options import AT, FRAME, argument
from svmdist.cli.output import LOG, ExitCode, progress_bar, write_results
from svmdist.errors import UsageError
from svmdist.report.writers import Holds

if TYPE_CHECKING:
    from svmdist.recording.log import Recording


class Surface(options.ReadOptions, options.OutputOptions):
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

    file: Path = argument(..., "FILE", "Recording with two views.")
    frame: int | None = FRAME
    at: float | None = AT
    form: str | None = options.format_option(Holds.CLOUD)

    def _run(self) -> ExitCode:
        from svmdist.cli.logs import log_losses
        from svmdist.report.rows import cloud_results
        from svmdist.workflows.request import Request, Setup
        from svmdist.workflows.surface import tissue_surface

        writer = self.writer([self.file], Holds.CLOUD)
        setup = Setup.reading(self.profile, self.hand_eye)
        with progress_bar(f"looking at {self.file.name}"):
            recording = Request(setup, self.topics).open(self.file, self.file.stem)
            found = tissue_surface(
                recording, setup.profile, image_number(recording, self.frame, self.at) or 0
            )
        write_results(cloud_results(found), writer, self.output)
        near_m, half_m, far_m = found.quantiles_m
        LOG.info(
            "frame %d: %d points, %.0f %% of the tissue in view, %.0f to %.0f mm away, deviation %.2f mm (median)",
            *(found.number, len(found.points_m), 100.0 * found.share),
            *(1e3 * length_m for length_m in (near_m, far_m, half_m)),
        )
        return log_losses(recording.path, recording.health)


def image_number(recording: Recording, frame: int | None, at_s: float | None) -> int | None:
    """The number of the image that `--frame` or `--at` choose, None where neither is given; raises UsageError."""
    from svmdist.workflows.frame_drawing import image_stamps_ns

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
