"""The offset between the rows of a log's pairs: found once, removed from every row of results, for any --jobs."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.errors import RecordingError
from svmdist.estimation.frame import Scene
from svmdist.profile.segmentation import AutoSegmentation
from svmdist.recording.log import open_recording
from svmdist.recording.summary import inspect_recording
from svmdist.recording.writer import RecordingWriter
from svmdist.samples import CameraSample, ImageSample
from svmdist.vision.frame_context import make_segmenter
from svmdist.vision.stereo import RowAlignment
from svmdist.workflows import replay
from svmdist.workflows.capabilities import method_capabilities
from svmdist.workflows.check import compare_views, first_of, offset_to_remove, spread_observations
from svmdist.workflows.request import prepare
from tests.reading import read_images, read_observations
from tests.shipped import PROFILE
from tests.synthetic import right_of

CAMERA = Camera.from_horizontal_fov(420, 280, np.pi / 3)
BASELINE_M = 0.005


def log(path: Path, rows_px: float, apart_ns: int = 0, grown: float = 0.0) -> Path:
    """A log of eight pairs of a soft texture, the right view some rows lower, larger, and of another time."""
    disparity_px = CAMERA.K[0, 0] * BASELINE_M / 0.1
    rng = np.random.default_rng(5)
    with RecordingWriter(path, {"scenario": "test", "seed": "5"}) as writer:
        for frame in range(8):
            stamp_ns = 10**9 + frame * 10**8
            texture = cv2.GaussianBlur(rng.normal(0.0, 1.0, (280, 420, 3)), (0, 0), 3.0)
            texture = np.clip(120.0 + 20.0 * texture / texture.std(), 0, 255).astype(np.uint8)
            moved = np.array([[1.0, 0.0, -disparity_px], [0.0, 1.0, rows_px]])
            moved = (1.0 + grown) * moved
            moved[:, 2] -= grown * CAMERA.K[:2, 2]
            right = cv2.warpAffine(texture, moved, (420, 280), None, cv2.INTER_CUBIC, cv2.BORDER_REFLECT)
            writer.write("/ECM/left/camera_info", CameraSample(stamp_ns, CAMERA))
            writer.write("/ECM/right/camera_info", CameraSample(stamp_ns, right_of(CAMERA, BASELINE_M)))
            writer.write("/ECM/left/image", ImageSample(stamp_ns, "camera", texture))
            late_ns = stamp_ns + apart_ns
            right_image = ImageSample(late_ns, "camera_right", np.asarray(right, np.uint8))
            writer.write("/ECM/right/image", right_image)
    return path


@pytest.mark.parametrize("rows_px", [-3.4, -2.5, 0.0, 1.5, 5.0])
def test_the_offset_of_a_log_is_found(tmp_path, rows_px):
    """To a tenth of a pixel; none, or less than half a pixel, is left alone."""
    recording = open_recording(log(tmp_path / "pair.mcap", rows_px), PROFILE)
    spread = spread_observations(recording, 4)
    removed = offset_to_remove(first_of(spread, PROFILE), PROFILE)
    assert removed == RowAlignment(pytest.approx(rows_px, abs=0.1 if rows_px else 0.0))


def test_a_lens_that_is_not_stated_widens_what_is_measured(tmp_path):
    """It bends rows, which are aligned, and columns as much, which is part of the surface's deviations."""
    recording = open_recording(log(tmp_path / "pair.mcap", 0.0, grown=0.03), PROFILE)
    pairs = first_of(spread_observations(recording, 4), PROFILE)
    found = compare_views(pairs, PROFILE)
    assert not found.refusal
    assert found.warning.startswith("rows of both views")
    assert found.rows.slope == pytest.approx((0.0, 0.03), abs=2e-3)
    aligned = Scene(pairs[0], PROFILE, make_segmenter(AutoSegmentation(method="auto")), found.rows).surface()
    off_m = np.abs(aligned.points_m[:, 2] - 0.1)
    assert np.percentile(off_m, 90.0) > 1e-3  # three pixels of 18 at the border
    assert np.mean(off_m < 2.0 * aligned.grid_std_m[aligned.is_seen]) > 0.95


def test_exchanged_views_are_refused(tmp_path):
    """Nothing stands where they have it, whatever the rows do."""
    recording = open_recording(log(tmp_path / "pair.mcap", 0.0), PROFILE)
    swapped = [
        replace(one, image_bgr=one.right.image_bgr, right=replace(one.right, image_bgr=one.image_bgr))
        for one in first_of(spread_observations(recording, 4), PROFILE)
        if one.right is not None
    ]
    assert compare_views(swapped, PROFILE).refusal.startswith("disparities")


def test_exchanged_topics_are_refused(tmp_path):
    """By `--topic`, with the camera infos, whose baseline says which view is the right one; info says it, too."""
    left, right = {"image": "/ECM/left/image"}, {"image": "/ECM/right/image"}
    left["camera_info"], right["camera_info"] = "/ECM/left/camera_info", "/ECM/right/camera_info"
    exchanged = right | {f"right_{role}": topic for role, topic in left.items()}
    recording = open_recording(log(tmp_path / "pair.mcap", 0.0), PROFILE, topics=exchanged)
    with pytest.raises(RecordingError, match="/ECM/right/image is the right view and /ECM/left/image the left"):
        list(recording.encoded_observations())
    lacking = method_capabilities(inspect_recording(recording))["stereo"]
    assert any("exchanged" in reason for reason in lacking)


def test_every_scene_has_it_removed(tmp_path, monkeypatch):
    """Whatever the number of threads, the right view that detectors see is where the left one's rows are."""
    path = log(tmp_path / "pair.mcap", 2.0)
    kept: list[tuple[int, np.ndarray]] = []

    class Kept(Scene):
        def __init__(self, *args, **options) -> None:
            super().__init__(*args, **options)
            kept.append((self.observation.stamp_ns, self.observation.right.image_bgr))

    monkeypatch.setattr(replay, "Scene", Kept)
    left = next(iter(read_images(open_recording(path, PROFILE)))).image_bgr
    moved = np.array([[1.0, 0.0, -CAMERA.K[0, 0] * BASELINE_M / 0.1], [0.0, 1.0, 0.0]])
    level = cv2.warpAffine(left, moved, (420, 280), None, cv2.INTER_CUBIC)
    inner = np.s_[10:-10, 10:-40]
    for jobs in (1, 3):
        kept.clear()
        setup = prepare(PROFILE.name, method="stereo")
        assert len(list(replay.replay(open_recording(path, setup.profile), [setup], jobs=jobs))) == 8
        _, first = min(kept, key=lambda one: one[0])
        assert np.sqrt(np.mean((first[inner].astype(float) - level[inner]) ** 2)) < 2.0


def test_views_of_different_times_are_paired_as_the_profile_allows(tmp_path):
    """Four milliseconds are too many by default, and not where the profile says so; the delay is told."""
    path = log(tmp_path / "apart.mcap", 0.0, apart_ns=4_000_000)
    assert all(one.right is None for one in read_observations(open_recording(path, PROFILE)))
    limits = PROFILE.limits.model_copy(update={"pair_tolerance_s": 5e-3})
    allowing = PROFILE.model_copy(update={"limits": limits})
    for one in read_observations(open_recording(path, allowing)):
        assert one.right.delay_s == pytest.approx(4e-3)
