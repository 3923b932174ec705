"""Benchmarks of the stages of the planar methods, for one frame of a golden log.

Run them with `uv run pytest -n0 tests/benchmarks/test_planar_speed.py --benchmark-enable`, and divide by the PNG
decoding of the same run; nothing here fails for being slow, since machines are noisy.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from svmdist.estimation.planar.marker_detection import detect_marker, mark, template_features
from svmdist.profile import Profile, load_profile
from svmdist.recording.reader import open_recording
from svmdist.samples import Image, Observation, Status
from svmdist.vision.completion import complete_outline
from svmdist.vision.frame_context import to_hsv
from svmdist.vision.marker.features import Features, detect_orb, match_features
from svmdist.vision.marker.homography import fit_homography
from svmdist.vision.regions import Region, find_region
from svmdist.vision.segmentation.colour import colour_mask

FRAME = 30
"""A frame of the sweep log where the instrument crosses the organ."""

pytestmark = pytest.mark.benchmark(group="stages of a planar frame")


@dataclass(frozen=True)
class Frame:
    """One image with what the stages before give of it."""

    profile: Profile
    image_bgr: Image
    tissue_mask: Image
    instrument_mask: Image
    tissue: Region
    instrument: Region
    template: Features

    @property
    def window_grey(self) -> Image:
        """The window about the pasted marker."""
        window = mark(self.image_bgr, self.instrument.centroid_px, self.profile.marker).window_bgr
        return np.asarray(cv2.cvtColor(window, cv2.COLOR_BGR2GRAY), np.uint8)


@pytest.fixture(scope="module", autouse=True)
def _one_thread() -> Iterator[None]:
    """OpenCV's threads off: what is measured is work, and not the number of cores."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    yield
    cv2.setNumThreads(threads)


@pytest.fixture(scope="module")
def frame(golden: Path) -> Frame:
    """One frame of the sweep log."""
    profile = load_profile()
    for number, observation in enumerate(open_recording(golden / "sweep.mcap", profile).observations()):
        if number == FRAME and isinstance(observation, Observation):
            break
    hsv = to_hsv(observation.image_bgr)
    rules = profile.segmentation
    tissue_mask, instrument_mask = colour_mask(hsv, rules.tissue), colour_mask(hsv, rules.instrument)
    tissue, instrument = (
        find_region(tissue_mask, rules.tissue),
        find_region(instrument_mask, rules.instrument),
    )
    assert tissue is not None
    assert instrument is not None
    template = template_features(profile.marker, profile.features)
    return Frame(profile, observation.image_bgr, tissue_mask, instrument_mask, tissue, instrument, template)


def test_png_decoding(benchmark: BenchmarkFixture, frame: Frame) -> None:
    """The measure of all else."""
    _, data = cv2.imencode(".png", frame.image_bgr)
    assert benchmark(cv2.imdecode, data, cv2.IMREAD_COLOR).shape == frame.image_bgr.shape


def test_find_tissue_region(benchmark: BenchmarkFixture, frame: Frame) -> None:
    """Contours, counts and hull of the tissue, without its completion."""
    rule = frame.profile.segmentation.tissue.model_copy(update={"occlusion": "hull"})
    assert benchmark(find_region, frame.tissue_mask, rule).area_px == frame.tissue.area_px


def test_find_instrument_region(benchmark: BenchmarkFixture, frame: Frame) -> None:
    """Contour, count and centroid of the instrument."""
    rule = frame.profile.segmentation.instrument
    assert benchmark(find_region, frame.instrument_mask, rule).area_px == frame.instrument.area_px


def test_outline_completion(benchmark: BenchmarkFixture, frame: Frame) -> None:
    """The Fourier series through the visible outline."""
    assert benchmark(complete_outline, frame.tissue_mask, frame.tissue.hull).fitted


def test_paste(benchmark: BenchmarkFixture, frame: Frame) -> None:
    """The window about the marker."""
    marked = benchmark(mark, frame.image_bgr, frame.instrument.centroid_px, frame.profile.marker)
    assert marked.window_bgr.shape == (158, 158, 3)


def test_orb(benchmark: BenchmarkFixture, frame: Frame) -> None:
    """Features of the window."""
    assert len(benchmark(detect_orb, frame.window_grey, frame.profile.features.feature_count)) > 200


def test_matching(benchmark: BenchmarkFixture, frame: Frame) -> None:
    """Brute force and ratio test."""
    features = detect_orb(frame.window_grey, frame.profile.features.feature_count)
    assert len(benchmark(match_features, frame.template, features, 0.75)) > 100


def test_homography(benchmark: BenchmarkFixture, frame: Frame) -> None:
    """MAGSAC and its refits."""
    features = detect_orb(frame.window_grey, frame.profile.features.feature_count)
    matches = match_features(frame.template, features, 0.75)
    assert benchmark(fit_homography, matches, 3.0) is not None


def test_marker_detection(benchmark: BenchmarkFixture, frame: Frame) -> None:
    """ORB, matches, homography and third contour together."""
    marked = mark(frame.image_bgr, frame.instrument.centroid_px, frame.profile.marker)
    found = benchmark(detect_marker, marked, frame.template, frame.profile.marker, frame.profile.features)
    assert found.status is Status.OK
