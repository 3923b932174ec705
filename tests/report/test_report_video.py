"""Videos show every image at its time, with the drawing on it."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

from svmdist.drawing import Part
from svmdist.recording.log import open_recording
from svmdist.report.annotated import write_video
from svmdist.report.panels import draw_on
from svmdist.workflows.frame_drawing import drawn_frames
from svmdist.workflows.request import prepare
from tests.cli.conftest import Cli, cli

av = pytest.importorskip("av", reason="PyAV has no wheel for this platform")
__all__ = ["cli"]


def decoded(path: Path) -> list[tuple[float, np.ndarray]]:
    with av.open(str(path)) as container:
        return [
            (float(frame.pts * frame.time_base), frame.to_ndarray(format="bgr24"))
            for frame in container.decode(video=0)
        ]


def test_every_image_is_shown_at_its_stamp_with_its_drawing(golden: Path, tmp_path: Path) -> None:
    setup = prepare()
    recording = open_recording(golden / "occlusion.mcap", setup.profile)
    frames = list(drawn_frames(recording, setup, numbers=range(12)))
    write_video(frames, tmp_path / "out.mp4", (640, 480))
    shown = decoded(tmp_path / "out.mp4")
    begin_ns = frames[0].drawing.stamp_ns
    np.testing.assert_allclose(
        [seconds for seconds, _ in shown],
        [(frame.drawing.stamp_ns - begin_ns) / 1e9 for frame in frames],
        atol=2e-3,
    )
    for frame, (_, pixels) in zip(frames, shown, strict=True):
        assert frame.replayed.image_bgr is not None
        expected = draw_on(frame.replayed.image_bgr, frame.drawing).astype(float)
        bare = frame.replayed.image_bgr.astype(float)
        assert np.abs(pixels - expected).mean() < 6.0
        assert np.abs(pixels - expected).mean() < np.abs(pixels - bare).mean()
    assert any(shape.part is Part.DISTANCE for frame in frames for shape in frame.drawing.shapes)


def test_an_odd_size_and_a_clock_that_is_set_back_give_a_video(golden: Path, tmp_path: Path) -> None:
    setup = prepare()
    recording = open_recording(golden / "sweep.mcap", setup.profile)
    frames = list(drawn_frames(recording, setup, numbers=range(3)))
    write_video([*frames, *frames], tmp_path / "out.mp4", (639, 479))
    shown = decoded(tmp_path / "out.mp4")
    assert [pixels.shape for _, pixels in shown] == [(480, 640, 3)] * 6
    assert (np.diff([seconds for seconds, _ in shown]) > 0).all()


def test_estimate_writes_a_video_by_its_ending(golden: Path, cli: Cli, tmp_path: Path) -> None:
    outcome = cli("estimate", golden / "sweep.mcap", "--method", "centroid", "-o", tmp_path / "out.mp4")
    assert outcome.code == 0
    assert "80 of 80 frames measured" in outcome.err
    assert len(decoded(tmp_path / "out.mp4")) == 80


def test_without_pyav_the_message_says_what_to_install(
    golden: Path, cli: Cli, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(sys.modules, "av", None)
    outcome = cli("estimate", golden / "sweep.mcap", "-o", tmp_path / "out.mp4")
    assert outcome.code == 1
    assert "svmdist[video]" in outcome.err
    assert not (tmp_path / "out.mp4").exists()
