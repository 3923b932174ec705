"""What the network that ships says of each pixel, for `auto`: texture, glare, wrists and jaws are no colours."""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np

from svmdist.models import INSTRUMENTS, PREFIX
from svmdist.profile import OnnxSegmentation
from svmdist.samples import Image
from svmdist.vision.instruments.working import Floats
from svmdist.vision.segmentation.network import OnnxSegmenter

MOST_RATIO = 4.0
"""One pixel's texture says no more than its colour may, as a logarithm of odds."""


def network_hint(bgr: Image) -> Floats:
    """Log odds of instrument against all else, shape (h, w), of an image, shape (h, w, 3)."""
    scores = _network().scores(bgr)
    instrument = np.zeros(len(scores), np.bool_)
    for part in ("instrument", "shaft"):
        instrument[list(INSTRUMENTS[part]["class_ids"])] = True
    odds = np.logaddexp.reduce(scores[instrument]) - np.logaddexp.reduce(scores[~instrument])
    odds = np.clip(odds, -MOST_RATIO, MOST_RATIO).astype(np.float32)
    return np.asarray(cv2.resize(odds, bgr.shape[1::-1], interpolation=cv2.INTER_LINEAR), np.float32)


@lru_cache(maxsize=1)
def _network() -> OnnxSegmenter:
    """Read when it is first asked for, once in a process."""
    return OnnxSegmenter(OnnxSegmentation.model_validate({"method": "onnx", "model": f"{PREFIX}instruments"}))
