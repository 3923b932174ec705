"""Where the parts of an instrument may be, once two straight sides of it are known."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svmdist.vision.instruments.bars import Bar
from svmdist.vision.instruments.working import WorkingImage


@dataclass(frozen=True)
class Zones:
    """Where the parts of an instrument with a bar may be, masks of shape (h, w).

    `strip` goes from the border to the bar's inner end, `middle` is the bar itself without its sides, `distal` is what
    wrist and jaws can reach, `narrow` where they are when they are straight and closed. `beside` is the strip with what
    a shaft wider than its bar takes up.
    """

    strip: NDArray[np.bool_]
    middle: NDArray[np.bool_]
    distal: NDArray[np.bool_]
    narrow: NDArray[np.bool_]
    beside: NDArray[np.bool_]

    @classmethod
    def of(cls, bar: Bar, image: WorkingImage) -> Zones:
        """The zones of a bar whose first end is towards the border."""
        settings = image.settings
        height, width = image.core.shape
        x = np.arange(width, dtype=np.float32)[None, :]
        y = np.arange(height, dtype=np.float32)[:, None]
        depth = np.full((height, width), np.inf, np.float32)
        for side in (0, 1):
            normal, start = bar.inward(side).astype(np.float32), bar.sides[side, 0].astype(np.float32)
            depth = np.minimum(depth, (x - start[0]) * normal[0] + (y - start[1]) * normal[1])
        axis, inner = bar.axis.astype(np.float32), bar.middles[1].astype(np.float32)
        along = (x - inner[0]) * axis[0] + (y - inner[1]) * axis[1]
        across = np.abs((y - inner[1]) * axis[0] - (x - inner[0]) * axis[1])
        end_width = float(np.linalg.norm(bar.sides[0, 1] - bar.sides[1, 1]))
        length = float(np.linalg.norm(bar.middles[1] - bar.middles[0]))
        before = along < 0.0
        strip = before & (depth > -0.08 * bar.width_px - 1.0)
        middle = before & (depth > 0.5) & (along > -length)
        beyond = (along >= -0.3 * end_width) & (along < settings.distal_widths * end_width)
        reach = settings.distal_half_widths * end_width + 0.1 * np.maximum(along, 0.0)
        distal = beyond & (across < reach)
        narrow = distal & (across < 0.6 * end_width) & (along < 0.6 * settings.distal_widths * end_width)
        beside = before & (depth > -settings.beside_widths * bar.width_px)
        return cls(strip, middle, distal, narrow, beside)
