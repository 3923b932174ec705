"""Rows to arrays and pairs: what has no value is left out, and the rest is what the rows held."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.samples import Status
from svmdist.tracks import SampledDistances
from svmdist.workflows.scores import (
    DISTANCES,
    Pairs,
    Readings,
    pooled,
    pooled_score,
    score_pairs,
)
from tests.rows import result_of

ROWS = [
    result_of(10, Status.OK, (3.0, 4.0), planar_m=1.0, spatial_m=1.5, spatial_std_m=0.1),
    result_of(20, Status.NO_TISSUE, (5.0, 6.0), planar_m=9.0),
    result_of(30, Status.OK, planar_m=2.0),
    result_of(40, Status.OK, planar_m=3.0, clearance_m=0.5),
]
TRUTH = SampledDistances(
    np.array([1.1, 2.0, 2.1, 3.1]),
    np.array([1.4, 2.0, 2.0, 3.0]),
    np.array([np.nan, 0.3, 0.3, 0.4]),
    np.array([True, True, True, False]),
)


def test_only_measured_rows_with_a_truth_make_pairs() -> None:
    """A rejected row, one without the distance and one without a truth are left out; numbers are as they were."""
    readings = Readings(ROWS)
    planar, spatial, clearance = (readings.pairs(distance, TRUTH) for distance in DISTANCES)
    assert planar.stamps_ns.tolist() == [10, 30]
    assert planar.estimate_m.tolist() == [1.0, 2.0]
    assert planar.truth_m.tolist() == [1.1, 2.1]
    assert np.isnan(planar.std_m).all()
    assert (spatial.estimate_m.tolist(), spatial.std_m.tolist()) == ([1.5], [0.1])
    assert len(clearance) == 0
    assert dict(readings.rejected) == {"no_tissue": 1}
    np.testing.assert_array_equal(readings.tool_px, [[3.0, 4.0], *[[np.nan, np.nan]] * 3])
    assert (len(readings), readings.stamps_ns.tolist()) == (4, [10, 20, 30, 40])


def test_no_rows_make_no_pairs() -> None:
    """Without rows there are arrays of length 0, and no score."""
    none = SampledDistances(*np.empty((3, 0)), np.empty(0, np.bool_))
    pairs = Readings().pairs("spatial", none)
    assert len(pairs) == 0
    assert score_pairs(pairs) is None
    assert pooled_score([None, score_pairs(pairs)]) is None


def test_pooling_counts_every_pair_the_same() -> None:
    """The bias of parts together is the mean over all pairs, not the mean of means."""

    def off_by(error_m: float, count: int) -> Pairs:
        truth_m = np.linspace(0.0, 1.0, count)
        return Pairs(np.arange(count), truth_m + error_m, truth_m, np.full(count, 0.1))

    parts = [off_by(0.3, 1), off_by(0.0, 3)]
    together = pooled_score([score_pairs(part) for part in parts])
    assert together is not None
    assert together.statistics.bias == pytest.approx(0.3 / 4)
    assert together.interval_coverage == 0.75  # 0.3 lies outside ±1.96 x 0.1
    assert len(pooled(parts)) == 4
