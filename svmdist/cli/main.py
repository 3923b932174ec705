"""The command `svmdist`: its subcommands, and the one place where errors become a line and an exit code."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Annotated, Any

import typer
from typer.core import TyperCommand, TyperGroup

from svmdist.cli import (
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
from svmdist.cli.options import QUIET, VERBOSE, choose_verbosity, command_of
from svmdist.cli.output import LOG, ExitCode, abandon, adapt_streams, print_log, with_notes
from svmdist.errors import SvmdistError, Terminated, UsageError, did_you_mean

HELP = {"help_option_names": ["-h", "--help"]}
EXAMPLES = "\n\nExamples:\n"
NO_MEMORY = "there is not enough memory; try fewer --jobs"
CV_NO_MEMORY = -4
"""OpenCV's code of an allocation that failed."""
LIBRARY_NOT_LOADED = re.compile(
    r"failed to map segment|cannot allocate memory|cannot open shared object", re.IGNORECASE
)


class Command(TyperCommand):
    """A subcommand, with examples below its options."""

    def invoke(self, ctx: Any) -> Any:
        """Run the command and log how long it took."""
        begin_s = time.perf_counter()
        try:
            return super().invoke(ctx)
        finally:
            LOG.debug("%s took %.1f s", self.name, time.perf_counter() - begin_s)

    def format_epilog(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002
        """Write the examples as they are to be typed: no line is broken, whatever the terminal's width."""
        with formatter.section("Examples"):
            formatter.write(self.epilog)


class CommandGroup(TyperGroup):
    """Commands under one name: interruptible, and with examples."""

    def make_context(self, *args: Any, **kwargs: Any) -> Any:
        """Read the command line."""
        with _one_line():
            return super().make_context(*args, **kwargs)

    def invoke(self, *args: Any, **kwargs: Any) -> Any:
        """Run a subcommand."""
        with _one_line():
            return super().invoke(*args, **kwargs)

    def format_epilog(self, ctx: Any, formatter: Any) -> None:  # noqa: ARG002
        """Write the examples, and what else stands below the commands."""
        examples, _, rest = str(self.epilog).partition("\n\n")
        with formatter.section("Examples"):
            formatter.write(examples + "\n")
        if rest:
            formatter.write_paragraph()
            formatter.write_text(rest)


@contextmanager
def _one_line() -> Iterator[None]:
    """Turn an interrupt, and a wrong value, into one line and an exit code; a wrong choice gets the nearest ones."""
    try:
        yield
    except Terminated as problem:
        LOG.warning(with_notes("terminated", problem))
        sys.exit(128 + problem.signal_number)
    except KeyboardInterrupt as problem:
        LOG.warning(with_notes("interrupted", problem))
        sys.exit(ExitCode.INTERRUPTED)
    except typer.BadParameter as problem:
        found = re.fullmatch(r"(?:Value error, )?'(.*)' is not one of (.*)\.", problem.message)
        if found:
            name, choices = found[1], re.findall(r"'([^']*)'", found[2])
            problem.message = f"{name}: {did_you_mean(name, choices)}"
        raise UsageError(problem.format_message()) from None


app = typer.Typer(
    name="svmdist",
    cls=CommandGroup,
    help="Estimate the distance between surgical instruments and tissue from recorded logs, and score the estimates.",
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings=HELP,
    epilog="""  What a log holds, and which methods it can serve:
    svmdist info log.mcap
  A row per frame:
    svmdist estimate log.mcap --method fused -o rows.csv
  Errors against the truth, as a page:
    svmdist validate log.mcap --report report.html

Exit codes: 0 clean, 1 unusable, 2 usage, 3 usable with loss, 4 worse than the baseline, 130 interrupted,
143 terminated.""",
)
profile_app = typer.Typer(
    cls=CommandGroup,
    help="Make a profile.",
    no_args_is_help=True,
    rich_markup_mode=None,
    context_settings=HELP,
    epilog="  A first profile of a log:\n    svmdist profile new log.mcap -o mine.toml",
)


def _print_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        print(f"svmdist {version('svmdist')}")
        raise typer.Exit


@app.callback()
def main(
    version: Annotated[  # noqa: ARG001  (its callback has printed it)
        bool,
        typer.Option(
            "--version", "-V", help="Print the version and exit.", is_eager=True, callback=_print_version
        ),
    ] = False,
    quiet: bool = QUIET,
    verbose: bool = VERBOSE,
) -> None:
    """Hold the options of `svmdist` itself; everything else is a subcommand's."""
    choose_verbosity(quiet=quiet, verbose=verbose)


@profile_app.callback()
def _profile() -> None:
    """Make a profile."""


def _add(group: typer.Typer, name: str, function: Callable[[Any], None]) -> None:
    """Add a command: its docstring is the help, and ends with examples."""
    command = command_of(function)
    text, _, examples = str(command.__doc__).partition(EXAMPLES)
    group.command(name, cls=Command, help=text, epilog=examples + "\n")(command)


_add(app, "import", importing.import_command)
app.add_typer(profile_app, name="profile")
_add(profile_app, "new", profile.new_command)
_add(app, "info", info.info_command)
_add(app, "show", show.show_command)
_add(app, "record", record.record_command)
_add(app, "calibrate", calibrate.calibrate_command)
_add(app, "estimate", estimate.estimate_command)
_add(app, "validate", validate.validate_command)
_add(app, "compare", compare.compare_command)
_add(app, "blur-bench", compare.blur_bench_command)
_add(app, "fk", fk.fk_command)
_add(app, "hand-eye", hand_eye.hand_eye_command)


def run() -> None:
    """Run the command line and exit with its code."""
    adapt_streams()
    with print_log():
        try:
            app(prog_name="svmdist")
        except UsageError as problem:
            LOG.error("%s", problem)
            sys.exit(ExitCode.USAGE)
        except SvmdistError as problem:
            LOG.error("%s", with_notes(str(problem), problem))
            sys.exit(ExitCode.UNUSABLE)
        except Exception as problem:
            lack = missing_resource(problem)
            if lack is None:
                raise  # a fault of svmdist's own: its traceback is what helps to find it
            LOG.error("%s", with_notes(lack, problem))
            abandon(sys.stdout)
            sys.exit(ExitCode.UNUSABLE)


def missing_resource(error: BaseException) -> str | None:
    """What of the machine was exhausted when this was raised, in a line; None where it was something else.

    Every allocation, file and thread anywhere can be the one too many: there is no deeper place than this to look.
    """
    match error:
        case MemoryError():
            return NO_MEMORY
        case OSError(strerror=str(reason)):
            name = f"{error.filename}: " if isinstance(error.filename, str) else ""
            return f"{name}{reason}"
        case OSError():
            return str(error) or type(error).__name__
        case RuntimeError() if "can't start new thread" in str(error):
            return "no thread can be started; try --jobs 1"
        case ImportError() if LIBRARY_NOT_LOADED.search(str(error)):
            return f"a library cannot be loaded, perhaps for want of memory: {' '.join(str(error).split())}"
        case _:
            is_opencv = type(error).__module__ == "cv2" and type(error).__name__ == "error"
            return NO_MEMORY if is_opencv and getattr(error, "code", 0) == CV_NO_MEMORY else None
