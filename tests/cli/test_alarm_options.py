"""`svmdist estimate --alarm-below`: lengths with units, and the columns at the end."""

from __future__ import annotations

import csv
import io
from pathlib import Path

import pytest
from typer.testing import CliRunner

from svmdist.cli.main import app
from svmdist.cli.options import parse_length_m
from svmdist.errors import UsageError
from svmdist.report.estimates import ESTIMATE_KEYS


@pytest.mark.parametrize("text", ["5mm", "5 mm", "0.5cm", "0.005m"])
def test_lengths(text: str) -> None:
    """Every unit gives metres."""
    assert parse_length_m("--alarm-below", text) == pytest.approx(0.005)


@pytest.mark.parametrize("text", ["5", "mm", "-5mm", "0mm", "nanmm", "5in", "1e9m", ""])
def test_bad_lengths(text: str) -> None:
    """A length without unit, without number, or out of this world is told with an example."""
    with pytest.raises(UsageError, match="as in 5mm"):
        parse_length_m("--alarm-below", text)


def test_alarm_columns_stand_at_the_end(synthetic_log: Path) -> None:
    """Rows of a method without clearance have empty alarm fields, not false ones."""
    assert ESTIMATE_KEYS[-3:] == ("alarm", "closing_speed_m_s", "time_to_contact_s")
    result = CliRunner().invoke(
        app, ["estimate", str(synthetic_log), "--method", "centroid", "-f", "csv", "--alarm-below", "5mm"]
    )
    rows = list(csv.DictReader(io.StringIO(result.stdout)))
    assert rows
    assert all(row["alarm"] == "" for row in rows)
