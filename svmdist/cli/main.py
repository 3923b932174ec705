"""The command `svmdist`: its subcommands, their help, and the one place where errors become a line and an exit code."""

from __future__ import annotations

import inspect
import io
import re
import sys
from collections import Counter
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import typer
from typer.core import TyperCommand, TyperGroup

from svmdist.cli import measure, new_logs, scores, show
from svmdist.cli.options import QUIET, VERBOSE, Options, choose_verbosity, function_of, name_of, option
from svmdist.cli.output import LOG, ExitCode, abandon, print_log, with_notes
from svmdist.errors import SvmdistError, Terminated, UsageError, did_you_mean
from svmdist.files import FALLBACK

NO_MEMORY = "there is not enough memory; try fewer --jobs"
CV_NO_MEMORY = -4  # OpenCV's code of an allocation that failed
LIBRARY_NOT_LOADED = re.compile(r"(?i)failed to map segment|cannot allocate memory|cannot open shared object")
PANELS = {
    "Input": "files file source right pattern right_pattern side_by_side topic joints profile hand_eye start end every"
    " rate times poses joint_names crop",
    "Camera": "camera_file right_calibration calibrated_at camera right_camera distortion distortion_model"
    " baseline_length unit",
    "Scene": "scenario seed duration images_per_second stereo tag arms",
    "Errors and degradations": "degrade perturb kernel noise kinematic_error world",
    "Method": "method calibration equations instrument lag alarm_below alarm_when against estimates in_camera",
    "Truth": "truth truth_tf max_gap",
    "Images": "masks frame at worst",
    "Output": "output form report save_plot plot summary force jpeg name",
    "Regressions": "baseline write_baseline",
    "Processes, many logs": "jobs scheduler resume group episodes skip_existing",
    "General": "quiet verbose version install_completion show_completion help",
}
"""Headings, and the parameters below each in their order."""


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
        if choice := re.fullmatch(r"(?:Value error, )?'(.*)' is not one of (.*)\.", problem.message):
            name, choices = choice[1], re.findall(r"'([^']*)'", choice[2])
            problem.message = f"{name}: {did_you_mean(name, choices)}"
        said = problem.format_message()
        wanted = re.fullmatch(r"Input should be (.+?)(?:, unable to .*)?", problem.message)
        if wanted and problem.param is not None:
            cause: Any = problem.__cause__  # of pydantic
            found = cause.errors()[0]["input"]
            said = f"{problem.param.opts[0]} {found}: expected {problem.param.metavar}, {wanted[1]}"
        if said.startswith("Missing") and problem.ctx is not None:
            said += f" `{problem.ctx.command_path} -h` has examples."
        raise UsageError(said) from None
    except Exception as problem:
        ctx, form = getattr(problem, "ctx", None), getattr(problem, "format_message", None)
        if form is None or (ctx is not None and form() == ctx.get_help()):  # not of typer, or no words at all
            raise
        said, command = form(), "svmdist" if ctx is None else ctx.command_path
        raise UsageError(f"{said}{'' if said[-1] in '.?' else '.'} `{command} -h` has examples.") from None


class Helped:
    """Commands, and groups of them, with this help."""

    def format_options(self: Any, ctx: Any, formatter: Any) -> None:
        """Write the examples, the commands of a group, and the options under their headings."""
        self._write(self.epilog.partition("\n\n")[0], formatter)
        if hasattr(self, "format_commands"):
            self.format_commands(ctx, formatter)
        given = {one.name: (_names(one), one.help) for one in self.get_params(ctx) if not one.hidden}
        width = max(len(names) for names, _ in given.values() if len(names) <= 26)  # longer ones stand above their text
        for heading, members in PANELS.items():
            if found := [given[name] for name in members.split() if name in given]:
                with formatter.section(heading):  # padded, so that all texts begin at one column
                    formatter.write_dl([(names.ljust(width), text) for names, text in found], width)

    def format_epilog(self: Any, _ctx: Any, formatter: Any) -> None:
        """Write what stands behind the examples."""
        self._write(self.epilog.partition("\n\n")[2], formatter)

    def _write(self, text: str, formatter: Any) -> None:
        if text:
            formatter.write_paragraph()
            with formatter.indentation():
                formatter.write_text(text)


def _names(parameter: Any) -> str:
    if parameter.param_type_name == "argument":
        return f"{parameter.metavar}{'...' * (parameter.nargs != 1)}"
    return " ".join(filter(None, (", ".join(sorted(parameter.opts, key=len)), parameter.metavar)))


class Command(Helped, TyperCommand):
    """A command; of one with `--format`, `--json` is `-f json`."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        """Read the words behind the command's name."""
        if any(one.name == "form" for one in self.params):
            args = [word for one in args for word in (("-f", "json") if one == "--json" else (one,))]
        _, _, order = self.make_parser(ctx).parse_args(list(args))
        rest = super().parse_args(ctx, args)
        for one, count in Counter(order).items():
            counts_once = not (one.multiple or getattr(one, "is_flag", False))
            if counts_once and count > 1 and not (ctx.params["quiet"] or ctx.resilient_parsing):
                LOG.info("note: %s is given %d times, of which the last one counts", one.opts[0], count)
        return rest


class CommandGroup(Helped, TyperGroup):
    """Commands under one name, of which each ends with a line where it is interrupted."""

    @_one_line()
    def make_context(self, info_name: str | None, args: list[str], *rest: Any, **more: Any) -> Any:
        """Read the words of the command line; `help COMMAND` is `COMMAND --help`."""
        args = [*args[1:], "--help"] if args[:1] == ["help"] else args
        return super().make_context(info_name, args, *rest, **more)

    invoke = _one_line()(TyperGroup.invoke)


GROUP: dict[str, Any] = {
    "cls": CommandGroup,
    "no_args_is_help": True,
    "rich_markup_mode": None,
    "context_settings": {"help_option_names": ["-h", "--help"], "max_content_width": 140},
}
app = typer.Typer(
    **GROUP,
    name="svmdist",
    help="Estimate the distance between surgical instruments and tissue from recorded logs, and score the estimates.",
    pretty_exceptions_enable=False,
    epilog="""\b
Examples:
  What a log holds, and which methods it can serve:
    svmdist info log.mcap
  A row per frame:
    svmdist estimate log.mcap --method fused -o rows.csv
  Errors against the truth, as a page:
    svmdist validate log.mcap --report report.html

Exit codes: 0 clean, 1 unusable, 2 usage, 3 usable with loss or with a contradiction, 4 worse than the baseline (of
check: contradictory), 130 interrupted, 143 terminated.""",
)
profiles = typer.Typer(
    **GROUP,
    help="Make a profile.",
    epilog="\b\nExamples:\n  A first profile of a log:\n    svmdist profile new log.mcap -o mine.toml",
)
app.add_typer(profiles, name="profile")


def _add(group: typer.Typer, *commands: type[Options]) -> None:
    """Add commands: a class's docstring is the help, and ends with examples."""
    for command in commands:
        text, examples = str(inspect.getdoc(command)).split("\n\nExamples:\n")
        add = group.command(name_of(command), cls=Command, help=text, epilog=f"\b\nExamples:\n{examples}")
        add(function_of(command))


_add(profiles, new_logs.New)
_add(app, new_logs.Import, show.Info, show.Check, show.Show, new_logs.Record, show.Surface)
_add(app, measure.Calibrate, measure.Estimate, scores.Validate, scores.Compare, scores.BlurBench)
_add(app, measure.Fk, measure.HandEye)


def _print_version(asked: bool) -> None:
    if asked:
        from importlib.metadata import version

        print(f"svmdist {version('svmdist')}")
        raise typer.Exit


@app.callback()
def main(
    version: bool = option(  # noqa: ARG001  (its callback has printed it)
        "--version -V", "Print the version and exit.", False, is_eager=True, callback=_print_version
    ),
    quiet: bool = QUIET,
    verbose: bool = VERBOSE,
) -> None:
    """Hold the options of `svmdist` itself; everything else is a subcommand's."""
    choose_verbosity(quiet=quiet, verbose=verbose)


def run() -> None:
    """Run the command line and exit with its code."""
    # No text fails for want of a character in the terminal's encoding, in a file's name, or in the C locale.
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=FALLBACK)
    with print_log():
        try:
            app(prog_name="svmdist")
        except SvmdistError as problem:
            LOG.error("%s", with_notes(str(problem), problem))
            sys.exit(ExitCode.USAGE if isinstance(problem, UsageError) else ExitCode.UNUSABLE)
        except Exception as problem:
            lack = missing_resource(problem)
            if lack is None:
                raise  # a fault of svmdist's own: its traceback is what helps to find it
            LOG.error("%s", with_notes(lack, problem))
            abandon(sys.stdout)
            sys.exit(ExitCode.UNUSABLE)


def missing_resource(error: BaseException) -> str | None:
    """What of the machine was exhausted when this was raised, anywhere, in a line; None for something else."""
    match error:
        case MemoryError():
            return NO_MEMORY
        case OSError():
            name = f"{error.filename}: " if isinstance(error.filename, str) else ""
            return name + (error.strerror or str(error) or type(error).__name__)
        case RuntimeError() if "can't start new thread" in str(error):
            return "no thread can be started; try --jobs 1"
        case ImportError() if LIBRARY_NOT_LOADED.search(str(error)):
            return f"a library cannot be loaded, perhaps for want of memory: {' '.join(str(error).split())}"
        case _:
            is_opencv = str(type(error)) == "<class 'cv2.error'>"
            return NO_MEMORY if is_opencv and getattr(error, "code", 0) == CV_NO_MEMORY else None
