"""A first profile: it loads, finds what the log shows, and `estimate` runs with it."""

import re
import tomllib
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.errors import RecordingError, UsageError
from svmdist.estimation.checks import of_profile
from svmdist.estimation.frame import Arm
from svmdist.profile import Profile, load_profile
from svmdist.profile.robot import Instrument
from svmdist.recording.log import open_recording
from svmdist.recording.summary import inspect_recording
from svmdist.report.profile_template import instrument_sizes, instrument_table, profile_text
from svmdist.samples import CameraSample, Image, ImageSample, PoseSample, Sample
from svmdist.vision.colour import find_distinct_colour
from svmdist.workflows.new_profile import draft_profile, find_roles, shipped_robot
from tests.conftest import REPOSITORY
from tests.synthetic import write_samples

CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)


def _profile(path: Path, **topics: str) -> Profile:
    text = profile_text(draft_profile(path, "mine", topics))
    return Profile.model_validate(tomllib.loads(text))


@pytest.mark.slow
def test_of_a_simulated_log(tmp_path):
    """Topics, frames, the chain, the marker's colour and the plane of a log with everything."""
    profile = _profile(REPOSITORY / "recordings" / "3d" / "contact.mcap")
    shipped = load_profile("psm13")
    for role in ("image", "camera_info", "right_image", "right_camera_info", "joints", "pose", "tf"):
        assert getattr(profile.topics, role) == getattr(shipped.topics, role), role
    assert (profile.frames.camera, profile.frames.base, profile.frames.tool) == ("camera", "base", "tool")
    assert profile.robot == shipped_robot("psm13")
    # The surface of an organ of 8 mm on the simulator's floor, in place of the floor.
    height_m = shipped.tissue.plane_distance_m - profile.tissue.plane_distance_m
    assert 3e-3 < height_m < 8e-3
    assert 1e-3 <= profile.tissue.surface_std_m < 3e-3
    assert np.degrees(np.arccos(-profile.tissue.plane_normal[2])) < 5.0


def scope_log(path: Path, images: Iterable[Image]) -> Path:
    """A log of a scope's images, one a second, with its camera."""

    def pairs() -> Iterator[tuple[str, Sample]]:
        for number, image in enumerate(images):
            yield "/scope/image", ImageSample(number * 10**9, "camera", image)
            yield "/scope/camera_info", CameraSample(number * 10**9, CAMERA)

    return write_samples(path, pairs())


def guesses(instrument: Instrument) -> dict[str, tuple[float, float]]:
    """Guessed sizes with their deviations, in m."""
    radius_m = instrument.shaft_radius_m
    return {
        "shaft_radius_m": (radius_m, instrument.shaft_radius_std_fraction * radius_m),
        "shaft_end_m": (instrument.shaft_end_m, instrument.shaft_end_std_m),
        "outline_end_m": (instrument.outline_end_m, instrument.outline_end_std_m),
        "jaw_length_m": (instrument.jaw_length_m, instrument.body_std_m),
    }


def test_guesses_are_marked_and_as_uncertain_as_instruments_differ(tmp_path):
    """The simulated instrument and a real needle driver are within two deviations; the table has only valid sizes."""
    log = scope_log(tmp_path / "log.mcap", [np.full((480, 640, 3), 90, np.uint8)])
    draft = draft_profile(log, "mine", {})
    assert draft.instrument == "unknown"
    texts = {name: profile_text(replace(draft, instrument=name)) for name in instrument_table()}
    found = {name: Profile.model_validate(tomllib.loads(text)).instrument for name, text in texts.items()}
    others = (load_profile("psm13").instrument, found["large-needle-driver"])
    for key, (size_m, std_m) in guesses(found["da-vinci-8mm"]).items():
        assert all(abs(getattr(other, key) - size_m) <= 2.0 * std_m for other in others), key
        assert f"{key} = " in texts["unknown"]
    unmarked = re.findall(r"^(?:\w+_m|\w+_fraction|\w+_std_\w+) = [^#]*(?:#(?!.*MEASURE$).*)?$", texts["unknown"], re.M)
    assert unmarked == ["shaft_length_m = 0.28"]
    assert not [one for one in of_profile(Arm(load_profile("dvrk-psm"))) if one.deviations > 0.0]
    with pytest.raises(UsageError, match="no instrument named needle"):
        instrument_sizes("needle")


@pytest.mark.slow
def test_of_two_instruments():
    profile = _profile(REPOSITORY / "recordings" / "3d" / "duo.mcap")
    assert profile.instrument_names == ("PSM1", "PSM2")
    assert profile.other_instruments[0].frames.base == "PSM2_base"
    assert profile.other_instruments[0].topics.joints == "/PSM2/measured_js"
    assert profile.topics.ground_truth_tf == "/ground_truth/tf"
    truths = profile.topics.ground_truth_distance, profile.other_instruments[0].topics.ground_truth_distance
    assert truths == ("/ground_truth/distance", "/ground_truth/PSM2/distance")


def test_names_of_a_log_cannot_break_the_file(tmp_path):
    """Quotes, line ends and controls in topics stay inside their strings."""
    topic = '/evil"\n[limits]\x7f/image'
    pairs = (
        (topic, ImageSample(1, "camera", np.full((480, 640, 3), 90, np.uint8))),
        ("/info", CameraSample(1, CAMERA)),
        ("/PSM3/measured_cp", PoseSample(1, 'base"\n', np.eye(4))),
    )
    profile = _profile(write_samples(tmp_path / "evil.mcap", pairs))
    assert profile.topics.image == topic
    assert profile.frames.base == 'base"\n'
    assert profile.instrument_name == "PSM3"


def test_choices_are_the_users(tmp_path):
    """Several cameras are listed; a log without calibrations says what is missing."""
    image, info = ImageSample(1, "camera", np.zeros((48, 64, 3), np.uint8)), CameraSample(1, CAMERA)
    two = {f"/{name}/image": image for name in ("room", "scope")}
    write_samples(tmp_path / "bare.mcap", [("/scope/image", image)])
    infos = {f"/{name}/camera_info": info for name in ("room", "scope")}
    write_samples(tmp_path / "two.mcap", (two | infos).items())
    with pytest.raises(RecordingError, match="--topic image=TOPIC: /room/image, /scope/image"):
        draft_profile(tmp_path / "two.mcap", "mine", {})
    with pytest.raises(RecordingError, match="no topic with camera calibrations"):
        draft_profile(tmp_path / "bare.mcap", "mine", {})
    two = open_recording(tmp_path / "two.mcap", load_profile())
    chosen = find_roles(inspect_recording(two), {"image": "/scope/image"})
    assert chosen.topics["camera_info"] == "/scope/camera_info"
    assert chosen.other_images == ("/room/image",)


def _scene(places: list[tuple[int, int]], bgr: tuple[int, int, int]) -> np.ndarray:
    noise = np.random.default_rng(places[0][0]).normal(0.0, 12.0, (240, 320, 3))
    image = np.clip(np.array([95.0, 95.0, 190.0]) + noise, 0, 255).astype(np.uint8)
    for place in places:
        cv2.circle(image, place, 7, bgr, -1)
    return image


def test_distinct_colours():
    """A mark that moves and whose hue is its own is found; one that stands still or is of the tissue's hue is not."""
    moving = [_scene([(60 + 15 * n, 100)], (200, 180, 20)) for n in range(6)]
    found = find_distinct_colour(moving)
    hue = int(cv2.cvtColor(np.uint8([[(200, 180, 20)]]), cv2.COLOR_BGR2HSV)[0, 0, 0])
    assert found.hue[0] <= hue <= found.hue[1]
    assert find_distinct_colour([_scene([(60, 100)], (200, 180, 20))] * 6) is None
    assert find_distinct_colour([_scene([(60 + 15 * n, 100)], (20, 20, 200)) for n in range(6)]) is None
    two = [_scene([(60 + 15 * n, 100), (250 - 12 * n, 160)], (200, 180, 20)) for n in range(6)]
    assert find_distinct_colour(two, 1) is None
    assert find_distinct_colour(two, 2) is not None


def _two_shafts(number, lefts, rights):
    """An image of tissue with a shaft from each of two places on its rim."""
    noise = np.random.default_rng(number).normal(0, 6, (480, 640, 3))
    image = np.clip(np.add((90, 100, 190), noise), 0, 255).astype(np.uint8)
    starts = lefts[number % len(lefts)], rights[number % len(rights)]
    for start, end in zip(starts, ((240, 240 + 4 * number), (400, 250 - 4 * number)), strict=True):
        for half_px in range(30, 0, -2) if start else ():  # round things shine along their middle
            level = 130.0 - 75.0 * (half_px / 30) ** 2
            cv2.line(image, start, end, (level, level, level), 2 * half_px)
    return cv2.GaussianBlur(image, (0, 0), 1.5)


@pytest.mark.parametrize(
    ("lefts", "rights", "sides"),
    [
        ([(0, 120)], [(639, 90)], ("right", "left")),
        ([(0, 60), (60, 0)], [(639, 60), (580, 0)], ("right", "left")),  # across corners of the picture
        ([(0, 120)], [(480, 0)], ("above", "left")),
        ([(0, 120)], [(639, 90), None], ("right", "left")),  # out of view every other time
    ],
)
def test_instruments_by_the_side_they_come_in_from(tmp_path, lefts, rights, sides):
    """Where nothing but images tells of two instruments, they are named by their sides; estimate accepts it."""
    images = [_two_shafts(number, lefts, rights) for number in range(6)]
    profile = _profile(scope_log(tmp_path / "two.mcap", images))
    assert profile.instrument_names == ("PSM1", "PSM2")
    assert (profile.entry, profile.other_instruments[0].entry) == sides


def test_a_log_without_a_usable_image_is_told_by_all_that_look_at_it(cli, tmp_path):
    """A camera of another size than the images: no profile, no check, and `info` has the loss."""
    log = scope_log(tmp_path / "half.mcap", [np.full((240, 320, 3), 90, np.uint8)] * 2)
    why = "320x240 px; the camera has 640x480"
    for command in (("profile", "new"), ("check",)):
        assert f"no image of 2 can be used: {why}" in cli(*command, log, code=1).err
    found = cli("info", log, "-f", "json", code=3)
    assert why in found.err
    assert not found.json["is_clean"]
