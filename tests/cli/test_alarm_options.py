"""`--alarm-below`: lengths with units, columns at the end, and what is refused."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from svmdist.cli.options import parse_length_m
from svmdist.errors import UsageError
from svmdist.profile import DEFAULT_PROFILE, profile_path
from tests.cli.conftest import Cli


@pytest.mark.parametrize("text", ["5mm", "5 mm", "0.5cm", "0.005m"])
def test_lengths(text: str) -> None:
    """Every unit gives metres."""
    assert parse_length_m("--alarm-below", text) == pytest.approx(0.005)


@pytest.mark.parametrize("text", ["5", "mm", "-5mm", "0mm", "nanmm", "5in", "1e9m", ""])
def test_bad_lengths(text: str) -> None:
    """A length without unit, without number, or out of this world is told with an example."""
    with pytest.raises(UsageError, match="as in 5mm"):
        parse_length_m("--alarm-below", text)


@pytest.mark.parametrize("command", ["estimate", "validate"])
def test_an_instrument_without_sizes_cannot_alarm(
    cli: Cli, tmp_path: Path, synthetic_log: Path, command: str
) -> None:
    """Without the instrument's sizes no row has a clearance: that is told before the work, not by silence."""
    text = profile_path(DEFAULT_PROFILE).read_text("utf-8")
    profile = tmp_path / "mine.toml"
    profile.write_text(re.sub(r"\[instrument\]\n(.+\n)+", "", text))
    outcome = cli(command, synthetic_log, "--profile", profile, "--method", "fused", "--alarm-below", "5mm")
    assert (outcome.code, outcome.out) == (1, "")
    (line,) = outcome.err.splitlines()
    assert "no [instrument]" in line
