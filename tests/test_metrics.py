"""Identities of the error figures, what the bootstrap intervals promise, and alarms scored against truth."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scipy.stats import pearsonr

from svmdist import metrics

quick = settings(max_examples=80)
values_m = st.floats(-1.0, 1.0).map(lambda value: round(value, 6))
pairs = st.integers(2, 40).flatmap(
    lambda n: st.tuples(arrays(float, n, elements=values_m), arrays(float, n, elements=values_m))
)


@pytest.mark.parametrize("constant", [0.0, 0.1, 1e6, -0.3])
def test_a_truth_that_does_not_vary_has_no_r_squared(constant):
    """Rounding in the mean of equal values does not pass for variation: R² and r are None."""
    truth = np.full(7, constant)
    estimate = truth + np.linspace(-1e-3, 1e-3, 7)
    found = metrics.error_statistics(estimate, truth)
    assert (found.r_squared, found.pearson_r) == (None, None)
    assert metrics.error_statistics(truth, estimate).pearson_r is None


@quick
@given(pairs)
def test_the_squared_rmse_is_bias_squared_plus_variance(pair):
    """RMSE² = bias² + var(error) within 1e-12, and the other figures are ordered as they must be."""
    estimate, truth = pair
    found = metrics.error_statistics(estimate, truth)
    assert found.rmse**2 == pytest.approx(found.bias**2 + np.var(estimate - truth), abs=1e-12)
    assert abs(found.bias) <= found.mae + 1e-12
    assert found.mae <= found.rmse + 1e-12
    assert found.median_abs_error <= found.p95_abs_error <= found.max_abs_error
    assert found.rmse <= found.max_abs_error + 1e-12
    assert found.truth_std == pytest.approx(np.std(truth))
    if found.r_squared is not None and found.truth_std > 1e-3:
        assert found.r_squared == pytest.approx(1.0 - (found.rmse / found.truth_std) ** 2, rel=1e-9)


def test_figures_of_a_worked_example():
    """Errors of +1, -1, +3, -1 have bias 0.5, MAE 1.5, RMSE sqrt(3), median 1 and maximum 3."""
    truth = np.array([0.0, 1.0, 2.0, 3.0])
    found = metrics.error_statistics(truth + np.array([1.0, -1.0, 3.0, -1.0]), truth)
    figures = (found.count, found.bias, found.mae, found.median_abs_error, found.max_abs_error)
    assert figures == (4, 0.5, 1.5, 1, 3)
    assert found.rmse == pytest.approx(np.sqrt(3.0))
    assert found.p95_abs_error == pytest.approx(2.7)  # between 1 and 3, at 0.85 of the way


def test_pearsons_r_equals_scipys():
    """It agrees with scipy.stats.pearsonr within 1e-12 and never leaves [-1, 1]."""
    rng = np.random.default_rng(1)
    truth = rng.normal(size=50)
    estimate = 0.7 * truth + rng.normal(size=50)

    def r(estimate: np.ndarray, truth: np.ndarray) -> float | None:
        return metrics.error_statistics(estimate, truth).pearson_r

    assert r(estimate, truth) == pytest.approx(pearsonr(estimate, truth).statistic, abs=1e-12)
    assert r(-3.0 * truth + 2.0, truth) == pytest.approx(-1.0, abs=1e-15)


def test_no_pairs_have_no_figures_and_shapes_must_agree():
    """No pairs give None, one pair an RMSE without R², and arrays of two lengths raise."""
    assert metrics.error_statistics([], []) is None
    single = metrics.error_statistics([1.5], [1.0])
    assert (single.rmse, single.r_squared, single.pearson_r) == (0.5, None, None)
    with pytest.raises(ValueError, match="same shape"):
        metrics.error_statistics([1.0, 2.0], [1.0])


def noisy_ramp(seed: int, count: int = 120) -> tuple[np.ndarray, np.ndarray]:
    """A smooth distance of some 5 cm with noise of σ = 1 mm: estimate and truth, shape (count,), in m."""
    rng = np.random.default_rng(seed)
    truth = 0.05 + 0.02 * np.sin(np.linspace(0, 9, count))
    return truth + rng.normal(scale=1e-3, size=count), truth


def test_the_intervals_hold_the_true_figures_most_of_the_time():
    """Of 200 noise draws with σ = 1 mm, the 95 % interval of RMSE holds 1 mm in at least 85 %.

    A percentile bootstrap of some hundred pairs covers less than its level, about 90 % here; the bound
    leaves room for that and fails for a wrong formula.
    """
    held = 0
    for seed in range(200):
        estimate, truth = noisy_ramp(seed)
        rmse, r2 = metrics.bootstrap_intervals(estimate, truth, seed=seed + 1000, resamples=200)
        held += rmse.low <= 1e-3 <= rmse.high
        assert rmse.low <= float(np.sqrt(np.mean((estimate - truth) ** 2))) <= rmse.high
        assert r2.low < r2.high <= 1.0
    assert held >= 170


def test_blocks_widen_the_interval_of_errors_that_drift():
    """For errors that hang together, drawing blocks promises a wider interval than drawing single frames."""
    rng = np.random.default_rng(5)
    truth = np.linspace(0.0, 0.1, 400)
    drift = np.repeat(rng.normal(scale=1e-3, size=20), 20)
    single, _ = metrics.bootstrap_intervals(truth + drift, truth, seed=1, block=1)
    blocks, _ = metrics.bootstrap_intervals(truth + drift, truth, seed=1, block=20)
    assert blocks.high - blocks.low > 1.5 * (single.high - single.low)


def test_few_pairs_have_no_interval():
    """Seven pairs give no interval, eight give both; a constant truth gives none for R²."""
    estimate, truth = noisy_ramp(2)
    constant = np.full_like(truth, 0.05)
    cases = ((truth, 7, (False, False)), (truth, 8, (True, True)), (constant, None, (True, False)))
    for of, count, expected in cases:
        found = metrics.bootstrap_intervals(estimate[:count], of[:count], seed=1)
        assert tuple(interval is not None for interval in found) == expected


TRUTH_M = np.array([9, 8, 6, 4, 3, 4, 6, 8, 9, 9]) / 1e3


def test_counts_and_lead():
    """Alarmed one frame early and once for nothing: precision 3/5, recall 1, lead 0.1 s, one false alarm."""
    alarms = [0, 0, 1, 1, 1, 1, 0, 0, 1, 0]
    got = metrics.alarm_statistics(np.arange(10) / 10, alarms, TRUTH_M, 0.005)
    assert got.precision == pytest.approx(3 / 5)
    assert got.recall == 1.0
    assert got.false_alarm_fraction == pytest.approx(2 / 7)
    assert got.false_alarms_per_minute == pytest.approx(1 / (0.9 / 60))
    assert got.event_count == 1
    assert got.lead_times_s == (pytest.approx(0.1),)


def test_nothing_unsafe_or_nothing_at_all():
    """Without unsafe frames there is no recall; without frames there is nothing."""
    safe = metrics.alarm_statistics([0.0, 1.0], [False, False], [0.1, 0.1], 0.005)
    assert safe.recall is None
    assert safe.false_alarm_fraction == 0.0
    assert metrics.alarm_statistics([0.0, 1.0], [True, True], [0.005, 0.004], 0.005).unsafe_count == 1
    empty = metrics.alarm_statistics([], [], [], 0.005)
    assert empty.frame_count == 0
    assert empty.false_alarms_per_minute is None
    with pytest.raises(ValueError, match="same shape"):
        metrics.alarm_statistics([0.0], [True, False], [0.1], 0.005)


def test_an_alarm_that_never_ends_leads_each_event_only_from_the_last():
    """The lead of a second event is counted over the safe frames before it, not through the first event."""
    truth_m = np.array([9, 4, 4, 9, 9, 4, 9]) / 1e3
    got = metrics.alarm_statistics(np.arange(7.0), np.ones(7), truth_m, 0.005)
    assert got.event_count == 2
    assert got.lead_times_s == (1.0, 2.0)
    assert (got.median_lead_s, got.min_lead_s, got.missed_event_count) == (1.5, 1.0, 0)
    assert got.false_alarms_per_minute == 0.0


def test_pooling_adds_counts_and_durations():
    """Two recordings together: shares by frames, rates by time, no event across the seam."""
    a = metrics.alarm_statistics(np.arange(10) / 10, np.zeros(10), TRUTH_M, 0.005)
    b = metrics.alarm_statistics([50.0, 50.1], [True, True], [0.004, 0.004], 0.005)
    both = metrics.pooled_alarms([a, b])
    assert both.recall == pytest.approx(2 / 5)
    assert both.duration_s == pytest.approx(1.0)
    assert both.event_count == 1
    assert metrics.pooled_alarms([]).recall is None
