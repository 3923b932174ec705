"""Jaws that open further than their encoder tells: cables stretch, and what they hold keeps them open."""

from __future__ import annotations

import numpy as np

from svmdist.simulation.room.settings import Room
from svmdist.transforms import Array

OPENING_HZ = 0.3
_STREAM = 104


def untold_opening_rad(room: Room, seed: int, t_s: Array, arm: int = 0) -> Array:
    """What the jaws of an arm open further, from 0 to the largest, shape (n,), at times since the start, (n,)."""
    phase = np.random.default_rng([seed, _STREAM, arm]).uniform(0.0, 2.0 * np.pi)
    wave = 0.5 - 0.5 * np.cos(2.0 * np.pi * OPENING_HZ * t_s + phase)
    return np.asarray(np.deg2rad(room.jaw) * wave * wave)
