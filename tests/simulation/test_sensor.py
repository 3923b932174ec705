"""Sensor noise: one random stream, image after image, that another process can go on with."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.simulation.scene import Extras
from svmdist.simulation.simulate import Sensor

WIDTH, HEIGHT = 64, 48


@pytest.mark.parametrize("noise", [0.3, 2.0, 40.0])
def test_noise_is_added_rounded_and_saturated(noise: float) -> None:
    """Exactly what NumPy makes of the same stream, images at both ends of the range among them."""
    stream = np.random.default_rng([5, 11])
    sensor = Sensor(0, 5, noise, Extras())
    for frame, level in enumerate((0, 1, 127, 254, 255)):
        image = np.full((HEIGHT, WIDTH, 3), level, np.uint8)
        expected = np.clip(np.rint(image + stream.normal(0.0, noise, image.shape)), 0, 255).astype(np.uint8)
        exposed = sensor.expose(image, sensor.draw_noise(WIDTH, HEIGHT), frame)
        np.testing.assert_array_equal(exposed, expected)


def test_halves_are_rounded_to_even() -> None:
    levels = np.arange(-3.0, 515.0) / 2.0
    noise = np.repeat(levels[None, :, None], 3, axis=2)
    dark = np.zeros(noise.shape, np.uint8)
    exposed = Sensor(0, 1, 1.0, Extras()).expose(dark, noise, 0)
    np.testing.assert_array_equal(exposed[0, :, 0], np.clip(np.rint(levels), 0, 255))


def test_another_sensor_goes_on_where_one_stands() -> None:
    """The second image's noise does not depend on who drew the first one's."""
    one, other = (Sensor(1, 3, 2.0, Extras()) for _ in range(2))
    one.draw_noise(WIDTH, HEIGHT)
    state = one.noise_state
    expected = one.draw_noise(WIDTH, HEIGHT)
    other.noise_state = state
    np.testing.assert_array_equal(other.draw_noise(WIDTH, HEIGHT), expected)


def test_without_noise_the_image_is_as_drawn() -> None:
    image = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3), np.uint8)
    sensor = Sensor(0, 1, 0.0, Extras())
    noise = sensor.draw_noise(WIDTH, HEIGHT)
    assert noise is None
    np.testing.assert_array_equal(sensor.expose(image, noise, 0), image)
