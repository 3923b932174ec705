"""Settings of detecting a fiducial tag and refining its pose."""

from __future__ import annotations

from svmdist.settings.base import MethodSettings


class TagSettings(MethodSettings):
    """What is assumed in detecting a fiducial tag and refining its pose."""
