"""`svmdist show`: the chosen images, each phase of the method as a panel."""

import re

import cv2
import numpy as np

from svmdist.drawing import COLOURS, Part
from svmdist.recording.log import open_recording
from svmdist.report.on_image import bgr
from svmdist.report.panels import phases_picture
from svmdist.workflows.frame_drawing import drawn_frames
from svmdist.workflows.request import prepare


def has_colour(picture: np.ndarray, part: Part) -> int:
    return int((picture == np.array(bgr(COLOURS[part]))).all(2).sum())


def test_the_phases_of_overlay_are_five_panels_of_the_images_size(golden, cli, tmp_path):
    log = golden / "sweep.mcap"
    shown = cli("show", log, "--method", "overlay", "--frame", 3, "-o", tmp_path).out
    assert shown == f"{tmp_path / 'sweep-00003.png'}\n"
    picture = cv2.imread(str(tmp_path / "sweep-00003.png"))
    assert picture.shape[1] == 2 * 644
    assert 3 * 480 < picture.shape[0] < 3 * 480 + 240
    left, right = (picture[:560, x : x + 640] for x in (0, 644))
    assert has_colour(right, Part.TISSUE) > 500  # its contour
    assert has_colour(left, Part.TISSUE) == 0  # the segmentation is a tint
    marker, matches = (picture[640:1080, x : x + 640] for x in (0, 644))
    assert (marker == 255).all(2).sum() > 1000  # the marker's rim
    assert has_colour(matches, Part.INLIER) > 1000


def test_every_method_has_panels_for_what_it_found(golden):
    for method, part in (("fiducial", Part.TAG), ("shaft", Part.SHAFT), ("fused", Part.DISTAL_MARKER)):
        setup = prepare(method=method)
        recording = open_recording(golden / "3d" / "duo.mcap", setup.profile)
        (frame,) = drawn_frames(recording, setup, numbers=[0], jobs=1)
        assert has_colour(phases_picture(frame, "duo", method), part) > 50


def test_at_takes_the_nearest_image_and_worst_the_worst(golden, cli, tmp_path):
    log = golden / "sweep.mcap"
    assert cli("show", log, "--at", 0.52, "-o", tmp_path).out.endswith("sweep-00005.png\n")
    worst = cli("show", log, "--method", "overlay", "--worst", 2, "-o", tmp_path)
    assert len(worst.out.splitlines()) == worst.err.count("planar error") == 2
    late = ("--method", "overlay", "--lag", 0.08)
    cli("estimate", log, *late, "-f", "csv", "--report", tmp_path / "page.html")
    error = re.search(r"planar error \S+ mm", cli("show", log, *late, "--worst", 1, "-o", tmp_path).err)[0]
    assert error in (tmp_path / "page.html").read_text("utf-8"), "another lag than that of a report"


def test_one_picture_may_have_a_name(golden, cli, tmp_path):
    """A name in .png is a file, and never a folder."""
    named = tmp_path / "made" / "seen.png"
    assert cli("show", golden / "sweep.mcap", "--frame", 3, "-o", named).out == f"{named}\n"
    assert cv2.imread(str(named)) is not None


def test_masks_are_a_picture_of_the_chosen_image(cli, synthetic_log, tmp_path):
    """The file's name has the image's number; the picture holds the image and a caption."""
    path = tmp_path / "synthetic-00003.png"
    shown = cli("show", synthetic_log, "--masks", "--frame", "3", "-o", tmp_path).out
    assert shown == f"{path}\n"
    picture = cv2.imread(str(path))
    assert picture.shape[1] >= 900
    assert len(np.unique(picture.reshape(-1, 3), axis=0)) > 10
