"""`--lag` for commands that measure: the clocks of a recording put right, and what was found told."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from svmdist.cli.console import say
from svmdist.cli.progress import progress_bar

if TYPE_CHECKING:
    from svmdist.recording.log import Recording
    from svmdist.workflows.lag import Lag
    from svmdist.workflows.request import Setup


def told_lag(
    recording: Recording, setup: Setup, lag: Lag | None, wanted: Sequence[str] | None, jobs: int | None
) -> Recording:
    """The recording with a lag taken off; says which one `auto` found, or why there is none."""
    if lag is None:
        return recording
    from svmdist.workflows.lag import with_lag
    from svmdist.workflows.parallel import Steps

    with progress_bar(f"lag of {recording.name}", "images") as advance:
        steps = Steps(advance, recording.image_count())
        corrected, found = with_lag(recording, setup.profile, lag, wanted, jobs, on_image=steps.advance)
    if not found.told:
        say(f"svmdist: note: {recording.name}: the lag cannot be told and none is taken off: {found.reason}")
    elif lag == "auto":
        say(
            f"svmdist: note: {recording.name}: lag {found.lag_s * 1e3:+.1f} ms (confidence {found.confidence:.2f})"
        )
    return corrected
