"""One check of derivatives, against central differences."""

from collections.abc import Callable

import numpy as np

from svmdist.transforms import Array


def check_jacobian(
    value: Callable[[Array], Array], derivative: Array, *, relative: float = 0.0, absolute: float = 0.0
) -> None:
    """Hold a derivative, shape (k, n), against differences of `value`, of shape (k,), by steps of shape (n,).

    The tolerance is `relative` to the largest element, and `absolute`.
    """
    steps = 1e-6 * np.eye(derivative.shape[-1])
    expected = np.stack([(value(step) - value(-step)) / 2e-6 for step in steps], -1)
    tolerance = absolute + relative * np.abs(expected).max()
    np.testing.assert_allclose(derivative, expected, rtol=0.0, atol=tolerance)
