"""Statistics that wrong values cannot spoil."""

import math

import numpy as np
import pytest

from svmdist.least_squares import huber_weights, median, scale_of


def test_weights_and_scale():
    np.testing.assert_allclose(huber_weights(np.array([0.0, 1.0, -6.0]), 3.0), [1.0, 1.0, 0.5])
    sample = np.random.default_rng(0).normal(0.0, 2.0, 20_000)
    sample[:4000] = 1e6
    assert scale_of(sample) == pytest.approx(2.0, rel=0.35)
    assert scale_of(sample[4000:]) == pytest.approx(2.0, rel=0.03)


@pytest.mark.parametrize("count", [1, 2, 9, 400])
def test_the_median_is_that_of_numpy(count):
    values = np.random.default_rng(count).normal(size=count)
    assert median(values) == np.median(values)


@pytest.mark.parametrize("values", [[], [math.nan], [1.0, math.nan, 2.0]], ids=["none", "nan", "one nan"])
def test_what_has_no_median_gives_nan(values):
    assert math.isnan(median(np.array(values)))
