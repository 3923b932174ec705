"""`svmdist profile new`: make a profile from a log."""

from __future__ import annotations

import tomllib
from pathlib import Path

from svmdist.cli.options import FORCE, TopicOption, argument, option, output_option
from svmdist.cli.output import LOG, require_new, require_output, write_lines


class NewOptions(TopicOption):
    """What `profile new` takes."""

    file: Path = argument(..., "FILE", "Log to look at.")
    name: str | None = option(None, "--name NAME", "Name of the profile. Default: that of the log.")
    output: Path | None = output_option()
    force: bool = FORCE


def new_command(given: NewOptions) -> None:
    """Write a commented profile from a log.

    It has the log's topics, frames and instruments, a chain that fits its joints, sizes of a da Vinci instrument,
    colours where they are distinct, and the tissue's plane where two views show it. What it cannot know is marked.

    Examples:
      A commented profile, to be completed by hand:
        svmdist profile new log.mcap -o mine.toml
      With a camera's topic that is none of the usual ones:
        svmdist profile new log.mcap --topic image=/left/image_raw
    """
    from svmdist.profile import Profile
    from svmdist.report.profile_template import profile_text
    from svmdist.workflows.new_profile import draft_profile

    require_output(given.output, [given.file])
    require_new(given.output, force=given.force)
    draft = draft_profile(given.file, given.name or given.file.resolve().stem, given.topics)
    text = profile_text(draft)
    Profile.model_validate(tomllib.loads(text))
    write_lines([text], given.output)
    instruments = ", ".join(one.name for one in draft.instruments)
    plane = "the plane from both views" if draft.plane else "measure the plane of the tissue"
    mark = "a distal marker by its colour" if draft.mark else "no colour of its own"
    LOG.info("%s: instruments %s; %s; %s", draft.name, instruments, mark, plane)
