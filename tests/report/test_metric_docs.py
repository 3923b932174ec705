"""docs/metrics.md is what the declared metrics say."""

from __future__ import annotations

import re

from svmdist.report.metric_docs import metrics_page, metrics_table
from svmdist.report.scores import compare_keys, score_keys
from tests.conftest import REPOSITORY

LABELS = {"recording", "method", "equations", "reference", "instrument", "group", "scenario", "degradation"}


def test_the_page_is_made_from_the_declarations() -> None:
    """After a change of the metrics, `uv run python -m benchmarks.make_metrics_page` writes it anew."""
    assert (REPOSITORY / "docs" / "metrics.md").read_text("utf-8") == metrics_page()


def test_every_column_has_one_row() -> None:
    """Each column but the labels is explained once, and no other name is."""
    rows = metrics_table().splitlines()[2:]
    named = [key for row in rows for key in re.findall(r"`(\w+)`", row.split("|")[1])]
    assert len(named) == len(set(named))
    assert set(named) == {*score_keys(), *compare_keys()} - LABELS
    assert {row.count("|") for row in rows} == {7}


def test_tolerances_are_told_with_their_unit() -> None:
    """A length in m and its share; a share without a unit."""
    (rmse,) = (row for row in metrics_table().splitlines() if row.startswith("| `rmse_m`"))
    assert "| m | lower | 2e-05 m or 2 % |" in rmse
    (recall,) = (row for row in metrics_table().splitlines() if row.startswith("| `alarm_recall`"))
    assert "| 1 | higher | 0.005 |" in recall
