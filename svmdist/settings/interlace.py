"""Settings of mending interlaced images."""

from __future__ import annotations

from pydantic import Field

from svmdist.settings.base import MethodSettings


class InterlaceSettings(MethodSettings):
    """When rows show two instants, and which of them is kept: the first field, whose instant the stamp tells."""

    comb_levels: float = Field(default=14.0, gt=0.0)
    """Levels by which a row stands out from both of its neighbours where motion combs it: several deviations of a
    sensor's noise."""
    comb_ratio: float = Field(default=3.0, gt=1.0)
    """Combed pixels over those that stand out from the same field's rows, two rows off: fine texture does both."""
    block_px: int = Field(default=9, ge=3, le=101)
    """Side of the blocks in which these are counted, at 640 columns: smaller than an instrument's tip."""
    min_fraction: float = Field(default=0.12, gt=0.0, le=1.0)
    """Of a block's pixels that are combed, where its odd rows are mended."""
    colour_delay_std_s: float = Field(default=0.008, ge=0.0)
    """How late colours may be against brightness in an interlaced image: 4:2:0 mixes those of both fields, 1/60 s or
    1/50 s apart."""
    min_pixels: int = Field(default=60, ge=1)
    """Combed pixels in a whole image, at 640 columns, below which nothing is looked at further."""
