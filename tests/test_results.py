"""Results: what is added or taken leaves the rest as it is, and nobody's result is changed behind their back."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from svmdist.results import (
    Distance,
    Distances,
    FrameResult,
    ImageFindings,
    ToolEstimate,
    ToolPose,
)
from svmdist.samples import Rejection, Status
from svmdist.transforms import make_transform

POSE = ToolPose(
    make_transform(np.eye(3), [1.0, 2.0, 3.0]), np.diag(np.arange(6.0)), np.array([0.0, 0.0, 1.0])
)
WHOLE = FrameResult(
    7,
    Status.OK,
    ImageFindings((1.0, 2.0), (3.0, 4.0), 5, 6, 7, 8, 9),
    ToolEstimate(POSE, None, has_plate=True),
    Distances(Distance(0.1), Distance(0.2, 0.01), Distance(0.3, 0.02, (0.0, 0.0, 1.0)), Distance(0.4)),
    "so far",
    "PSM1",
)


def test_a_rejection_keeps_all_but_status_and_detail() -> None:
    """And is undone by putting these back."""
    rejected = WHOLE.rejected(Status.NO_STEREO, "why")
    assert (rejected.status, rejected.detail, rejected.measured) == (Status.NO_STEREO, "why", False)
    assert replace(rejected, status=WHOLE.status, detail=WHOLE.detail) == WHOLE
    assert WHOLE.rejected(Status.NO_STEREO).detail == ""


def test_a_lost_image_s_result_is_its_rejection() -> None:
    """Stamp, status and detail, under the instrument's name; nothing is found in it."""
    result = FrameResult.of_rejection(Rejection(11, Status.CORRUPT_IMAGE, "no PNG"), "PSM2")
    assert result == FrameResult(11, Status.CORRUPT_IMAGE, detail="no PNG", instrument="PSM2")
    assert not result.measured
    assert result.image == ImageFindings()
    assert result.distances == Distances()
