"""Temporary files that cannot be written: one line that names the remedy."""

from __future__ import annotations

import pytest

from svmdist.errors import SimulationError
from svmdist.simulation.bullet import writing_temporary_files


def test_a_full_folder_is_told_with_the_variable_that_names_another() -> None:
    with pytest.raises(SimulationError, match="No space left on device; the variable TMPDIR"):  # noqa: SIM117
        with writing_temporary_files():
            raise OSError(28, "No space left on device")
    with writing_temporary_files():
        pass
