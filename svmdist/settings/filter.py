"""Settings of the filter over kinematic errors."""

from __future__ import annotations

from svmdist.settings.base import MethodSettings


class FilterSettings(MethodSettings):
    """What is assumed in the filter over kinematic errors."""
