"""What was found in the last images, for whoever asks again for the same one."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from svmdist.samples import Image

RECENT_IMAGES = 2
"""Both views of a stereo pair stay known, so that whoever asks again for the same image does no work again."""
Found = TypeVar("Found")


class RecentImages(Generic[Found]):
    """Remembers what a function makes of the last images, told apart by identity and not by content."""

    def __init__(self, make: Callable[[Image], Found]) -> None:
        self._make = make
        self._known: deque[tuple[Image, Found]] = deque(maxlen=RECENT_IMAGES)

    def of(self, image_bgr: Image) -> Found:
        """What the function makes of an image, shape (h, w, 3)."""
        for image, known in self._known:
            if image is image_bgr:
                return known
        found = self._make(image_bgr)
        self._known.append((image_bgr, found))
        return found
