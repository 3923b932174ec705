"""Settings of telling several instruments apart."""

from __future__ import annotations

from svmdist.settings.base import MethodSettings


class AssociationSettings(MethodSettings):
    """What is assumed in telling several instruments apart."""
