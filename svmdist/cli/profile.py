"""`svmdist profile`: make a profile from a log."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import Annotated

import typer

from svmdist.cli.command import Command, CommandGroup
from svmdist.cli.console import require_output, say, write_lines
from svmdist.cli.options import OutputOption, TopicOption, topics_of
from svmdist.errors import UsageError

profile_app = typer.Typer(
    cls=CommandGroup,
    help="Make a profile.",
    no_args_is_help=True,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


@profile_app.callback()
def profile_main() -> None:
    """Make a profile."""


@profile_app.command("new", cls=Command)
def new_command(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Log to look at.", show_default=False)],
    name: Annotated[
        str | None,
        typer.Option(
            "--name",
            metavar="NAME",
            help="Name of the profile. Default: that of the log.",
            show_default=False,
        ),
    ] = None,
    topic: TopicOption = None,
    output: OutputOption = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the profile if it exists.")] = False,
) -> None:
    """Write a commented profile from a log.

    It has the log's topics, frames and instruments, a chain that fits its joints, sizes of a da Vinci instrument,
    colours where they are distinct, and the tissue's plane where two views show it. What it cannot know is marked.
    """
    from svmdist.profile import Profile
    from svmdist.report.profile_template import profile_lines
    from svmdist.workflows.new_profile import draft_profile

    require_output(output, [file])
    if output is not None and output.exists() and not force:
        raise UsageError(f"{output}: exists already; give another name, or --force to replace it")
    draft = draft_profile(file, name or file.resolve().stem, topics_of(topic))
    text = "".join(f"{line}\n" for line in profile_lines(draft))
    Profile.model_validate(tomllib.loads(text))
    write_lines([text], output)
    instruments = ", ".join(one.name for one in draft.instruments)
    plane = "the plane from both views" if draft.plane else "measure the plane of the tissue"
    mark = "a distal marker by its colour" if draft.mark else "no colour of its own"
    say(f"svmdist: {draft.name}: instruments {instruments}; {mark}; {plane}")
