"""Remake docs/metrics.md after a change of the declared metrics: `uv run python -m benchmarks.make_metrics_page`."""

from __future__ import annotations

from pathlib import Path

from svmdist.report.columns_page import columns_page

PAGE = Path(__file__).resolve().parent.parent / "docs" / "metrics.md"

if __name__ == "__main__":
    PAGE.write_text(columns_page(), "utf-8")
