"""Tables for papers and for pages: LaTeX with booktabs, and Markdown."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from rich.table import Table

from svmdist.report.text import printable

LATEX_SPECIAL = {
    "\\": r"\textbackslash{}",
    "&": r"\&",
    "%": r"\%",
    "$": r"\$",
    "#": r"\#",
    "_": r"\_",
    "{": r"\{",
    "}": r"\}",
    "~": r"\textasciitilde{}",
    "^": r"\textasciicircum{}",
    "²": r"\textsuperscript{2}",
    "σ": r"$\sigma$",
    "≥": r"$\geq$",
    "±": r"$\pm$",
    "–": "--",
    "−": "$-$",
    "×": r"$\times$",
}


def latex(tables: Sequence[Table], notes: Sequence[str]) -> Iterator[str]:
    """Each table as a `table` of the package booktabs, its title as the caption; notes as comments."""
    for table in tables:
        yield "\\begin{table}\n\\centering\n"
        if table.title:
            yield f"\\caption{{{latex_text(str(table.title))}}}\n"
        sides = "".join("r" if column.justify == "right" else "l" for column in table.columns)
        yield f"\\begin{{tabular}}{{{sides}}}\n\\toprule\n"
        yield _row(_headings(table), latex_text, " & ", " \\\\\n")
        yield "\\midrule\n"
        for row, cells in zip(table.rows, _cells(table), strict=True):
            yield _row(cells, latex_text, " & ", " \\\\\n")
            if row.end_section:
                yield "\\midrule\n"
        yield "\\bottomrule\n\\end{tabular}\n\\end{table}\n"
    for note in notes:
        yield f"% {printable(note)}\n"


def markdown(tables: Sequence[Table], notes: Sequence[str]) -> Iterator[str]:
    """Each table with pipes, its title above it; notes below."""
    for table in tables:
        if table.title:
            yield f"**{markdown_text(str(table.title))}**\n\n"
        yield "| " + _row(_headings(table), markdown_text, " | ", " |\n")
        sides = ("---:" if column.justify == "right" else "---" for column in table.columns)
        yield "|" + "|".join(sides) + "|\n"
        for cells in _cells(table):
            yield "| " + _row(cells, markdown_text, " | ", " |\n")
        yield "\n"
    for note in notes:
        yield f"{markdown_text(note)}\n\n"


def latex_text(text: str) -> str:
    """Text with LaTeX's special characters escaped."""
    return "".join(LATEX_SPECIAL.get(letter, letter) for letter in printable(text))


def markdown_text(text: str) -> str:
    """Text that is no markup and ends no cell."""
    plain = printable(text)
    for letter in ("\\", "|", "*", "_", "`", "<"):
        plain = plain.replace(letter, f"\\{letter}")
    return plain


def _headings(table: Table) -> list[str]:
    return [" ".join(str(column.header).split()) for column in table.columns]


def _cells(table: Table) -> Iterator[tuple[str, ...]]:
    columns = [[str(cell) for cell in column.cells] for column in table.columns]
    return zip(*columns, strict=True)


def _row(cells: Sequence[str], escape: Callable[[str], str], between: str, end: str) -> str:
    return between.join(escape(cell) for cell in cells) + end
