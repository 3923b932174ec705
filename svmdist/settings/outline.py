"""Settings of completing the tissue's outline where an instrument hides it."""

from __future__ import annotations

from svmdist.settings.base import MethodSettings


class OutlineSettings(MethodSettings):
    """What is assumed in completing the tissue's outline where an instrument hides it."""
