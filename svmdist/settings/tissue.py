"""Settings of placing the tissue and remembering it."""

from __future__ import annotations

from svmdist.settings.base import MethodSettings


class TissueTrackingSettings(MethodSettings):
    """What is assumed in placing the tissue and remembering it."""
