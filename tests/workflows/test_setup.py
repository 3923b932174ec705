"""What a measurement is made with: which methods need a calibration, and which take none."""

from __future__ import annotations

from pathlib import Path

import pytest

from svmdist.errors import CalibrationError, UsageError
from svmdist.estimation.methods import PLANAR_METHODS, SPATIAL_METHODS
from svmdist.profile import profile_path
from svmdist.workflows.request import prepare


def test_planar_methods_take_the_calibration_beside_the_profile() -> None:
    """The shipped calibration is the default of every planar method."""
    for method in PLANAR_METHODS:
        setup = prepare(method=method)
        assert setup.calibration is not None
        assert setup.mapping is not None


@pytest.mark.parametrize("method", SPATIAL_METHODS)
def test_methods_in_3d_need_no_calibration(method: str) -> None:
    """A 3D method works without one, and says so where one, or another reading, is asked of it."""
    setup = prepare(method=method)
    assert setup.calibration is None
    assert setup.mapping is None
    with pytest.raises(UsageError, match="measures in 3D"):
        prepare(method=method, equations="printed")
    with pytest.raises(UsageError, match="measures in 3D"):
        prepare(method=method, calibration=Path("mine.toml"))


def test_a_profile_without_a_calibration_says_what_to_do(tmp_path: Path) -> None:
    """A profile of one's own has no calibration beside it until it is made."""
    text = profile_path("psm13").read_text("utf-8")
    mine = tmp_path / "mine.toml"
    mine.write_text("\n".join(line for line in text.splitlines() if not line.startswith("calibration")))
    with pytest.raises(CalibrationError, match="svmdist calibrate"):
        prepare(mine)


def test_printed_takes_no_calibration() -> None:
    """The paper's own numbers and a calibration exclude each other."""
    with pytest.raises(UsageError, match="printed"):
        prepare(equations="printed", calibration=Path("mine.toml"))
