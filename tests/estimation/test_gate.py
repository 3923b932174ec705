"""The gate for residuals."""

from __future__ import annotations

import pytest

from svmdist.estimation.instrument.consistency import chi_square_bound


def test_chi_square_bound() -> None:
    """The gate agrees with the tables at 1 in 1,000 to 2.5 %, on the generous side."""
    for degrees, value in ((2, 13.816), (6, 22.458), (8, 26.124)):
        assert chi_square_bound(degrees) == pytest.approx(value, rel=2.5e-2)
