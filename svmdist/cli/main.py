"""The command `svmdist`: its subcommands, and the one place where errors become a line and an exit code."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from svmdist.cli import (
    blur_bench,
    calibrate,
    compare,
    estimate,
    fk,
    hand_eye,
    importing,
    info,
    profile,
    record,
    show,
    validate,
)
from svmdist.cli.command import QUIET, QUIET_HELP, VERBOSE, VERBOSE_HELP, Command, Commands
from svmdist.cli.console import ExitCode, Verbosity, abandon, adapt_streams, say, set_verbosity, with_notes
from svmdist.cli.resources import what_lacks
from svmdist.errors import SvmdistError, UsageError

app = typer.Typer(
    name="svmdist",
    cls=Commands,
    help="Estimate the distance between surgical instruments and tissue from recorded logs, and score the estimates.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
    epilog="Exit codes: 0 clean, 1 unusable, 2 usage, 3 usable with loss, 4 worse than the baseline,"
    " 130 interrupted, 143 terminated.",
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


QuietOption = Annotated[bool, typer.Option(*QUIET, help=QUIET_HELP)]
VerboseOption = Annotated[bool, typer.Option(*VERBOSE, help=VERBOSE_HELP)]


@app.callback()
def main(
    version: VersionOption = False,  # noqa: ARG001  (its callback has printed it)
    quiet: QuietOption = False,
    verbose: VerboseOption = False,
) -> None:
    """Hold the options of `svmdist` itself; everything else is a subcommand's."""
    if quiet or verbose:
        set_verbosity(Verbosity.QUIET if quiet else Verbosity.VERBOSE)


app.command("import", cls=Command)(importing.import_command)
app.add_typer(profile.profile_app, name="profile")
app.command("info", cls=Command)(info.info_command)
app.command("show", cls=Command)(show.show_command)
app.command("record", cls=Command)(record.record_command)
app.command("calibrate", cls=Command)(calibrate.calibrate_command)
app.command("estimate", cls=Command)(estimate.estimate_command)
app.command("validate", cls=Command)(validate.validate_command)
app.command("compare", cls=Command)(compare.compare_command)
app.command("blur-bench", cls=Command)(blur_bench.blur_bench_command)
app.command("fk", cls=Command)(fk.fk_command)
app.command("hand-eye", cls=Command)(hand_eye.hand_eye_command)


def run() -> None:
    """Run the command line and exit with its code."""
    adapt_streams()
    set_verbosity(Verbosity.NORMAL)
    try:
        app(prog_name="svmdist")
    except UsageError as problem:
        say(f"svmdist: {problem}", Verbosity.QUIET)
        sys.exit(ExitCode.USAGE)
    except SvmdistError as problem:
        say(with_notes(f"svmdist: {problem}", problem), Verbosity.QUIET)
        sys.exit(ExitCode.UNUSABLE)
    except Exception as problem:
        lack = what_lacks(problem)
        if lack is None:
            raise  # a fault of svmdist's own: its traceback is what helps to find it
        say(with_notes(f"svmdist: {lack}", problem), Verbosity.QUIET)
        abandon(sys.stdout)
        sys.exit(ExitCode.UNUSABLE)
