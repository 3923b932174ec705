"""A video as images with times: all of them, in order; what is none is told in a line."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from svmdist.errors import SourceError
from svmdist.importing.images import Video

av = pytest.importorskip("av")


def test_images_come_with_their_times(tmp_path: Path) -> None:
    """Five grey images at 10 Hz, each brighter than the last."""
    path = tmp_path / "a.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("libx264", rate=10)
        stream.width, stream.height, stream.pix_fmt = 64, 48, "yuv420p"
        stream.time_base = Fraction(1, 10)
        for level in range(5):
            image = np.full((48, 64, 3), 40 + 40 * level, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="bgr24")))
        container.mux(stream.encode())
    video = Video(path)
    assert video.size_px == (64, 48)
    assert video.times_ns == [0, 100_000_000, 200_000_000, 300_000_000, 400_000_000]
    shown = dict(video.images())
    assert sorted(shown) == [0, 1, 2, 3, 4]
    assert [float(shown[at].mean()) for at in range(5)] == pytest.approx([40, 80, 120, 160, 200], abs=6)


def test_what_is_no_video_is_told(tmp_path: Path) -> None:
    path = tmp_path / "a.mp4"
    path.write_bytes(b"no video" * 100)
    with pytest.raises(SourceError, match="neither an image nor a video"):
        Video(path)
