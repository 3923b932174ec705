"""Pages and tables of the documentation that are written from the code: columns, metrics, settings, perturbations.

What columns and metrics mean is written into their page by hand, and stays there. Run
`uv run python -m benchmarks.generated_pages` after a change of them; a test compares the pages with the code.
"""

from __future__ import annotations

import ast
import inspect
import math
import re
from collections.abc import Callable, Iterable, Sequence
from itertools import pairwise
from pathlib import Path
from typing import Any

from svmdist.perturbations import TABLE, Size
from svmdist.profile.settings import Settings
from svmdist.profile.toml import StrictModel
from svmdist.report.rows import ESTIMATE_KEYS
from svmdist.workflows.scoring.metric_table import Output, Tolerance, figure_metrics, score_metrics

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
REASON = re.compile(r"(?<!\d): .*$")  # what follows a colon says why, which is for who reads the code


def metrics_page(page: str) -> str:
    """The page with all columns and metrics; those with the same meaning stand in one line, new ones have none yet."""
    written = Output.SCORES | Output.FIGURES
    every = (one for one in (*score_metrics(), *figure_metrics()) if one.outputs & written)
    shown = {metric.key: metric for metric in every}.values()
    of_columns, of_metrics = words_in(page, "columns"), words_in(page, "metrics")
    rows = [(key, *of_columns.get(key, ("", ""))) for key in ESTIMATE_KEYS]
    figures = [
        (one.key, tolerance(one.tolerance, one.unit.name), of_metrics.get(one.key, ("", ""))[1]) for one in shown
    ]
    page = with_table(page, "columns", by_meaning("given by", rows))
    return with_table(page, "metrics", by_meaning("tolerance", figures))


def words_in(page: str, name: str) -> dict[str, tuple[str, str]]:
    """The second cell and the meaning of each key in a table of the page."""
    lines = (line.strip("|").split("|") for line in table_in(page, name).splitlines()[2:])
    return {key: (second, meaning) for keys, second, meaning in lines for key in re.findall(r"`(\w+)`", keys)}


def by_meaning(second: str, rows: Sequence[tuple[str, str, str]]) -> str:
    """A table of a key and two cells; rows with the same cells in one line."""
    keys: dict[tuple[str, str], list[str]] = {}
    for key, *cells in rows:
        keys.setdefault((cells[0], cells[1]), []).append(f"`{key}`")
    return table(("columns", second, "meaning"), [(", ".join(keys[cells]), *cells) for cells in keys])


def tolerance(of: Tolerance | None, unit: str) -> str:
    """How much worse a metric of a unit may get, in words."""
    if of is None:
        return ""
    absolute = f"{of.absolute:g}{'' if unit == '1' else f' {unit}'}"
    return f"{absolute} or {100 * of.relative:g} %" if of.relative else absolute


def settings_page(page: str) -> str:
    """The page with one row per setting."""
    rows = (
        (f"`{name}.{key}`", str(getattr(group, key)), REASON.sub(".", text, 1))
        for name, group in Settings()
        for key, text in meanings(type(group)).items()
    )
    return with_table(page, "settings", table(("setting", "default", "meaning"), rows))


def meanings(group: type[StrictModel]) -> dict[str, str]:
    """The docstring below each field of a group, else the comment beside it, read from its source."""
    source = inspect.getsource(group)
    (definition,) = ast.parse(source).body
    assert isinstance(definition, ast.ClassDef)
    found = {}
    for field, below in pairwise([*definition.body, ast.Pass()]):
        if not isinstance(field, ast.AnnAssign) or not isinstance(field.target, ast.Name):
            continue
        if isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant):
            text = str(below.value.value)
        else:
            comment = source.splitlines()[field.lineno - 1].partition("  # ")[2]
            text = f"{comment[:1].upper()}{comment[1:]}."
        found[field.target.id] = " ".join(text.split()).replace("|", "\\|")
    return found


def simulation_page(page: str) -> str:
    """The page of the simulation with its table of perturbations."""
    rows = [
        (f"`{one.name}`" + r"\*" * (not one.at_replay), one.unit, one.meaning, size_in_words(one.real))
        for one in TABLE.values()
    ]
    return with_table(page, "perturbations", table(("name", "unit", "meaning", "`--world real`"), rows))


def size_in_words(size: Size | None) -> str:
    """The size of a perturbation in real worlds."""
    if size is None:
        return "–"
    if size.uniform is not None:
        low, high = size.uniform
        return f"{low:g}" if low == high else f"{low:g} to {high:g}"
    along = f" along each of {size.axes} axes" if size.axes > 1 else ""
    within = f", at most {size.limit:g}" if math.isfinite(size.limit) else ""
    return f"std {size.std:g}{along}{within}"


def table(headings: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown."""
    return table_row(headings) + "|---" * len(headings) + "|\n" + "".join(map(table_row, rows))


def table_row(cells: Sequence[str]) -> str:
    """A row of a table in Markdown, without spaces, which count as words with the bars between them."""
    return f"|{'|'.join(cells)}|\n"


def with_table(page: str, name: str, table: str) -> str:
    """The page with what stands between the marks of this name replaced."""
    begin = f"<!-- {name}:begin -->\n"
    return page.replace(begin + table_in(page, name), begin + table)


def write_table(path: Path, name: str, table: str) -> None:
    """Replace a table of a page."""
    path.write_text(with_table(path.read_text("utf-8"), name, table), "utf-8")


def table_in(page: str, name: str) -> str:
    """What stands between the marks of this name."""
    found = re.search(rf"<!-- {name}:begin -->\n(.*?)<!-- {name}:end -->", page, re.DOTALL)
    if found is None:
        raise ValueError(f"the page has no place for the table {name}")
    return found[1]


def named(what: str, names: Sequence[str], choices: dict[str, Any]) -> Iterable[str]:
    """The names that a command line gives, all choices without any; ends the program for an unknown one."""
    for name in names:
        if name not in choices:
            raise SystemExit(f"no {what} {name}: the choices are {', '.join(choices)}")
    return names or choices


PAGES: dict[str, Callable[[str], str]] = {
    "metrics.md": metrics_page,
    "settings.md": settings_page,
    "simulation.md": simulation_page,
}
"""How each page is made from its present text."""


if __name__ == "__main__":
    for place, make in PAGES.items():
        page = DOCS / place
        page.write_text(make(page.read_text("utf-8")), "utf-8")
