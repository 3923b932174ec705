"""Files that Bullet and Mitsuba read what they draw from: written to the system's folder for temporary files."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from svmdist.errors import SimulationError
from svmdist.input_file import why


@contextmanager
def writing_temporary_files() -> Iterator[None]:
    """Say of temporary files that cannot be written where they go; raises SimulationError."""
    try:
        yield
    except OSError as problem:
        raise SimulationError(
            f"temporary files cannot be written: {why(problem)}; the variable TMPDIR names another folder for them"
        ) from None
