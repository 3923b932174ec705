"""Replay: results do not depend on threads, on company, or on the clock.

Equal means bit for bit: threads change who computes a detection, and nothing of how.
"""

from collections.abc import Sequence
from dataclasses import fields, is_dataclass, replace
from itertools import count, islice
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from svmdist.estimation.methods import METHODS
from svmdist.recording.log import open_recording
from svmdist.samples import ImageSample, Sample, Status
from svmdist.vision.degradations import Degradation
from svmdist.workflows.check import spread_observations
from svmdist.workflows.replay import Replayed, replay
from svmdist.workflows.request import CLEAN, Condition, Setup, prepare
from tests.synthetic import START_NS, write_log

FRAMES = 8
NOISE = Condition(Degradation.NOISE, 2)


def flattened(value: Any) -> Any:
    """A result as nested tuples of numbers and bytes: equal where every bit is."""
    if isinstance(value, np.ndarray):
        return value.shape, value.tobytes()
    if is_dataclass(value) and not isinstance(value, type):
        return tuple(flattened(getattr(value, one.name)) for one in fields(value) if one.name != "number")
    if isinstance(value, tuple):
        return tuple(map(flattened, value))
    return value


def outcomes(lanes: Sequence[tuple[Replayed, ...]]) -> list[Any]:
    """What was measured, without what it cost."""
    return [[flattened(replayed.results) for replayed in lane] for lane in lanes]


@pytest.fixture(scope="module")
def setups() -> list[Setup]:
    return [prepare(method=method) for method in METHODS]


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A short log drawn with OpenCV."""
    return write_log(tmp_path_factory.mktemp("replay") / "short.mcap", frame_count=FRAMES)


def replayed(log: Path, setups: Sequence[Setup], **kwargs: Any) -> list[tuple[Replayed, ...]]:
    return list(replay(open_recording(log, setups[0].profile), setups, **kwargs))


@pytest.fixture(scope="module")
def alone(log: Path, setups: list[Setup]) -> list[tuple[Replayed, ...]]:
    """Every method under both conditions, by one thread."""
    return replayed(log, setups, conditions=(CLEAN, NOISE), jobs=1)


def test_every_image_has_a_result_of_every_lane(alone):
    """Conditions first, then methods; and some frames of these drawings are measured."""
    assert len(alone) == FRAMES
    assert {len(lane) for lane in alone} == {2 * len(METHODS)}
    assert all(len(one.results) == len(one.seconds) == len(one.frames) == 1 for lane in alone for one in lane)
    for method in ("centroid", "overlay", "kinematic", "fused"):
        at = METHODS.index(method)
        assert all(lane[at].results[0].measured for lane in alone), method


@pytest.mark.parametrize("jobs", [2, 4])
def test_threads_change_nothing(log, setups, alone, jobs):
    assert outcomes(replayed(log, setups, conditions=(CLEAN, NOISE), jobs=jobs)) == outcomes(alone)


@pytest.mark.parametrize("method", METHODS)
def test_company_changes_nothing(log, setups, alone, method):
    """A method by itself, and under one condition alone, gives what it gives beside all others under both."""
    at = METHODS.index(method)
    for index, condition in enumerate((CLEAN, NOISE)):
        single = outcomes(replayed(log, [setups[at]], conditions=(condition,), jobs=1))
        assert single == [[lane[index * len(METHODS) + at]] for lane in outcomes(alone)]


@pytest.mark.parametrize("jobs", [1, 2])
def test_a_golden_log_s_methods_with_memory(golden, jobs):
    """The first frames of a rendered log: `fused` and `stereo` remember, and give the same beside each other."""
    both = [prepare(method=method) for method in ("fused", "stereo")]
    recording = golden / "3d" / "contact.mcap"
    together = list(islice(replay(open_recording(recording, both[0].profile), both, jobs=jobs), 5))
    for at, setup in enumerate(both):
        single = list(islice(replay(open_recording(recording, setup.profile), [setup], jobs=1), 5))
        assert outcomes(single) == [[lane[at]] for lane in outcomes(together)]
        assert all(lane[at].results[0].measured for lane in together)


def test_an_image_that_cannot_be_used_is_a_result_of_every_lane(tmp_path, setups):
    """By any number of threads; without memory every other frame is measured as if it were whole."""

    def cut(_topic: str, sample: Sample) -> Sample | None:
        if isinstance(sample, ImageSample) and sample.stamp_ns == START_NS + 100_000_000:
            return replace(sample, image_bgr=sample.image_bgr[:10, :10])
        return sample

    chosen = [setups[METHODS.index(method)] for method in ("centroid", "fused")]
    whole = outcomes(replayed(write_log(tmp_path / "whole.mcap", frame_count=4), chosen, jobs=1))
    path = write_log(tmp_path / "cut.mcap", frame_count=4, change=cut)
    lanes = replayed(path, chosen, jobs=1)
    assert len(lanes) == 4
    assert [one.results[0].status for one in lanes[1]] == [Status.CORRUPT_IMAGE] * 2
    assert [(one.frames, one.seconds) for one in lanes[1]] == [((), (0.0,))] * 2
    for index in (0, 2, 3):
        assert outcomes(lanes)[index][0] == whole[index][0]
    assert outcomes(replayed(path, chosen, jobs=2)) == outcomes(lanes)


def test_a_video_that_froze_is_measured_up_to_there(tmp_path, setups):
    """By methods that know the robot and those that do not, with any number of threads; and from its end on again."""
    held: list[ImageSample] = []

    def freeze(_topic: str, sample: Sample) -> Sample | None:
        if isinstance(sample, ImageSample) and 2 <= len(held) < 5:
            sample = replace(sample, image_bgr=held[1].image_bgr)
        held.extend([sample] if isinstance(sample, ImageSample) else [])
        return sample

    path = write_log(tmp_path / "frozen.mcap", frame_count=8, change=freeze)
    for method in ("centroid", "fused"):
        setup = [setups[METHODS.index(method)]]
        lanes = replayed(path, setup, jobs=1)
        frozen = [at for at, lane in enumerate(lanes) if lane[0].results[0].status is Status.INCONSISTENT]
        assert frozen == [2, 3, 4]
        assert all(lane[0].results[0].measured for lane in lanes[:2])
        assert all(lane[0].results[0].measured for lane in lanes[5:]) or method == "fused"
        assert all(lane[0].image_bgr is not None for lane in lanes)
        assert outcomes(replayed(path, setup, jobs=3)) == outcomes(lanes)
    alone = [setups[METHODS.index("kinematic")]]  # takes nothing of the tool from images
    assert all(lane[0].results[0].measured for lane in replayed(path, alone, jobs=1))
    together = outcomes(replayed(path, [*alone, *setup], jobs=2))
    assert [lane[0] for lane in together] == [lane[0] for lane in outcomes(replayed(path, alone, jobs=1))]
    assert [lane[1] for lane in together] == [lane[0] for lane in outcomes(lanes)]


def test_frames_without_images_are_no_frames(tmp_path, setups):
    """Dropping images drops their results, and changes no stateless other."""
    images = count()

    def every_second(_topic: str, sample: Sample) -> Sample | None:
        return None if isinstance(sample, ImageSample) and next(images) % 2 else sample

    half = write_log(tmp_path / "half.mcap", frame_count=6, change=every_second)
    whole = write_log(tmp_path / "whole.mcap", frame_count=6)
    centroid = [setups[METHODS.index("centroid")]]
    assert outcomes(replayed(half, centroid, jobs=2)) == outcomes(replayed(whole, centroid, jobs=2))[::2]


def test_what_is_looked_at_is_spread_over_the_log(tmp_path):
    """Evenly from the first image, at least as many as wanted and at most twice as many."""
    recording = open_recording(write_log(tmp_path / "a.mcap", frame_count=23), prepare().profile)
    for wanted in (1, 3, 8, 40):
        numbers = [one.number for one in spread_observations(recording, wanted)]
        assert numbers[0] == 0
        assert len(set(np.diff(numbers))) <= 1
        assert min(wanted, 23) <= len(numbers) <= 2 * wanted
