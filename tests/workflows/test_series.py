"""Series hold rows beside the truth, and know the worst frames."""

from dataclasses import replace

import numpy as np
import pytest

from svmdist.workflows.references import Reference
from svmdist.workflows.series import Series, worst_frames

SERIES = Series(
    "log",
    "PSM1",
    "fused",
    "clearance",
    np.arange(4),
    np.arange(4) * 100_000_000,
    np.arange(4) * 0.1,
    ("ok", "ok", "no_tissue", "ok"),
    ("", "", "hidden", ""),
    np.array([0.010, 0.020, np.nan, 0.030]),
    np.array([0.001, 0.002, np.nan, 0.0005]),
    np.array([0.011, 0.0195, 0.02, 0.027]),
    np.zeros((4, 2)),
    np.ones(4),
    Reference.GROUND_TRUTH,
)


def test_with_truth_the_worst_frame_has_the_largest_error():
    worst = worst_frames([SERIES], 4)
    assert [frame.number for frame in worst] == [3, 0, 1, 2]
    assert worst[0].in_words == "frame 3 at 0.30 s, PSM1: clearance error +3.00 mm, interval ±0.98 mm"
    assert worst[-1].in_words == "frame 2 at 0.20 s, PSM1: not measured: no_tissue (hidden)"


def test_without_truth_the_worst_frame_has_the_widest_interval():
    blind = replace(SERIES, truth_m=np.full(4, np.nan), reference=None)
    worst = worst_frames([blind], 2)
    assert [frame.number for frame in worst] == [1, 0]
    assert worst[0].in_words.endswith("clearance interval ±3.92 mm")


def test_of_two_instruments_an_image_counts_once_by_its_worse_one():
    other = replace(SERIES, instrument="PSM2", estimate_m=SERIES.truth_m + np.array([0.0, 0.01, 0.0, 0.0]))
    worst = worst_frames([SERIES, other], 3)
    assert [(frame.number, frame.series.instrument) for frame in worst] == [
        (1, "PSM2"),
        (3, "PSM1"),
        (0, "PSM1"),
    ]
    assert worst[0].badness_m == pytest.approx(0.01)
