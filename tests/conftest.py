"""Fixtures that several test folders share."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.synthetic import write_log

REPOSITORY = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="session")
def synthetic_log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A log of 40 frames drawn with OpenCV, with exact geometry."""
    return write_log(tmp_path_factory.mktemp("synthetic") / "synthetic.mcap", frame_count=40)


@pytest.fixture(scope="session")
def golden() -> Path:
    """The folder of golden logs."""
    return REPOSITORY / "recordings"
