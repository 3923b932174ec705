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
    memory_count: float = Field(default=50.0, gt=1.0)
    """Poses older than as many fade (by 1/50 a frame), so that tissue that creeps is followed."""
    shape_count: int = Field(default=8, ge=1)
    """So many views of the dome's shape are taken first, then one in as many frames: all of them err nearly alike."""
    gate_z: float = Field(default=3.09, gt=0.0)
    """Normal quantile of the gate for a pose against the remembered one: 1 in 1,000 true ones is refused."""
