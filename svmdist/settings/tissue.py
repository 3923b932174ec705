"""Settings of placing the tissue and remembering it."""

from __future__ import annotations

from pydantic import Field

from svmdist.settings.base import MethodSettings


class TissueTrackingSettings(MethodSettings):
    """How the tissue's pose is averaged over frames, and when it counts as moved."""

    moved_count: int = Field(default=5, ge=1)
    """So many poses in a row away from the remembered one mean that the tissue has moved: one or two are wild."""
    min_scatter_count: float = Field(default=4.0, ge=2.0)
    """Fewer poses do not tell how much they scatter beyond their stated covariance."""
    memory_count: float = Field(default=15.0, gt=1.0)
    """Poses older than as many fade (by 1/15 a frame), so that tissue that creeps or breathes is followed."""
    shape_count: int = Field(default=8, ge=1)
    """So many views of the dome's shape are taken first, then one in as many frames: all of them err nearly alike."""
    gate_z: float = Field(default=3.09, gt=0.0)
    """Normal quantile of the gate for a pose against the remembered one: 1 in 1,000 true ones is refused."""
    lasting_height_share: float = Field(default=0.98, ge=0.0, lt=1.0)
    """Part of a stereo surface's deviation by which all of it is off for as long as it shows the same texture. Of six
    logs with wet, breathing tissue in light from the endoscope's tip, heights scatter by 0.10 to 0.20 of the stated
    deviation from frame to frame: a share of 0.98 leaves 0.20."""
    height_correlation_time_s: float = Field(default=30.0, gt=0.0)
    """How long that lasts: longer than the logs of 8 s that it was seen in."""
