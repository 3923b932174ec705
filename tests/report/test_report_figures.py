"""Figures of a replay: each distance stands below its name, and the method's time is the last column."""

from __future__ import annotations

import numpy as np
import pytest

from svmdist.report.scores import GROUP_TITLES, figure_cells, figure_columns, figure_keys
from svmdist.workflows.compare import Figures
from svmdist.workflows.scoring.score import Pairs, score_pairs

TRUTH_M = np.linspace(0.01, 0.02, 10)
HALF_MM = score_pairs(Pairs(np.arange(10), TRUTH_M + 5e-4, TRUTH_M, np.full(10, np.nan)))


def test_headings_name_the_distance_once() -> None:
    """Lines of a heading: the distance over its first column, nothing over the others; then the metric."""
    headings = [tuple(column.heading.split("\n")) for column in figure_columns()]
    assert headings[0] == ("cov.", "%")
    assert headings[-1] == ("ms",)
    named = [upper for upper, _ in headings[1:-1] if upper]
    assert named == [title for title in GROUP_TITLES.values() if title]
    assert [lower for _, lower in headings[1:5]] == ["R²", "RMSE", "p95", "∈95 %"]


def test_cells_are_in_si_and_columns_in_mm() -> None:
    """0.5 mm is 5e-4 in the row and 0.50 in the table; what cannot be told is None and a dash."""
    cells = figure_cells(Figures(20, 10, HALF_MM, None, HALF_MM, 3.4))
    assert set(cells) == set(figure_keys(()))
    assert cells["rmse_m"] == pytest.approx(5e-4)
    assert (cells["coverage"], cells["spatial_rmse_m"], cells["interval_coverage"]) == (0.5, None, None)
    shown = {column.key: column.show(cells[column.key]) for column in figure_columns()}
    assert (shown["rmse_m"], shown["clearance_p95_abs_error_m"], shown["coverage"]) == (
        "0.50",
        "0.50",
        "50.0",
    )
    assert (shown["spatial_rmse_m"], shown["ms_per_frame"]) == ("–", "3")


def test_labels_stand_around_the_figures() -> None:
    """Labels before come first, labels after come last."""
    keys = figure_keys(("group",), ("instrument",))
    assert (keys[0], keys[-1]) == ("group", "instrument")
    assert keys[1:-1] == figure_keys(())
