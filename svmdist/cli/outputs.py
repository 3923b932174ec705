"""What `-o` asks for: the format by the file's ending, and what happens to a file that exists."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Iterable, Mapping
from enum import StrEnum
from pathlib import Path
from typing import Annotated, TypeVar

import typer

from svmdist.cli.options import RowFormat, SummaryFormat, TableFormat
from svmdist.errors import UsageError

Form = TypeVar("Form", bound=StrEnum)


class FileFormat(StrEnum):
    """What is written to a file only, by its ending."""

    MCAP = "mcap"
    MP4 = "mp4"
    HTML = "html"


ROW_ENDINGS = {f".{form}": form for form in RowFormat if form is not RowFormat.TABLE}
SUMMARY_ENDINGS = {
    ".csv": SummaryFormat.CSV,
    ".json": SummaryFormat.JSON,
    ".tex": SummaryFormat.LATEX,
    ".md": SummaryFormat.MARKDOWN,
    ".parquet": SummaryFormat.PARQUET,
}
TABLE_ENDINGS = {f".{form}": form for form in TableFormat if form is not TableFormat.TABLE}
FILE_ENDINGS = {f".{form}": form for form in FileFormat} | {".htm": FileFormat.HTML}
TEXT_ENDINGS = frozenset({"", ".txt", ".log", ".out"})
"""Files for a person: a table."""

ForceOption = Annotated[
    bool, typer.Option("--force", help="Replace a recording that exists. Other files are replaced anyway.")
]


def row_format(given: RowFormat | None, output: Path | None) -> RowFormat | FileFormat:
    """The format of rows: the given one, else that of the file's ending, else a table.

    Raises UsageError for a given format that the ending contradicts, where the ending is no text, and without one for
    an ending that no format has.
    """
    ending = "" if output is None else output.suffix.lower()
    if ending in FILE_ENDINGS:
        if given is not None:
            raise UsageError(
                f"--format {given}: {output} is written as {FILE_ENDINGS[ending]}; leave out one of them"
            )
        return FILE_ENDINGS[ending]
    return by_ending(ROW_ENDINGS, RowFormat.TABLE, output, others=FILE_ENDINGS) if given is None else given


def summary_format(given: SummaryFormat | None, output: Path | None) -> SummaryFormat:
    """The format of a summary: the given one, else that of the file's ending, else a table; raises UsageError."""
    chosen = by_ending(SUMMARY_ENDINGS, SummaryFormat.TABLE, output) if given is None else given
    if chosen is SummaryFormat.PARQUET:
        require_parquet(output)
    return chosen


def require_parquet(output: Path | None) -> None:
    """Fail before the work where Parquet cannot be written; UsageError without a file, OutputError without pyarrow."""
    from svmdist.report.tables import require_pyarrow

    if output is None:
        raise UsageError("--format parquet is no text: give a file with -o FILE.parquet")
    require_pyarrow()


def table_format(given: TableFormat | None, output: Path | None) -> TableFormat:
    """The same of what has no markup."""
    return by_ending(TABLE_ENDINGS, TableFormat.TABLE, output) if given is None else given


def by_ending(
    endings: Mapping[str, Form],
    plain: Form,
    output: Path | None,
    name: str = "a table",
    others: Iterable[str] = (),
) -> Form:
    """The format of a file's ending, `plain` for text and stdout; raises UsageError for another ending.

    A table in a file that is called .avi, or .html, is not what was meant.
    """
    ending = "" if output is None else output.suffix.lower()
    if ending in endings:
        return endings[ending]
    if ending in TEXT_ENDINGS or (output is not None and output.parent == Path("/dev")):
        return plain
    choices = ", ".join(sorted({*endings, *others}))
    hint = "; svmdist validate --report FILE.html writes a report" if ending in {".html", ".htm"} else ""
    raise UsageError(
        f"-o {output}: no format has the ending {ending}: the choices are {choices}, and .txt for {name}; or give"
        f" --format{hint}"
    )


def require_report(report: Path | None) -> None:
    """Check a report's name and what it needs before the work; raises UsageError or OutputError."""
    if report is None:
        return
    if report.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"--report {report}: a report is a page: give it the ending .html")
    from svmdist.report.html import require_plotly

    require_plotly()


def command_line() -> str:
    """The command as it was typed, for a report's provenance."""
    return shlex.join(["svmdist", *sys.argv[1:]])
