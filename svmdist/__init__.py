"""svmdist: the distance between a surgical instrument and tissue, estimated from recorded logs.

    import svmdist

    recording = svmdist.open_recording("recordings/sweep.mcap")
    estimates = svmdist.estimate(recording, method="overlay")
    table = estimates.to_dataframe()

The functions are those of `svmdist.api`, imported on first use.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from svmdist import errors

if TYPE_CHECKING:
    from svmdist.api import Estimates, compare, estimate, open_recording, surface, validate
    from svmdist.estimation.alarms import AlarmRules
    from svmdist.profile import Profile
    from svmdist.samples import bgr_image
    from svmdist.workflows.request import prepare

    __version__: str

__all__ = ["AlarmRules", "Estimates", "Profile", "__version__", "bgr_image", "compare", "errors"]
__all__ += ["estimate", "open_recording", "prepare", "surface", "validate"]


def __getattr__(name: str) -> Any:
    """Import the interface on first use: the command line starts without it."""
    if name == "__version__":
        from importlib.metadata import version

        return version("svmdist")
    if name in __all__:
        from importlib import import_module

        return getattr(import_module("svmdist.api"), name)
    raise AttributeError(f"module 'svmdist' has no attribute {name!r}; it has {', '.join(__all__)}")


def __dir__() -> list[str]:
    """The names of the interface."""
    return sorted(__all__)
