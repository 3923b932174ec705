"""Episodes: each file as `record` writes it with its seed, whatever the number of processes; and going on."""

from __future__ import annotations

from pathlib import Path

import pytest

from svmdist.errors import UsageError
from svmdist.workflows.record import episode_paths
from tests.cli.conftest import Cli, cli  # noqa: F401  (a fixture)


def test_names_of_episodes(tmp_path: Path) -> None:
    paths = episode_paths(tmp_path / "out", "sweep", 7, 3)
    assert [path.name for path in paths] == ["sweep-7.mcap", "sweep-8.mcap", "sweep-9.mcap"]
    assert (tmp_path / "out").is_dir()
    paths = episode_paths(tmp_path / "{seed}" / "run-{episode}.mcap", "sweep", 7, 10)
    assert [str(path.relative_to(tmp_path)) for path in paths[::9]] == ["7/run-01.mcap", "16/run-10.mcap"]
    with pytest.raises(UsageError, match="is one name for 3 episodes"):
        episode_paths(tmp_path / "a.mcap", "sweep", 7, 3)


def test_episodes_are_what_record_writes(cli: Cli, tmp_path: Path) -> None:  # noqa: F811
    """In a real world that is drawn by each seed; those that are there are left, others are refused."""
    pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
    common = ["--duration", "0.2", "--rate", "5", "--world", "real", "--jpeg", "80"]
    folder = tmp_path / "episodes"
    done = cli("record", "--episodes", "2", "--seed", "5", *common, "-o", folder, "--jobs", "2")
    assert done.code == 0, done.err
    assert "2 of 2 recordings: 2 frames" in done.err
    assert cli("record", "--seed", "6", *common, "-o", tmp_path / "one.mcap").code == 0
    assert (folder / "sweep-6.mcap").read_bytes() == (tmp_path / "one.mcap").read_bytes()
    refused = cli("record", "--episodes", "3", "--seed", "5", *common, "-o", folder)
    assert (refused.code, "sweep-5.mcap exists; --skip-existing" in refused.err) == (2, True)
    before = (folder / "sweep-6.mcap").stat().st_mtime_ns
    (folder / "sweep-7.mcap.part").write_text("left by one that was killed")
    more = cli("record", "--episodes", "3", "--seed", "5", *common, "-o", folder, "--skip-existing")
    assert (more.code, "3 of 3 recordings, 2 of them were there" in more.err) == (0, True)
    assert (folder / "sweep-6.mcap").stat().st_mtime_ns == before
    assert sorted(path.name for path in folder.iterdir()) == [f"sweep-{seed}.mcap" for seed in (5, 6, 7)]
    other = cli(
        "record", "--episodes", "3", "--seed", "5", *common, "-o", folder, "--skip-existing", "--noise", "3"
    )
    assert other.code == 1
    assert "sweep-5.mcap: is another recording: noise differ" in other.err
    assert cli("record", "--skip-existing").code == 2
