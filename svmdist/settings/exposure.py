"""Settings of normalising an image's exposure."""

from __future__ import annotations

from pydantic import Field

from svmdist.settings.base import MethodSettings


class ExposureSettings(MethodSettings):
    """When an image counts as dim or veiled, and how far it is corrected; levels are of 255."""

    sampling_px: int = Field(default=4, ge=1, le=64)
    """Levels are counted on every n-th row and column: 19,200 of the pixels of 640x480, enough for a percentile."""
    border_fraction: float = Field(default=0.2, ge=0.0, le=1.0)
    """Of the bright level (the 90th percentile): what is darker may be the black border of an endoscope's picture."""
    black_percentile: float = Field(default=0.5, ge=0.0, le=100.0)
    """The darkest things in view. The stub of a shaft is half a percent of the view."""
    middle_percentile: float = Field(default=50.0, ge=0.0, le=100.0)
    """The middle of the scene, by which automatic exposure goes."""
    dark_level: float = Field(default=45.0, ge=0.0, le=255.0)
    """Level that the darkest things reach without a veil: a dark shaft has 20 to 40."""
    distinct_fraction: float = Field(default=0.7, ge=0.0, le=1.0)
    """Of the median: where the darkest is brighter than this, nothing dark is in view, and a veil cannot be told."""
    fair_level: float = Field(default=110.0, gt=0.0, le=255.0)
    """Where automatic exposure puts the middle of a scene at least; less is dim light."""
    noisy_gain: float = Field(default=1.5, ge=1.0)
    """Dim light comes with shot noise: from this gain on, neighbouring pixels are averaged."""
    noise_sigma_px: float = Field(default=1.0, gt=0.0)
    """Width of that average."""
