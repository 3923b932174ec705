"""Pictures: what is drawn where."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from svmdist.drawing import COLOURS, Part
from svmdist.errors import OutputError
from svmdist.recording.log import open_recording
from svmdist.report.panels import bgr, masks_picture, write_picture
from svmdist.workflows.frame_drawing import Segmented, drawn_frames, image_stamps_ns
from svmdist.workflows.request import prepare
from tests.synthetic import write_log


def test_masks_are_drawn_on_the_chosen_frames(tmp_path: Path) -> None:
    """Each with its number and seconds, enlarged below a legend; the frame itself stays as it was."""
    setup = prepare(method=Segmented())
    recording = open_recording(write_log(tmp_path / "a.mcap", frame_count=6), setup.profile)
    assert len(image_stamps_ns(recording)) == 6
    shown = list(drawn_frames(recording, setup, numbers=(1, 4)))
    assert [one.number for one in shown] == [1, 4]
    assert 0.0 < shown[0].seconds < shown[1].seconds
    image = shown[0].replayed.image_bgr
    assert image is not None
    before = image.copy()
    picture = masks_picture(shown[0], "a")
    assert np.array_equal(image, before)
    assert picture.shape[1] >= 900
    contour = (picture == np.array(bgr(COLOURS[Part.TISSUE]))).all(2)
    assert contour.sum() > 500
    write_picture(tmp_path / "a.png", picture)
    assert np.array_equal(cv2.imread(str(tmp_path / "a.png")), picture)
    with pytest.raises(OutputError):
        write_picture(tmp_path / "none" / "a.png", picture)
