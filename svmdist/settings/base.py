"""The base of settings: what a detector or an estimator may assume, frozen, checked, and open to a profile."""

from __future__ import annotations

from svmdist.toml_model import StrictModel


class MethodSettings(StrictModel):
    """A table `[settings.NAME]` of a profile.

    The name of every field says its unit; the docstring below it its meaning, and where the default is from.
    """
