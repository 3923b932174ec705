"""The base of settings: what a detector or an estimator may assume, frozen, checked, and open to a profile."""

from __future__ import annotations

from svmdist.toml_model import StrictModel


class MethodSettings(StrictModel):
    """A table `[settings.NAME]` of a profile; every field says its unit, its meaning and where its default is from."""
