"""Pages and tables of the documentation that are written from the code: columns, metrics, settings, perturbations.

Run `uv run python -m benchmarks.generated_pages` after a change of them; a test compares the pages with the code.
"""

from __future__ import annotations

import ast
import inspect
import re
import textwrap
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from pathlib import Path

from svmdist.perturbations.table import TABLE
from svmdist.profile.settings import Settings
from svmdist.profile.toml import StrictModel
from svmdist.report.columns_page import columns_page

DOCS = Path(__file__).resolve().parent.parent / "docs"
SETTINGS_HEAD = """# Settings

What a user may have reason to change; the defaults serve most logs. `stereo.near_m` is the key `near_m` of a profile's
table `[settings.stereo]`. A value outside its bounds is an error. Settings that became constants are
named in one line of warning, and ignored.

"""
REASON = re.compile(r"(?<!\d): .*$")
"""What follows a colon says why, which is for who reads the code."""


def settings_page(_: str) -> str:
    """One row per setting."""
    groups = ((name, getattr(Settings(), name)) for name in Settings.model_fields)
    rows = (
        (f"`{name}.{key}`", str(getattr(group, key)), REASON.sub(".", text, 1))
        for name, group in groups
        for key, text in meanings(type(group)).items()
    )
    return SETTINGS_HEAD + table(("setting", "default", "meaning"), rows)


def meanings(group: type[StrictModel]) -> dict[str, str]:
    """The docstring below each field of a group, read from its source."""
    (definition,) = ast.parse(textwrap.dedent(inspect.getsource(group))).body
    assert isinstance(definition, ast.ClassDef)
    found = {}
    for field, below in pairwise(definition.body):
        is_text = isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant)
        if isinstance(field, ast.AnnAssign) and isinstance(field.target, ast.Name) and is_text:
            text = str(ast.literal_eval(below.value))  # type: ignore[attr-defined]
            found[field.target.id] = " ".join(text.split()).replace("|", "\\|")
    return found


def simulation_page(page: str) -> str:
    """The page of the simulation with its table of perturbations."""
    rows = (
        (
            f"`{entry.name}`" + ("" if entry.at_replay else r"\*"),
            entry.unit,
            entry.meaning,
            "–" if entry.real is None else str(entry.real),
        )
        for entry in TABLE.values()
    )
    return with_table(page, "perturbations", table(("name", "unit", "meaning", "`--world real`"), rows))


def table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    return table_row(headings) + "|---" * len(headings) + "|\n" + "".join(map(table_row, rows))


def table_row(cells: Sequence[str]) -> str:
    """A row of a table in Markdown."""
    return f"| {' | '.join(cells)} |\n"


def with_table(page: str, name: str, table: str) -> str:
    """The page with what stands between the marks of this name replaced."""
    begin, end = f"<!-- {name}:begin -->\n", f"<!-- {name}:end -->"
    before, found, rest = page.partition(begin)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise ValueError(f"the page has no place for the table {name}")
    return f"{before}{begin}{table}{end}{after}"


def write_table(path: Path, name: str, table: str) -> None:
    """Replace a table of a page."""
    path.write_text(with_table(path.read_text("utf-8"), name, table), "utf-8")


def table_in(page: str, name: str) -> str:
    """What stands between the marks of this name."""
    return page.partition(f"<!-- {name}:begin -->\n")[2].partition(f"<!-- {name}:end -->")[0]


PAGES: dict[str, Callable[[str], str]] = {
    "metrics.md": lambda _: columns_page(),
    "settings.md": settings_page,
    "simulation.md": simulation_page,
}
"""How each page is made from its present text."""


def main() -> None:
    """Write all pages anew."""
    for name, make in PAGES.items():
        path = DOCS / name
        path.write_text(make(path.read_text("utf-8") if path.exists() else ""), "utf-8")


if __name__ == "__main__":
    main()
