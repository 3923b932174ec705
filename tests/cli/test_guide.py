"""docs/guide.md as it stands, on a picture of an instrument that the simulator never drew."""

import csv
import re
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.samples import CameraSample, ImageSample
from tests.conftest import REPOSITORY
from tests.pictures import PALE_BGR, RED_BGR, ShaftImage, entering_from
from tests.recording.builders import Entry
from tests.recording.other_recorders import ros_messages, write_ros2_mcap

START_NS = 1_700_000_000_000_000_000
GUIDE = (REPOSITORY / "docs" / "guide.md").read_text("utf-8")
CAMERA = replace(Camera.from_horizontal_fov(1280, 720, np.pi / 2.6), frame_id="endoscope")
DRAWN = ShaftImage(CAMERA, *entering_from(np.pi + 0.3, CAMERA, 0.085), border="circle", marker=False)
"""A dark shaft with a steel tip from the left, in an endoscope's round picture with black borders."""


@pytest.fixture
def my_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Where somebody's ROS 2 recording stands, with the guide's profile by colours."""
    (profile,) = re.findall(r"```toml\n(.*?)```", GUIDE, re.DOTALL)
    (tmp_path / "colours.toml").write_text(profile, "utf-8")
    organ = np.zeros((CAMERA.height_px, CAMERA.width_px, 1), np.uint8)
    cv2.ellipse(organ, ((640, 370), (420, 320), 15.0), 255, -1)
    pale, red = (replace(DRAWN, background_bgr=colour).draw(2) for colour in (PALE_BGR, RED_BGR))
    image_bgr = np.where(organ > 0, red, pale)
    entries = [
        Entry("/endoscope/image_raw", ImageSample(START_NS, "endoscope", image_bgr)),
        Entry("/endoscope/camera_info", CameraSample(START_NS, CAMERA)),
    ]
    write_ros2_mcap(tmp_path / "coloured.mcap", ros_messages(entries))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_the_guides_profile_by_colours_measures(cli, my_folder):
    """The profile as it stands: the tool is found within 0.5 mm, and the intervals hold."""
    profile = ("--profile", "colours.toml")
    options = ["--method", "shaft", "--alarm-below", "5mm", "-f", "csv", "-o", "mine.csv"]
    cli("estimate", "coloured.mcap", *profile, *options)
    info = cli("info", "coloured.mcap", *profile).out
    assert "methods     shaft\n" in info
    assert "  stereo    no: it lacks a topic for right_image" in info
    (row,) = csv.DictReader((my_folder / "mine.csv").read_text("utf-8").splitlines())
    assert row["status"] == "ok"
    # Nothing tells how the wrist is bent: jaws that may point anywhere may be within 5 mm.
    clearance_m, std_m = float(row["clearance_m"]), float(row["clearance_std_m"])
    assert row["alarm"] == str(int(clearance_m - 1.645 * std_m < 5e-3))
    tool_m = np.array([float(row[f"tool_{axis}_m"]) for axis in "xyz"])
    assert np.linalg.norm(tool_m - DRAWN.tool_m) < 5e-4
    # The organ's middle on the plane that the profile states; the drawing has the same plane behind it.
    tissue_m = 0.11 * np.array([0.5 / CAMERA.K[0, 0], 10.5 / CAMERA.K[1, 1], 1.0])
    spatial_m = np.linalg.norm(DRAWN.tool_m - tissue_m)
    assert abs(float(row["spatial_m"]) - spatial_m) < 1.96 * float(row["spatial_std_m"])
