"""What a segmenter learns from: images all over a log, the same for every number of workers."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from svmdist.profile import AutoSegmentation, load_profile
from svmdist.recording.log import open_recording
from svmdist.vision.find_instruments import AutoSegmenter
from svmdist.workflows.replay import adapted_segmenters, spread_observations
from svmdist.workflows.request import CLEAN, Condition, prepare
from tests.synthetic import write_log


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A synthetic log of 23 frames."""
    return write_log(tmp_path_factory.mktemp("adapting") / "a.mcap", frame_count=23)


def test_images_are_spread_over_the_log(log: Path) -> None:
    """Evenly from the first, at least as many as wanted and at most twice as many."""
    recording = open_recording(log, load_profile())
    for count in (1, 3, 8, 40):
        numbers = [number for number, _ in spread_observations(recording, count)]
        assert numbers[0] == 0
        assert len(set(np.diff(numbers))) <= 1
        assert min(count, 23) <= len(numbers) <= 2 * count


def test_each_condition_has_its_own(log: Path) -> None:
    """Colours are learnt under the condition they are used in; methods that do not learn are shared."""
    profile = load_profile().model_copy(update={"segmentation": AutoSegmentation(method="auto")})
    recording = open_recording(log, profile)
    conditions = [CLEAN, Condition("low_light", 3)]
    adapted = adapted_segmenters(AutoSegmenter(), recording, conditions)
    assert len(adapted) == 2
    assert adapted[0] is not adapted[1]
    colours = prepare().segmenter
    assert adapted_segmenters(colours, recording, conditions) == [colours, colours]
