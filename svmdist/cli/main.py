"""The command `svmdist`: its subcommands, and the one place where errors become a line and an exit code."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

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
from svmdist.cli.console import ExitCode, Verbosity, abandon, adapt_streams, say, set_verbosity, with_notes
from svmdist.cli.resources import what_lacks
from svmdist.errors import SvmdistError, Terminated, UsageError, did_you_mean

QUIET, VERBOSE = ("-q", "--quiet"), ("-v", "--verbose")


class Command(TyperCommand):
    """A subcommand, which takes -q and -v as `svmdist` itself does: who types them looks for them in neither place."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the arguments, and how much is to be printed."""
        own = args.index("--") if "--" in args else len(args)
        for names, verbosity in ((VERBOSE, Verbosity.VERBOSE), (QUIET, Verbosity.QUIET)):
            if set(names) & set(args[:own]):
                set_verbosity(verbosity)
        kept = [argument for argument in args[:own] if argument not in (*QUIET, *VERBOSE)]
        return super().parse_args(ctx, [*kept, *args[own:]])

    def invoke(self, ctx: Any) -> Any:
        """Run the command and tell how long it took."""
        begin_s = time.perf_counter()
        try:
            return super().invoke(ctx)
        finally:
            say(f"svmdist: {self.name} took {time.perf_counter() - begin_s:.1f} s", Verbosity.VERBOSE)


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
    except KeyboardInterrupt as problem:
        is_ended = isinstance(problem, Terminated)
        say(with_notes("svmdist: terminated" if is_ended else "svmdist: interrupted", problem))
        sys.exit(128 + problem.signal_number if isinstance(problem, Terminated) else ExitCode.INTERRUPTED)


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


QuietOption = Annotated[bool, typer.Option(*QUIET, help="Print errors only beside the data.")]
VerboseOption = Annotated[
    bool, typer.Option(*VERBOSE, help="Also print which topics are read, and the time taken.")
]


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
        app()
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
