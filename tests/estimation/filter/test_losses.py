"""Robust losses: squares near zero, and weights that are their slopes."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.estimation.instrument.window import Loss, geman_mcclure, huber


@pytest.mark.parametrize("loss", [huber, geman_mcclure])
def test_the_weight_is_the_slope_of_the_cost(loss: Loss) -> None:
    """By the squared deviation, against central differences to 1e-8; and cost and weight near zero are 0 and 1."""
    deviation = np.array([1e-3, 0.3, 0.9, 1.2, 7.0, 60.0])
    slope = (loss(deviation + 1e-6)[0] - loss(deviation - 1e-6)[0]) / 2e-6
    np.testing.assert_allclose(loss(deviation)[1], slope, atol=1e-8)
    cost, weight = loss(np.array([0.0]))
    assert (cost[0], weight[0]) == (0.0, 1.0)


def test_far_out_huber_pulls_and_geman_mcclure_does_not() -> None:
    """At 1e8 bounds: Huber's cost goes on as the root, the other one's ends at four."""
    far = np.array([1e8])
    assert huber(far)[0][0] == pytest.approx(2e4 - 1.0)
    assert geman_mcclure(far)[0][0] == pytest.approx(4.0, rel=1e-6)
