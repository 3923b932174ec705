"""Settings of the method `fused`: how it takes detections as measurements of its filter."""

from __future__ import annotations

from pydantic import Field

from svmdist.settings.base import MethodSettings


class FusedSettings(MethodSettings):
    """What of a detection's error is noise, and what lasts."""

    depth_known_fraction: float = Field(default=0.05, gt=0.0)
    """Standard deviation of depth over depth below which the predicted depth tells how large the whole marker is."""
    lasting_share: float = Field(default=0.5, ge=0.0, lt=1.0)
    """Share of a tag's and of an edge's variance that lasts from frame to frame: how a tag's edges fall on the
    pixels changes with motion, shading shifts an edge for as long as the light falls on it so."""
