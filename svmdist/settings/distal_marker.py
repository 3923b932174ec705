"""Settings of measuring the coloured distal marker about the tool's origin."""

from __future__ import annotations

from svmdist.settings.base import MethodSettings


class DistalMarkerSettings(MethodSettings):
    """What is assumed in measuring the coloured distal marker about the tool's origin."""
