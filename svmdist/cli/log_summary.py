"""`--summary` and `--group`: figures of each log, of groups, and of all together, in a file of their own."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from svmdist.cli.console import require_output, write_results
from svmdist.cli.many import group_keys
from svmdist.errors import UsageError
from svmdist.report.writers import Holds, choose_writer

if TYPE_CHECKING:
    from svmdist.input_file import LogPath
    from svmdist.report.scores import LogFigures

SummaryOption = Annotated[
    Path | None,
    typer.Option(
        "--summary",
        metavar="FILE",
        help="Write the figures of each log, what went wrong most first, of groups and of all logs to this file"
        " (csv, json, parquet, md, tex, or text).",
        show_default=False,
    ),
]


@dataclass(frozen=True)
class LogSummary:
    """Where the figures go, and by which metadata logs are grouped."""

    output: Path | None
    keys: tuple[str, ...]

    @staticmethod
    def of(output: Path | None, group: str | None, inputs: Iterable[LogPath]) -> LogSummary:
        """Check the options before the work; raises UsageError or OutputError."""
        keys = group_keys(group)
        if output is None:
            if keys:
                raise UsageError(
                    f"--group {group}: groups the figures of logs: say where they go with --summary FILE"
                )
            return LogSummary(None, ())
        require_output(output, inputs)
        choose_writer(None, output, Holds.FIGURES)
        return LogSummary(output, keys)

    @property
    def is_asked_for(self) -> bool:
        """Whether figures of logs are wanted."""
        return self.output is not None

    def write(self, each: Sequence[LogFigures], together: Sequence[LogFigures]) -> None:
        """Write the figures, where they are asked for."""
        from svmdist.report.scores import log_results

        if self.output is not None:
            writer = choose_writer(None, self.output, Holds.FIGURES)
            write_results(log_results(each, together), writer, self.output)
