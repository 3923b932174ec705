"""What the sensors make of the drawn images: noise, video, and the degradations that were asked for, by seed."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np

from svmdist.perturbations.video import subsampled
from svmdist.samples import Image
from svmdist.simulation.extras import Extras
from svmdist.transforms import Array
from svmdist.vision.degradations import Degradation, degrade, image_seed

_NOISE_STREAMS = (11, 14)
_DEGRADATION_STREAM = 15

NoiseState = dict[str, Any]
"""Where a random stream stands, as NumPy gives and takes it."""


class Sensor:
    """One camera of the pair, 0 the left one and 1 the right one.

    All noise of a recording comes from one random stream, image after image. `draw_noise` takes the next image's
    share of it; `noise_state` is where the stream then stands, with which another process can go on.
    """

    def __init__(self, camera: int, seed: int, noise: float, extras: Extras) -> None:
        self._camera = camera
        self._seed = seed
        self._noise = noise
        self._degradations = tuple((Degradation(name), severity) for name, severity in extras.degradations)
        self._chroma = extras.perturbations["chroma"]
        self._rng = np.random.default_rng([seed, _NOISE_STREAMS[camera]])

    @property
    def noise_state(self) -> NoiseState:
        """Where the random stream of the noise stands."""
        return dict(self._rng.bit_generator.state)

    @noise_state.setter
    def noise_state(self, state: NoiseState) -> None:
        self._rng.bit_generator.state = state

    def draw_noise(self, width_px: int, height_px: int) -> Array | None:
        """Draw the next image's noise in 8-bit levels, shape (height, width, 3); None for a sensor without noise."""
        if self._noise == 0.0:
            return None
        levels = self._rng.standard_normal((height_px, width_px, 3))
        levels *= self._noise
        return levels

    def expose(self, image_bgr: Image, noise: Array | None, frame: int) -> Image:
        """Return what the camera reports of the image number `frame`, with the noise that was drawn for it."""
        # OpenCV rounds to the nearest level, halves to even, and saturates: np.rint and np.clip in one pass.
        image = (
            image_bgr if noise is None else np.asarray(cv2.add(noise, image_bgr, dtype=cv2.CV_8U), np.uint8)
        )
        if self._chroma:
            image = subsampled(image, self._chroma)
        for place, (name, severity) in enumerate(self._degradations):
            seed = image_seed(name, self._camera, self._seed, _DEGRADATION_STREAM, place, frame)
            image = degrade(image, name, severity, seed)
        return image
