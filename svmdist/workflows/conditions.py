"""Conditions under which a log is replayed: as recorded, images degraded or blurred, or in a perturbed world."""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Protocol

import numpy as np

from svmdist.perturbations.chosen import Perturbations, require_at_replay
from svmdist.samples import Image, Observation

if TYPE_CHECKING:  # images as recorded need neither
    from svmdist.vision.degradations import Blur, Degradation

REPLAY_SEED = 36
LEFT, RIGHT = 0, 1


class ReplayCondition(Protocol):
    """What is done to the images of a log before they are measured."""

    def apply(self, observation: Observation, frame: int, /) -> Observation:
        """Change the images of the n-th frame, the right one too."""


@dataclass(frozen=True, slots=True)
class Condition:
    """A degradation of a severity of 1 to 5, or nothing; raises UsageError for a wrong name or severity."""

    name: Degradation | None = None
    severity: int = 0

    def __post_init__(self) -> None:
        if self.name is not None:
            from svmdist.vision.degradations import require_degradation

            require_degradation(self.name, self.severity)

    def __str__(self) -> str:
        return "" if self.name is None else f"{self.name}={self.severity}"

    def apply(self, observation: Observation, frame: int) -> Observation:
        """Degrade the images of the n-th frame: the same frame of the same log always alike."""
        name, severity = self.name, self.severity
        if name is None:
            return observation
        from svmdist.vision.degradations import Degradation, degrade, image_seed

        # The image itself tells logs apart, whatever their names and order. The severity plays no part: glints
        # and plumes of one are those of the next, only more of them.
        content = zlib.crc32(np.ascontiguousarray(observation.image_bgr).data)
        path = (REPLAY_SEED, list(Degradation).index(name), frame, content)
        return _changed(
            observation, lambda image, side: degrade(image, name, severity, image_seed(name, side, *path))
        )


CLEAN = Condition()


@dataclass(frozen=True, slots=True)
class PerturbedCondition:
    """A world that is not as log and profile say; raises UsageError for what cannot be done to a recorded log."""

    perturbations: Perturbations

    def __post_init__(self) -> None:
        require_at_replay(self.perturbations)

    def __str__(self) -> str:
        return str(self.perturbations)

    def apply(self, observation: Observation, _frame: int) -> Observation:
        """Change the images; joints and calibration are those of `Recording.perturbed`."""
        from svmdist.perturbations.images import perturbed_image, perturbed_right_view

        image, right = observation.image_bgr, observation.right
        return replace(
            observation,
            image_bgr=perturbed_image(image, self.perturbations),
            right=None if right is None else perturbed_right_view(right, self.perturbations),
        )


LogCondition = Condition | PerturbedCondition
"""What a log can be compared under."""


@dataclass(frozen=True, slots=True)
class BlurCondition:
    """One of the paper's blurs with a kernel in px."""

    blur: Blur
    kernel_px: int

    def apply(self, observation: Observation, _frame: int) -> Observation:
        """Blur the images."""
        from svmdist.vision.degradations import apply_blur

        return _changed(observation, lambda image, _: apply_blur(image, self.blur, self.kernel_px))


def _changed(observation: Observation, change: Callable[[Image, int], Image]) -> Observation:
    right = observation.right
    if right is not None:
        right = replace(right, image_bgr=change(right.image_bgr, RIGHT))
    return replace(observation, image_bgr=change(observation.image_bgr, LEFT), right=right)
