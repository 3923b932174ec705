"""What the sensors make of the drawn images: noise, and the degradations that were asked for, by seed."""

from __future__ import annotations

import numpy as np

from svmdist.samples import Image
from svmdist.simulation.extras import Extras
from svmdist.vision.degradations import Degradation, degrade, image_seed

_NOISE_STREAMS = (11, 14)
_DEGRADATION_STREAM = 15


class Sensor:
    """One camera of the pair, 0 the left one and 1 the right one; every image is the next frame."""

    def __init__(self, eye: int, seed: int, noise: float, extras: Extras) -> None:
        self._eye = eye
        self._seed = seed
        self._noise = noise
        self._degradations = tuple((Degradation(name), severity) for name, severity in extras.degradations)
        self._rng = np.random.default_rng([seed, _NOISE_STREAMS[eye]])
        self._frame = 0

    def expose(self, image_bgr: Image) -> Image:
        """Return what the camera reports of the image."""
        image = self._with_noise(image_bgr)
        for place, (name, severity) in enumerate(self._degradations):
            seed = image_seed(name, self._eye, self._seed, _DEGRADATION_STREAM, place, self._frame)
            image = degrade(image, name, severity, seed)
        self._frame += 1
        return image

    def _with_noise(self, image_bgr: Image) -> Image:
        if self._noise == 0.0:
            return image_bgr
        noisy = image_bgr + self._rng.normal(0.0, self._noise, image_bgr.shape)
        return np.clip(np.rint(noisy), 0, 255).astype(np.uint8)
