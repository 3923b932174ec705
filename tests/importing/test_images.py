"""Image files: natural order, patterns, and which of two views belong together; videos with their times."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

from svmdist.errors import SourceError
from svmdist.importing.images import Video, list_images, matching, numbers_of


def touched(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).touch()
    return folder


def test_order_is_that_of_numbers_and_patterns_choose(tmp_path: Path) -> None:
    touched(tmp_path, "f10_L.png", "f2_L.png", "f2_R.png", "notes.txt")
    assert [path.name for path in list_images(tmp_path, "*_L.png")] == ["f2_L.png", "f10_L.png"]
    with pytest.raises(SourceError, match=r"none of 3 images is a \*.bmp; the first is f2_L.png"):
        list_images(tmp_path, "*.bmp")


def test_a_folder_without_images_says_what_it_has(tmp_path: Path) -> None:
    with pytest.raises(SourceError, match="found nothing"):
        list_images(tmp_path)
    with pytest.raises(SourceError, match="found 1 other files"):
        list_images(touched(tmp_path, "notes.txt"))


def test_views_are_paired_by_their_last_number() -> None:
    left, right = [Path("a1.png"), Path("a2.png")], [Path("b2.png"), Path("b1.png")]
    assert matching(left, right) == [Path("b1.png"), Path("b2.png")]
    with pytest.raises(SourceError, match=r"a2.png: there is no right image of that number"):
        matching(left, right[1:])
    with pytest.raises(SourceError, match=r"b2.png: there is no left image of that number"):
        matching(left[:1], right)


def test_numbers_that_stand_twice_tell_no_place() -> None:
    assert numbers_of(["a7.png", "a9.png"]) == {7: 0, 9: 1}
    assert numbers_of(["a7.png", "b7.png"]) == {}


def test_images_come_with_their_times(tmp_path: Path) -> None:
    """Five grey images at 10 Hz, each brighter than the last."""
    av = pytest.importorskip("av")
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
    pytest.importorskip("av")
    path = tmp_path / "a.mp4"
    path.write_bytes(b"no video" * 100)
    with pytest.raises(SourceError, match="neither an image nor a video"):
        Video(path)
