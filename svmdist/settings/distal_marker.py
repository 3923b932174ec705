"""Settings of measuring the coloured distal marker about the tool's origin."""

from __future__ import annotations

from pydantic import Field

from svmdist.settings.base import MethodSettings


class DistalMarkerSettings(MethodSettings):
    """What is assumed in measuring the coloured distal marker about the tool's origin.

    The marker is a sphere of the profile's `knuckle_radius_m`; jaws and fork hide parts of it.
    """

    min_saturation: float = Field(default=50.0, ge=0.0, le=255.0)
    """Median saturation, of 255, below which the region is bare steel: grey steel in coloured light stays below."""
    min_chroma: float = Field(default=25.0, ge=0.0, le=255.0)
    """Levels of chroma between inside and outside of the border below which there is no border to find."""
    min_agreeing_fraction: float = Field(default=0.5, gt=0.0, le=1.0)
    """Of all rays, those that agree on the border's circle: with less of the border the circle is a guess."""
    max_log_ratio: float = Field(default=0.25, gt=0.0)
    """Between the circle's radius and that of the region's area: further apart they are not of the same thing."""
    visible_radius: float = Field(default=0.97, gt=0.5, le=1.5)
    """The apparent radius over that of the whole sphere: jaws and fork hide some percent of it, and its limb is in
    shade. Over 72 frames of six seeds 0.96 ± 0.02, sharp, blurred, hazy or dim."""
    radius_std: float = Field(default=0.04, gt=0.0, lt=1.0)
    """How that ratio varies, over the radius: 0.02 in the same frames, twice that under light from the endoscope's tip,
    which leaves the limb dark, and with blood on it."""
    border_points: float = Field(default=8.0, ge=1.0)
    """Points of the border that err independently: it is cut by fork and jaws, each over an eighth."""
    border_std_per_blur: float = Field(default=0.1, ge=0.0)
    """What neighbours of other colours within the border's blur shift it, over that blur."""
    centroid_std: float = Field(default=0.045, gt=0.0)
    """By how much hidden parts move the region's centroid, over the radius."""

    visible_middle: float = Field(default=0.05, ge=0.0)
    """The visible middle stands off the true one: over the radius, along each axis of the tool, of which it is a
    fixed point. Jaws and fork hide 6 % of the disc (`visible_radius`); all of it on one side, as with blood
    on it, would move the middle by 0.05."""
    shading_bias: float = Field(default=0.12, ge=0.0)
    """The limb that is turned from the light is dark, and draws the visible middle to the lit side: over the radius
    and the angle between light and view. By Lambert's law it is √(1 - ρ²) where the limb in shade alone ends the disc
    at ρ of its radius, 0.24 for 0.97; none where jaws and fork end it, or the light is at the camera: half of it."""
    centre_noise: float = Field(default=0.02, gt=0.0)
    """What is left of the centroid's error then, over the radius: pixels, shading, the view's own angle."""
    unknown_shape_std_px: float = Field(default=4.0, gt=0.0)
    """The centroid of a coloured part of unknown shape against the tool's origin: a third of the marker's radius, as
    where blood covers a side of it."""
    min_visible_fraction: float = Field(default=0.4, ge=0.0, le=1.0)
    """Of a whole marker's area: with less of it visible its centroid cannot be used."""
    whole_area_spread: float = Field(default=0.1, ge=0.0)
    """By how much a whole marker's area differs from its disc's: jaws that hide some, a fork that adds."""
    min_relative_depth_std: float = Field(default=0.01, gt=0.0)
    """Depth's deviation over depth: where depth is known this well, the marker's size adds nothing to it."""
