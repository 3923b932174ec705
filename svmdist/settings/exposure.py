"""Settings of normalising an image's exposure."""

from __future__ import annotations

from svmdist.settings.base import MethodSettings


class ExposureSettings(MethodSettings):
    """What is assumed in normalising an image's exposure."""
