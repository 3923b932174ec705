"""Pictures: what is drawn where, and what the caption says."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from svmdist.errors import OutputError
from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from svmdist.report.panels import PANELS, SHAFT, Canvas, masks_panel, picture_of, write_picture
from svmdist.workflows.request import Setup
from svmdist.workflows.show import image_stamps_ns, shown_frames
from tests.synthetic import write_log


def test_a_canvas_enlarges_small_images() -> None:
    """By a whole number, and what is drawn at a pixel is drawn in its middle."""
    canvas = Canvas.of(np.zeros((100, 200, 3), np.uint8))
    assert canvas.enlarged == 5
    assert canvas.pixels.shape == (500, 1000, 3)
    canvas.cross(np.array([100.0, 50.0]), (0, 255, 0))
    assert tuple(canvas.pixels[252, 502]) == (0, 255, 0)
    assert not canvas.pixels[:200].any()


def test_labels_stay_inside() -> None:
    """Also where what they name is at the edge."""
    canvas = Canvas.of(np.zeros((300, 1000, 3), np.uint8))
    canvas.label("name", np.array([5000.0, -40.0]), (1, 2, 255))
    assert (canvas.pixels[..., 2] == 255).any()


def test_a_caption_stands_below() -> None:
    """The image is whole; each line has its colour."""
    canvas = Canvas.of(np.full((300, 1000, 3), 77, np.uint8))
    picture = canvas.with_caption(["one", ("two", SHAFT)])
    assert np.array_equal(picture[:300], canvas.pixels)
    assert (picture[300:] == SHAFT).all(axis=2).any()


def test_the_chosen_frames_of_a_log(tmp_path: Path) -> None:
    """Each with its number, seconds and a frame for the instrument; the panel draws on a copy."""
    profile = load_profile()
    recording = open_recording(write_log(tmp_path / "a.mcap", frame_count=6), profile)
    assert len(image_stamps_ns(recording)) == 6
    setup = Setup(profile, "shaft", "corrected", None)
    shown = list(shown_frames(recording, setup, lambda number, seconds: number in (1, 4)))
    assert [one.number for one in shown] == [1, 4]
    assert shown[0].seconds > 0.0
    assert len(shown[0].frames) == 1
    before = shown[0].scene.observation.image_bgr.copy()
    lines = masks_panel(shown[0], Canvas.of(before))
    assert any("tissue" in line[0] for line in lines)
    picture = picture_of(shown[0], list(PANELS), "a")
    assert np.array_equal(shown[0].scene.observation.image_bgr, before)
    write_picture(tmp_path / "a.png", picture)
    assert np.array_equal(cv2.imread(str(tmp_path / "a.png")), picture)
    with pytest.raises(OutputError):
        write_picture(tmp_path / "none" / "a.png", picture)
