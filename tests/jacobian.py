"""One check of derivatives, against central differences, and the small motions that it is made of."""

from collections.abc import Callable

import cv2
import numpy as np

from svmdist.transforms import Array, make_transform


def nudged(T: Array, error: Array) -> Array:
    """A pose moved by (δp, δθ), shape (6,), both in the camera frame."""
    return make_transform(cv2.Rodrigues(error[3:])[0] @ T[:3, :3], T[:3, 3] + error[:3])


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
