"""PyAV, which decodes and writes videos: loaded where it is needed, and told how to install where it is missing."""

from __future__ import annotations

from typing import Any

from svmdist.errors import SvmdistError


def import_av(error: type[SvmdistError], what: str) -> Any:
    """The module av; raises `error`, which says that `what` needs it, where it is not installed."""
    try:
        import av
    except ImportError:
        raise error(
            f"{what} needs the package av, which is not installed: pip install 'svmdist[video]'"
        ) from None
    av.logging.set_level(av.logging.PANIC)  # errors are told once, by this program
    return av
