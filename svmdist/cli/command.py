"""Commands and groups of commands: -q and -v everywhere, examples in the help, interrupts, and wrong choices told."""

from __future__ import annotations

import re
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from svmdist.cli.console import ExitCode, Verbosity, say, set_verbosity, with_notes
from svmdist.cli.examples import EXAMPLES
from svmdist.errors import Terminated, did_you_mean

QUIET, VERBOSE = ("-q", "--quiet"), ("-v", "--verbose")
QUIET_HELP = "Print errors only beside the data."
VERBOSE_HELP = "Also print which topics are read, and the time taken."


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

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the options, and the two that every command has."""
        super().format_options(ctx, formatter)
        with formatter.section("Options of every command"):
            formatter.write_dl([(", ".join(QUIET), QUIET_HELP), (", ".join(VERBOSE), VERBOSE_HELP)])

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the examples, and what else stands below the options."""
        write_examples(ctx, formatter)
        super().format_epilog(ctx, formatter)


class CommandGroup(TyperGroup):
    """Commands under one name, with examples."""

    def format_epilog(self, ctx: Any, formatter: Any) -> None:
        """Write the examples, and what else stands below the commands."""
        write_examples(ctx, formatter)
        super().format_epilog(ctx, formatter)


class Commands(CommandGroup):
    """The subcommands, interruptible: by itself Typer would exit without a word, or with another code."""

    def make_context(self, *args: Any, **kwargs: Any) -> Any:
        """Read the command line."""
        with _interruptible(), _plain_choices():
            return super().make_context(*args, **kwargs)

    def invoke(self, *args: Any, **kwargs: Any) -> Any:
        """Run a subcommand."""
        with _interruptible(), _plain_choices():
            return super().invoke(*args, **kwargs)


def write_examples(ctx: Any, formatter: Any) -> None:
    """Write a command's examples as they are to be typed: no line is broken, whatever the terminal's width."""
    names = [ctx.info_name]
    while ctx.parent is not None:
        ctx = ctx.parent
        names.insert(0, ctx.info_name)
    name = " ".join(names[1:]) or "svmdist"
    with formatter.section("Examples"):
        for example in EXAMPLES.get(name, ()):
            formatter.write(f"{'':{formatter.current_indent}}{example.purpose}:\n")
            formatter.write(f"{'':{formatter.current_indent}}  {example.command}\n")


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
