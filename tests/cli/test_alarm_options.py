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
@pytest.mark.parametrize("method", ["overlay", "centroid"])
def test_a_planar_method_cannot_alarm(cli: Cli, command: str, method: str) -> None:
    """A method without clearance is refused in one line that names those with one: silence would look safe."""
    outcome = cli(command, "x.mcap", "--method", method, "--alarm-below", "5mm")
    assert outcome.code == 2
    (line,) = outcome.err.splitlines()
    assert method in line
    assert "fused" in line


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


def test_confidence_without_a_threshold_is_refused(cli: Cli) -> None:
    """An option that would do nothing is an error."""
    outcome = cli("validate", "x.mcap", "--alarm-confidence", "0.5")
    assert outcome.code == 2
    assert "--alarm-below" in outcome.err


@pytest.mark.parametrize("confidence", ["1.5", "-0.1", "often"])
def test_a_confidence_is_a_probability(cli: Cli, confidence: str) -> None:
    """Beyond 0 to 1 it is refused."""
    arguments = ("--method", "fused", "--alarm-below", "5mm", "--alarm-confidence", confidence)
    outcome = cli("validate", "x.mcap", *arguments)
    assert outcome.code == 2
    assert "Traceback" not in outcome.err
