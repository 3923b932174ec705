"""Instruments that are told by their shape: each one's silhouette, where several are in view."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from svmdist.profile import AutoSegmentation
from svmdist.recording.log import open_recording
from svmdist.samples import ImageSample
from svmdist.vision.segmentation import AutoSegmenter, InstrumentMasks
from svmdist.vision.silhouette import WristShape, find_silhouette
from svmdist.workflows.estimate import estimate
from svmdist.workflows.request import prepare
from tests.shipped import PROFILE

DUO = Path(__file__).parents[3] / "recordings" / "3d" / "duo.mcap"


@pytest.fixture(scope="module")
def image() -> np.ndarray:
    """A view of two instruments."""
    first = next(one for one in open_recording(DUO, PROFILE).images() if isinstance(one, ImageSample))
    return first.image_bgr


def test_another_instrument_takes_nothing_from_the_picture(image: np.ndarray) -> None:
    """What belongs to the others is no border: both sides of a shaft are sought in all of the picture."""
    masks = AutoSegmenter().masks(image)
    assert len(masks.seen) == 2
    first, second = masks.seen
    for own, other in ((first, second), (second, first)):
        mine = InstrumentMasks(masks, other.mask)
        assert mine.seen == (own,)
        np.testing.assert_array_equal(mine.picture, masks.picture)
        alone = find_silhouette(image, own, masks.picture, WristShape(0.37, 1.9))
        beside = find_silhouette(image, own, mine.picture, WristShape(0.37, 1.9))
        assert alone is not None
        assert beside is not None
        np.testing.assert_array_equal(alone.edges[0].points_px, beside.edges[0].points_px)


def test_both_instruments_of_a_log_are_measured() -> None:
    profile = PROFILE.model_copy(update={"segmentation": AutoSegmentation(method="auto")})
    setup = prepare(profile, "shaft")
    rows = estimate(open_recording(DUO, setup.profile), setup)
    measured = Counter(row.instrument for row in rows if row.measured)
    assert set(measured) == {"PSM1", "PSM2"}
