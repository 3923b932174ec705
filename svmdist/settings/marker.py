"""Settings of finding the static virtual marker again by its features."""

from __future__ import annotations

from pydantic import Field

from svmdist.settings.base import MethodSettings


class MarkerSettings(MethodSettings):
    """What is assumed in fitting and judging the homography of the static virtual marker."""

    refit_thresholds_px: tuple[float, ...] = (1.5, 1.0, 0.7, 0.5, 0.3)
    """Matches within these thresholds, one after the other, are fitted again by least squares. A keypoint of ORB's
    coarse pyramid levels is off by up to a pixel and more and is an inlier all the same; the fine ones agree to a
    fraction of a pixel and should decide."""
    refit_min_count: int = Field(default=20, ge=8)
    """Fewer matches than this are not fitted again: five times the four that determine a homography."""
    max_area_ratio: float = Field(default=4.0, gt=1.0)
    """A homography that makes the marker's square this many times as large or as small comes from wrong matches: the
    marker is pasted without scaling."""
