"""What `-o` asks for: what happens to a file that exists, and what a report needs."""

from __future__ import annotations

import shlex
import sys
from pathlib import Path
from typing import Annotated

import typer

from svmdist.errors import UsageError
from svmdist.report.writers import require_report as require_report_packages

ForceOption = Annotated[
    bool, typer.Option("--force", help="Replace a recording that exists. Other files are replaced anyway.")
]


def require_report(report: Path | None) -> None:
    """Check a report's name and what it needs before the work; raises UsageError or OutputError."""
    if report is None:
        return
    if report.suffix.lower() not in (".html", ".htm"):
        raise UsageError(f"--report {report}: a report is a page: give it the ending .html")
    require_report_packages()


def command_line() -> str:
    """The command as it was typed, for a report's provenance."""
    return shlex.join(["svmdist", *sys.argv[1:]])
