"""The solver on a curve of one dimension, where long steps and steps that descend end in different minima."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from svmdist.estimation.instrument.consistency import NU
from svmdist.estimation.instrument.most_probable import (
    SETTLED,
    most_probable,
    most_probable_from,
    robust_cost,
)


@dataclass
class Wave:
    """A level seen of x + height sin(3 x), with a standard deviation."""

    level: float
    height: float
    std: float
    name: str = ""
    rests_on: tuple[str, ...] = ()

    @property
    def covariance(self):
        return np.array([[self.std**2]])


@dataclass
class OnALine:
    """A state of one number, without biases."""

    at: float = 0.0
    P = np.array([[4.0]])
    model = SimpleNamespace(size=1)
    bias_mean = np.zeros(0)

    def retracted(self, x):
        return OnALine(float(x[0]))

    def linearise(self, waves):
        residuals = [np.array([one.level - self.at - one.height * np.sin(3 * self.at)]) for one in waves]
        slopes = [np.array([1.0 + 3 * one.height * np.cos(3 * self.at)]) for one in waves]
        pairs = zip(residuals, slopes, strict=True)
        return [SimpleNamespace(is_finite=True, residual=residual, H=slope) for residual, slope in pairs]

    def full_jacobian(self, parts):
        return np.stack([part.H for part in parts])


WAVES = [Wave(0.3, 1.0, 0.05), Wave(0.0, 0.0, 1.0)]


def test_where_long_steps_refuse_something_steps_that_descend_are_tried():
    """From 2.5, long steps end where the sharp level is refused; the other minimum is the more probable one."""
    start = np.array([2.5])
    leaps = most_probable(OnALine(), WAVES, start)
    descends = most_probable(OnALine(), WAVES, start, descends=True)
    chosen = most_probable_from(OnALine(), WAVES, start)
    assert leaps.refuses
    assert not descends.refuses
    assert robust_cost(descends, WAVES) < robust_cost(leaps, WAVES) - 5.0
    np.testing.assert_array_equal(chosen.x, descends.x)


@pytest.mark.parametrize("start", np.linspace(-3.0, 3.0, 25))
def test_steps_that_descend_end_no_less_probable_than_they_began(start):
    """By the prior and Student's densities, as they are written; from -0.75, long steps do not."""

    def cost(x):
        seen = zip(OnALine(x).linearise(WAVES), WAVES, strict=True)
        squares = [float((part.residual[0] / one.std) ** 2) for part, one in seen]
        return x**2 / 4.0 + sum((NU + 1.0) * np.log1p(square / NU) for square in squares)

    found = most_probable(OnALine(), WAVES, np.array([start]), descends=True)
    assert cost(float(found.x[0])) <= cost(start) + SETTLED


def test_what_rests_on_wild_measurements_is_as_wild():
    """A shaft's end agrees with the prior wherever it is; of a thing whose sides do not, it is no shaft's end."""
    side, beside = Wave(40.0, 0.0, 0.1, "edge"), Wave(0.0, 0.0, 0.1, "right edge")
    end = Wave(1.0, 0.0, 0.1, "end", rests_on=("edge", "edge that is not there"))
    alone = most_probable(OnALine(), [end], np.zeros(1))
    both = most_probable(OnALine(), [side, end, beside], np.zeros(1))
    assert alone.weights[0] > 0.9
    assert both.weights[1] == both.weights[0] < 0.01
    assert both.weights[2] > 0.9
