"""One camera's image as the methods of one instrument see it."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

from svmdist.camera import Camera
from svmdist.samples import Image
from svmdist.vision.frame_context import FrameContext
from svmdist.vision.segmentation.segmenter import InstrumentMasks, Masks


@dataclass(frozen=True)
class View:
    """A camera, its image, and the pixels of other instruments in it.

    `others`, shape (h, w), marks the pixels that have an instrument's colours and belong to another one, or to none
    that is known; None where there is one instrument only.
    """

    camera: Camera
    context: FrameContext
    others: Image | None = None

    @cached_property
    def masks(self) -> Masks:
        """What is what, at normalised exposure, without the other instruments."""
        masks = self.context.masks
        return masks if self.others is None else InstrumentMasks(masks, self.others)

    @cached_property
    def masks_as_recorded(self) -> Masks:
        """The same of the image as it is, for the paper's methods."""
        masks = self.context.masks_as_recorded
        return masks if self.others is None else InstrumentMasks(masks, self.others)
