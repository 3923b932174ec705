"""A video of a log with what was found and measured drawn on its images."""

from __future__ import annotations

from collections.abc import Iterable
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from svmdist.errors import OutputError, optional_package
from svmdist.files import atomic_file
from svmdist.report.panels import draw_on
from svmdist.samples import Image
from svmdist.workflows.annotate import DrawnFrame

TIME_BASE = Fraction(1, 1000)
"""Frames are shown at their stamps, to a millisecond: a log has no constant rate."""
CODECS = ("libx264", "mpeg4")
"""The first that this build of FFmpeg has. H.264 plays everywhere; MPEG-4 is part of every build."""
QUALITY = {"crf": "20", "preset": "veryfast"}
LARGEST_STEP_MS = 10_000
"""A pause of a log is shown no longer than this."""


def require_av() -> Any:
    """PyAV; raises OutputError where it is not installed."""
    return optional_package("av", "video", "a video", OutputError)


def write_video(frames: Iterable[DrawnFrame], path: Path, size_px: tuple[int, int]) -> int:
    """Write an MP4 of images of a size (width, height) in px; gives how many there were.

    An image that could not be read is black, with the reason. Raises OutputError where PyAV is missing, or the file
    cannot be written.
    """
    av = require_av()
    width, height = (length + length % 2 for length in size_px)  # the codecs halve the colours' resolution
    count, begin_ns, shown_ms = 0, 0, -1
    with atomic_file(path) as target:
        try:
            with av.open(str(target), "w", format="mp4") as container:
                codec = next(name for name in CODECS if name in av.codecs_available)
                stream = container.add_stream(codec, rate=30, options=QUALITY if codec == "libx264" else {})
                stream.width, stream.height, stream.pix_fmt = width, height, "yuv420p"
                stream.codec_context.time_base = TIME_BASE
                for frame in frames:
                    stamp_ns = frame.drawing.stamp_ns
                    begin_ns = stamp_ns if count == 0 else begin_ns
                    at_ms = round((stamp_ns - begin_ns) / 1e6)
                    # Clocks that are set back, or forth, make no gaps: a video's time only goes on.
                    at_ms = min(max(at_ms, shown_ms + 1), shown_ms + LARGEST_STEP_MS)
                    begin_ns = stamp_ns - at_ms * 1_000_000
                    shown_ms = at_ms
                    picture = av.VideoFrame.from_ndarray(_picture(frame, width, height), format="bgr24")
                    picture.pts, picture.time_base = at_ms, TIME_BASE
                    container.mux(stream.encode(picture))
                    count += 1
                container.mux(stream.encode())
        except av.FFmpegError as problem:
            raise OutputError(f"{path}: cannot write: {problem.strerror}") from None
    return count


def _picture(frame: DrawnFrame, width: int, height: int) -> Image:
    image = frame.replayed.image_bgr
    if image is None:
        image = np.zeros((height, width, 3), np.uint8)
    drawn = draw_on(image, frame.drawing)
    if drawn.shape[:2] == (height, width):
        return drawn
    padded = np.zeros((height, width, 3), np.uint8)
    rows, columns = min(height, drawn.shape[0]), min(width, drawn.shape[1])
    padded[:rows, :columns] = drawn[:rows, :columns]
    return padded
