"""Settings of finding a shaft, its edges and its end, and fitting its pose."""

from __future__ import annotations

from svmdist.settings.base import MethodSettings


class ShaftSettings(MethodSettings):
    """What is assumed in finding a shaft, its edges and its end, and fitting its pose."""
