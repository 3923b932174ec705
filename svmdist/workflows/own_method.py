"""A user's own method beside svmdist's: one function, a frame to a result."""

from __future__ import annotations

import copy
from typing import Protocol, runtime_checkable

from svmdist.estimation.frame import Frame, Needs
from svmdist.results import FrameResult


@runtime_checkable
class OwnMethod(Protocol):
    """Anything with `estimate(frame)`. A `name` is shown in results; the class's name stands in for it."""

    def estimate(self, frame: Frame) -> FrameResult:
        """Measure one frame; one that cannot be measured is a result with a status that says why."""


class OwnEstimator:
    """An own method as the replay takes it: each instrument has a copy, and frames come in the order of the log."""

    keeps_state = True
    needs = Needs(right_view=True)

    def __init__(self, method: OwnMethod) -> None:
        self.name = name_of(method)
        self._method = copy.deepcopy(method)

    def estimate(self, frame: Frame) -> FrameResult:
        """Measure one frame; raises TypeError for what is no result."""
        result = self._method.estimate(frame)
        if not isinstance(result, FrameResult):
            raise TypeError(
                f"{self.name}.estimate(frame): expected a FrameResult, found {type(result).__name__}"
            )
        return result


def name_of(method: OwnMethod) -> str:
    """What an own method is called in results."""
    return str(getattr(method, "name", type(method).__name__))
