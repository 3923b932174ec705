from __future__ import annotations

import pytest

from svmdist.workflows.batch.task import LogFile
from tests.synthetic import write_log


@pytest.fixture(scope="session")
def small_logs(tmp_path_factory: pytest.TempPathFactory) -> list[LogFile]:
    """Six small logs of different lengths."""
    folder = tmp_path_factory.mktemp("logs")
    return [
        LogFile(write_log(folder / f"log{number}.mcap", frame_count=1 + number), f"log{number}")
        for number in range(6)
    ]
