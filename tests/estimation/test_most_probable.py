"""The solver: what rests on what, and turns far from the prior."""

from dataclasses import dataclass
from types import SimpleNamespace

import numpy as np
import pytest

from svmdist.estimation.instrument.consistency import OUTLIER_WEIGHT
from svmdist.estimation.instrument.state import by_state, most_probable
from svmdist.transforms import rotation_of, rotation_vector, skew


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


def test_what_rests_on_wild_measurements_is_as_wild():
    """A shaft's end agrees with the prior wherever it is; of a thing whose sides do not, it is no shaft's end."""
    side, beside = Wave(40.0, 0.0, 0.1, "edge"), Wave(0.0, 0.0, 0.1, "right edge")
    end = Wave(1.0, 0.0, 0.1, "end", rests_on=("edge", "edge that is not there"))
    alone = most_probable(OnALine(), [end], np.zeros(1))
    both = most_probable(OnALine(), [side, end, beside], np.zeros(1))
    assert alone.weights[0] > 0.9
    assert both.weights[1] == both.weights[0] < 0.01
    assert both.weights[2] > 0.9


@dataclass
class Turned:
    """A place and a turn, of which an arrow's end is seen."""

    x: np.ndarray
    P = np.diag([1e-4] * 3 + [9.0] * 3)
    model = SimpleNamespace(size=6)
    bias_mean = np.zeros(0)

    def retracted(self, x):
        return Turned(x)

    def linearise(self, arrows):
        ends = [rotation_of(self.x[3:]) @ one.arrow for one in arrows]
        derivatives = [np.hstack([np.eye(3), -skew(end)]) for end in ends]
        seen = zip(arrows, ends, derivatives, strict=True)
        return [SimpleNamespace(residual=one.end - self.x[:3] - end, H=H) for one, end, H in seen]

    def full_jacobian(self, parts):
        return np.concatenate([part.H for part in parts])


@pytest.mark.parametrize("angle", [0.5, 1.5, 2.8])
def test_a_turn_far_from_the_prior_comes_to_rest_where_it_is_seen(angle):
    """As of a base that nothing is known of: long steps settle, from 20 degrees off, whatever it is turned by."""
    turn = angle * np.array([0.48, 0.6, 0.64])
    arrows = [
        SimpleNamespace(
            name=str(at),
            rests_on=(),
            arrow=arrow,
            end=rotation_of(turn) @ arrow,
            covariance=np.diag([1e-4, 1e-4, 1e-2]),
        )
        for at, arrow in enumerate(np.eye(3)[:2])
    ]
    start = np.append(np.zeros(3), turn + np.array([0.2, -0.25, 0.1]))
    found = most_probable(Turned(np.zeros(6)), arrows, start)
    assert found.has_converged
    assert (found.weights > OUTLIER_WEIGHT).all()
    np.testing.assert_allclose(found.x[3:], turn, atol=0.02)


@pytest.mark.parametrize("turn", [[0.0, 0.0, 0.0], [0.9, -1.2, 0.4], [0.0, 2.8, 0.0]])
def test_a_state_that_is_turned_far_moves_as_its_rotation_vector_does(turn):
    """By central differences: what is added to a rotation vector turns about another axis, and by less."""
    x, step = np.array([0.1, 0.2, 0.3, *turn, 0.5]), 1e-6
    for at in range(3):
        ends = [rotation_of(x[3:6] + sign * step * np.eye(3)[at]) for sign in (-1.0, 1.0)]
        moved = np.zeros(7)
        moved[3:6] = rotation_vector(ends[1] @ ends[0].T) / (2.0 * step)
        np.testing.assert_allclose(by_state(np.eye(7), x)[:, 3 + at], moved, atol=1e-6)
