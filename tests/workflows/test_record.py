"""A recorded scenario is a complete file that says what it came from."""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.reader import make_reader

from svmdist.errors import UsageError
from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from svmdist.simulation.scenarios import Scenario
from svmdist.simulation.scene import Options

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.workflows.compare import Group, group_of
from svmdist.workflows.record import record

SCENARIO = Scenario("approach", 2, 0.4, 5.0)


def test_recording_is_complete_repeatable_and_never_replaced(tmp_path: Path) -> None:
    profile, progress = load_profile(), []
    path = tmp_path / "approach.mcap"
    result = record(SCENARIO, profile, path, on_progress=lambda done, total: progress.append((done, total)))
    assert progress == [(1, 2), (2, 2)]
    assert result.frame_count == 2
    assert result.size_bytes == path.stat().st_size
    assert not list(tmp_path.glob("*.part"))
    with open(path, "rb") as stream:
        reader = make_reader(stream)
        assert sum(1 for _ in reader.iter_messages()) == result.message_count
        metadata = next(item.metadata for item in reader.iter_metadata() if item.name == "svmdist")
    assert {"scenario": "approach", "seed": "2", "profile": "psm13"}.items() <= metadata.items()
    with pytest.raises(UsageError):
        record(SCENARIO, profile, path)
    again = record(SCENARIO, profile, tmp_path / "again.mcap")
    assert again.path.read_bytes() == path.read_bytes()
    record(SCENARIO, profile, path, force=True)


def test_a_degraded_recording_is_compared_as_such(tmp_path: Path) -> None:
    """What `record --degrade` stores in the log's metadata is the group that `compare` puts the log in."""
    profile = load_profile()
    one_frame = Scenario("approach", 2, 0.2, 5.0)
    options = Options(degradations=(("smoke", 3), ("jpeg", 1)))
    result = record(one_frame, profile, tmp_path / "smoky.mcap", options=options)
    assert group_of(open_recording(result.path, profile)) == Group("approach", "smoke=3,jpeg=1")
