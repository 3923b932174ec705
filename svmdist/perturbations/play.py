"""Backlash as a play operator: hysteresis by the direction of motion, whatever its speed.

The play operator P of half-width r (Krasnosel'skii & Pokrovskii, Systems with Hysteresis, 1989) follows its input only
when the input pushes against one of the dead band's two sides. Input minus P is how far the band is pushed: within
±r, +r after an upward travel of 2 r, and unchanged where the input rests.
"""

from __future__ import annotations

import numpy as np

from svmdist.transforms import Array


class Play:
    """The play operator of several inputs; it starts in the middle of its dead band.

    `half_width`, shape (n,), is in the inputs' units. A half-width of 0 follows the input.
    """

    def __init__(self, half_width: Array) -> None:
        self._half_width = half_width
        self._trailing: Array | None = None

    def lead(self, inputs: Array) -> Array:
        """How far the inputs, shape (n,), now are ahead of what they drive: within ±half_width."""
        trailing = inputs if self._trailing is None else self._trailing
        self._trailing = np.clip(trailing, inputs - self._half_width, inputs + self._half_width)
        return np.asarray(inputs - self._trailing)
