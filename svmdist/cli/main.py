"""The command `svmdist`: its subcommands, and the one place where errors become a line and an exit code."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any

import typer
from typer.core import TyperGroup

from svmdist.cli import blur_bench, calibrate, compare, estimate, fk, info, record, show, validate
from svmdist.cli.console import ExitCode, say
from svmdist.errors import SvmdistError, UsageError, did_you_mean


class Commands(TyperGroup):
    """The subcommands, interruptible: by itself Typer would exit without a word, or with another code."""

    def make_context(self, *args: Any, **kwargs: Any) -> Any:
        """Read the command line."""
        with _interruptible(), _plain_choices():
            return super().make_context(*args, **kwargs)

    def invoke(self, *args: Any, **kwargs: Any) -> Any:
        """Run a subcommand."""
        with _interruptible(), _plain_choices():
            return super().invoke(*args, **kwargs)


@contextmanager
def _interruptible() -> Iterator[None]:
    """Turn an interrupt into one line and the exit code that shells give it."""
    try:
        yield
    except KeyboardInterrupt:
        say("svmdist: interrupted")
        sys.exit(ExitCode.INTERRUPTED)


@contextmanager
def _plain_choices() -> Iterator[None]:
    """Tell a wrong choice as everything else here does, the nearest one first, in place of Typer's words."""
    try:
        yield
    except typer.BadParameter as problem:
        found = re.fullmatch(r"(?:Value error, )?'(.*)' is not one of (.*)\.", problem.message)
        if found:
            name, choices = found[1], re.findall(r"'([^']*)'", found[2])
            problem.message = f"{name}: {did_you_mean(name, choices)}"
        raise


app = typer.Typer(
    name="svmdist",
    cls=Commands,
    help="Estimate the distance between surgical instruments and tissue from recorded logs, and score the estimates.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Exit codes: 0 clean, 1 unusable, 2 usage, 3 usable with loss, 4 worse than the baseline,"
    " 130 interrupted.",
)


def _print_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        print(f"svmdist {version('svmdist')}")
        raise typer.Exit


VersionOption = Annotated[
    bool,
    typer.Option(
        "--version", "-V", help="Print the version and exit.", is_eager=True, callback=_print_version
    ),
]


@app.callback()
def main(version: VersionOption = False) -> None:
    """Hold the options of `svmdist` itself; everything else is a subcommand's."""


app.command("info")(info.info_command)
app.command("show")(show.show_command)
app.command("record")(record.record_command)
app.command("calibrate")(calibrate.calibrate_command)
app.command("estimate")(estimate.estimate_command)
app.command("validate")(validate.validate_command)
app.command("compare")(compare.compare_command)
app.command("blur-bench")(blur_bench.blur_bench_command)
app.command("fk")(fk.fk_command)


def run() -> None:
    """Run the command line and exit with its code."""
    try:
        app()
    except UsageError as problem:
        say(f"svmdist: {problem}")
        sys.exit(ExitCode.USAGE)
    except SvmdistError as problem:
        say(f"svmdist: {problem}")
        sys.exit(ExitCode.UNUSABLE)
