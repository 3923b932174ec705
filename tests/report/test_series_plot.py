"""Plots of series show their numbers, with the method in the title, and differ without colour."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.axes import Axes

from svmdist.errors import OutputError
from svmdist.report.charts import LEVELS, pooled, rejected_spans
from svmdist.report.plots import COLUMN_IN, PAGE_IN, SeriesPlot, draw_series
from tests.cli.conftest import Cli, cli
from tests.report.test_html import make_series

__all__ = ["cli"]
NOWHERE = Path("figure.png")


def drawn(axes: Axes) -> dict[str, np.ndarray]:
    return {str(line.get_label()): np.asarray(line.get_ydata(), float) for line in axes.get_lines()}


def test_time_plots_hold_estimate_truth_threshold_and_lost_spans() -> None:
    series = make_series(60)
    figure = draw_series([series], SeriesPlot.TIME, NOWHERE, 0.005)
    (axes,) = figure.axes
    lines = drawn(axes)
    np.testing.assert_allclose(lines["estimate"], series.estimate_m * 1e3)
    np.testing.assert_allclose(lines["truth"], series.truth_m * 1e3)
    assert set(lines["alarm below 5 mm"]) == {5.0}
    assert axes.get_title(loc="left") == "log PSM1: fused, 55 of 60 frames"
    styles = {line.get_linestyle() for line in axes.get_lines()}
    assert len(styles) == 3  # told apart without colour
    assert figure.get_figwidth() == PAGE_IN
    assert rejected_spans(series) == [(0.95, 1.45)]


def test_agreement_draws_bias_and_limits() -> None:
    series = make_series(300)
    figure = draw_series([series], SeriesPlot.BLAND_ALTMAN, NOWHERE)
    _, error_mm, _ = pooled([series])
    levels = [float(line.get_ydata()[0]) for line in figure.axes[0].get_lines()]
    deviation = error_mm.std(ddof=1)
    expected = [error_mm.mean(), error_mm.mean() - 1.96 * deviation, error_mm.mean() + 1.96 * deviation]
    np.testing.assert_allclose(levels, expected)
    assert figure.get_figwidth() == COLUMN_IN


def test_calibration_draws_the_share_of_truths_inside() -> None:
    series = make_series(300)
    figure = draw_series([series], SeriesPlot.CALIBRATION, NOWHERE)
    held = drawn(figure.axes[0])["truths inside"]
    _, error_mm, std_mm = pooled([series])
    assert held[LEVELS.index(0.5)] == pytest.approx(
        100 * np.mean(np.abs(error_mm) <= 0.67449 * std_mm), abs=1e-6
    )


def test_residuals_of_two_logs_have_two_markers() -> None:
    figure = draw_series([make_series(40), make_series(40, "other")], SeriesPlot.RESIDUALS, NOWHERE)
    over_time = figure.axes[0]
    assert [text.get_text() for text in over_time.get_legend().get_texts()] == ["log PSM1", "other PSM1"]
    assert "fused" in over_time.get_title(loc="left")


def test_without_truth_there_is_nothing_to_agree_with() -> None:
    blind = replace(make_series(20), truth_m=np.full(20, np.nan))
    with pytest.raises(OutputError, match="no frame has a truth"):
        draw_series([blind], SeriesPlot.RESIDUALS, NOWHERE)


def test_commands_write_plots(golden: Path, cli: Cli, tmp_path: Path) -> None:
    log = golden / "sweep.mcap"
    assert cli("estimate", log, "-f", "csv", "--save-plot", tmp_path / "e.png").code == 0
    assert cli("validate", log, "--plot", "residuals", "--save-plot", tmp_path / "v.png").code == 0
    for name in ("e.png", "v.png"):
        picture = cv2.imread(str(tmp_path / name))
        assert picture is not None
        assert picture.shape[1] == pytest.approx(PAGE_IN * 300, abs=2)
        assert (picture < 128).mean() > 0.002
    alone = cli("validate", log, "--plot", "residuals")
    assert alone.code == 2
    assert "--save-plot" in alone.err
    assert cli("estimate", log, "--save-plot", tmp_path / "e.txt").code == 1
