"""Tissue that breathes and pulses: it moves with its bed along the plane's normal, and keeps its shape."""

from __future__ import annotations

import numpy as np

from svmdist.simulation.room.settings import Room
from svmdist.transforms import Array

BREATHING_HZ = 0.25
"""15 breaths a minute, as a ventilator is set."""
PULSE_HZ = 1.2
"""72 beats a minute."""
_STREAM = 101


def tissue_rise_m(room: Room, seed: int, t_s: Array) -> Array:
    """How far the tissue stands above its place at rest, shape (n,), at times since the start, shape (n,) in s."""
    phases = np.random.default_rng([seed, _STREAM]).uniform(0.0, 2.0 * np.pi, 2)
    breath_mm = room.breathing * np.sin(2.0 * np.pi * BREATHING_HZ * t_s + phases[0])
    pulse_mm = room.pulse * np.sin(2.0 * np.pi * PULSE_HZ * t_s + phases[1])
    return np.asarray(1e-3 * (breath_mm + pulse_mm), np.float64)
