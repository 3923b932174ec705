"""docs/simulation.md lists what is declared, and names each source that the table names."""

from __future__ import annotations

import re

from benchmarks.perturbation_docs import PAGE, page_with_table
from svmdist.perturbations.table import TABLE


def test_the_page_is_made_from_the_declarations() -> None:
    """After a change of the table, `uv run python -m benchmarks.perturbation_docs` writes it anew."""
    page = PAGE.read_text("utf-8")
    assert page == page_with_table(page)


def test_every_source_is_in_the_list_of_sources() -> None:
    page = PAGE.read_text("utf-8")
    listed = page.partition("### Sources\n")[2].partition("\n## ")[0].replace("\n  ", " ")
    for entry in TABLE.values():
        for author, year in re.findall(r"([A-Z][a-z]+)(?: et al\.)? (\d{4})", entry.source):
            assert re.search(rf"{author}.*\b{year}", listed), entry.source
