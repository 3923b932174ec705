"""A report of 10,000 frames: how long its page takes to make, and how large it is."""

from __future__ import annotations

import pytest
from pytest_benchmark.fixture import BenchmarkFixture

from svmdist.report.html import page
from svmdist.workflows.series import Series
from tests.report.html.test_report_page import flickering, make_report, make_series

MAX_BYTES = 10e6


@pytest.mark.parametrize("series", [make_series(10_000), flickering(10_000, 3)], ids=["whole", "flickering"])
def test_page_of_ten_thousand_frames(benchmark: BenchmarkFixture, series: Series) -> None:
    report = make_report(series)
    text = benchmark(lambda: "".join(page(report)))
    assert len(text.encode()) < MAX_BYTES
