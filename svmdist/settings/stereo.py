"""Settings of matching the two views of a stereo pair."""

from __future__ import annotations

from svmdist.settings.base import MethodSettings


class StereoSettings(MethodSettings):
    """What is assumed in matching the two views of a stereo pair."""
