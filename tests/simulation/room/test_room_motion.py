"""What moves in a real room untold: tissue that breathes, and jaws that open further."""

from __future__ import annotations

import numpy as np

from svmdist.simulation.effects import OPENING_HZ, untold_opening_rad
from svmdist.simulation.effects import Room
from svmdist.simulation.effects import BREATHING_HZ, PULSE_HZ, tissue_rise_m

T_S = np.arange(0.0, 40.0, 0.01)


def test_breath_and_pulse_have_their_amplitudes_and_frequencies() -> None:
    """Two lines in the spectrum, of 2 mm at 0.25 Hz and of 0.4 mm at 1.2 Hz; without either nothing moves."""
    rise_m = tissue_rise_m(Room(breathing=2.0, pulse=0.4), 7, T_S)
    spectrum = np.abs(np.fft.rfft(rise_m)) / (0.5 * len(T_S))
    hz = np.fft.rfftfreq(len(T_S), 0.01)
    for frequency, amplitude_m in ((BREATHING_HZ, 2e-3), (PULSE_HZ, 4e-4)):
        line = int(np.argmin(np.abs(hz - frequency)))
        assert abs(spectrum[line] - amplitude_m) < 2e-6
        spectrum[line] = 0.0
    assert spectrum.max() < 1e-6
    assert not tissue_rise_m(Room(), 7, T_S).any()


def test_seeds_breathe_at_other_phases() -> None:
    room = Room(breathing=2.0)
    assert np.abs(tissue_rise_m(room, 1, T_S) - tissue_rise_m(room, 2, T_S)).max() > 1e-4
    np.testing.assert_array_equal(tissue_rise_m(room, 1, T_S), tissue_rise_m(room, 1, T_S))


def test_jaws_open_from_nothing_to_all_of_it() -> None:
    """Between 0 and the stated angle, once every 3.3 s; each arm in its own time."""
    room = Room(jaw=20.0)
    opening = untold_opening_rad(room, 3, T_S)
    assert opening.min() >= 0.0
    assert abs(opening.max() - np.deg2rad(20.0)) < 1e-4
    period = round(100 / OPENING_HZ)
    np.testing.assert_allclose(opening[: len(T_S) - period], opening[period:], atol=3e-3)
    assert np.abs(opening - untold_opening_rad(room, 3, T_S, arm=1)).max() > 0.05
    assert not untold_opening_rad(Room(), 3, T_S).any()
