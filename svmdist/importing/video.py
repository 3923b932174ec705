"""A video file as images with their times, by PyAV."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from svmdist.errors import SourceError
from svmdist.pyav import import_av
from svmdist.samples import Image


class Video:
    """The first video stream of a file; SourceError in one line where there is none that can be read."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self._av = import_av(SourceError, f"{path}: a video")
        with self._stream() as (container, stream):
            times = [packet.pts for packet in container.demux(stream) if packet.pts is not None]
            self.size_px: tuple[int, int] = (stream.width, stream.height)
            self._base: Fraction = stream.time_base
        if not times:
            raise SourceError(f"{path}: a video whose images have no times")
        self._times: list[int] = sorted(set(times))

    @property
    def times_ns(self) -> list[int]:
        """The time of every image after the first one."""
        return [self._time_ns(pts) for pts in self._times]

    def images(self) -> Iterator[tuple[int, Image]]:
        """Decode every image, BGR, shape (height, width, 3), with its place among `times_ns`."""
        places = {pts: place for place, pts in enumerate(self._times)}
        with self._stream() as (container, stream):
            stream.thread_type = "AUTO"
            for frame in container.decode(stream):
                if frame.pts in places:
                    yield places[frame.pts], np.asarray(frame.to_ndarray(format="bgr24"), np.uint8)

    def _time_ns(self, pts: int) -> int:
        return round((pts - self._times[0]) * self._base * 10**9)

    @contextmanager
    def _stream(self) -> Iterator[tuple[Any, Any]]:
        try:
            with self._av.open(
                f"file:{self.path}"
            ) as container:  # a file, whatever protocol its name looks like
                stream = next(iter(container.streams.video), None)
                if stream is None:
                    raise SourceError(f"{self.path}: has no video")
                yield container, stream
        except self._av.error.FFmpegError as problem:
            reason = " ".join(str(problem.strerror or problem).split())
            raise SourceError(
                f"{self.path}: neither an image nor a video that can be read: {reason}"
            ) from None
