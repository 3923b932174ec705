"""`svmdist profile new`: the file it writes serves the other commands."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.conftest import Cli
from tests.conftest import REPOSITORY

LOG = REPOSITORY / "recordings" / "3d" / "contact.mcap"


@pytest.mark.slow
def test_estimate_runs_with_it(cli: Cli, tmp_path: Path) -> None:
    """`info` finds every method served, and `fused` measures with the profile as it was written."""
    mine = tmp_path / "mine.toml"
    outcome = cli("profile", "new", LOG, "-o", mine)
    assert (outcome.code, outcome.out) == (0, "")
    assert "a distal marker by its colour; the plane from both views" in outcome.err
    assert "shaft, stereo, kinematic, fused" in cli("info", LOG, "--profile", mine).out
    rows = cli("estimate", LOG, "--profile", mine, "--method", "fused", "-f", "csv")
    assert rows.code == 0
    assert sum(",ok," in line for line in rows.out.splitlines()) > 40
    again = cli("profile", "new", LOG, "-o", mine)
    assert again.code == 2
    assert "exists already" in again.err
    assert cli("profile", "new", LOG, "--name", "theatre 1", "-o", mine, "--force").code == 0
    assert 'name = "theatre 1"' in mine.read_text("utf-8")


def test_wrong_logs(cli: Cli, tmp_path: Path) -> None:
    """A file that is no log, or none at all, is one line."""
    (tmp_path / "text.mcap").write_text("text")
    for path in (tmp_path / "text.mcap", tmp_path / "missing.mcap"):
        outcome = cli("profile", "new", path)
        assert (outcome.code, outcome.out) == (1, "")
        assert len(outcome.err.strip().splitlines()) == 1
        assert path.name in outcome.err


def test_wrong_topics(cli: Cli) -> None:
    """A topic that the log has not got, and a role that there is not."""
    outcome = cli("profile", "new", LOG, "--topic", "image=/left/image_raw")
    assert (outcome.code, outcome.out) == (1, "")
    assert outcome.err.startswith(
        "svmdist: contact.mcap: no topic /left/image_raw for image; the topics are /ECM/"
    )
    outcome = cli("profile", "new", LOG, "--topic", "imag=/ECM/left/image")
    assert (outcome.code, outcome.out) == (2, "")
    assert "did you mean image?" in outcome.err
