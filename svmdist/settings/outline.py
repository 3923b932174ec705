"""Settings of finding a region in a mask, and of completing the tissue's outline where an instrument hides it."""

from __future__ import annotations

from pydantic import Field

from svmdist.settings.base import MethodSettings


class OutlineSettings(MethodSettings):
    """What is assumed in finding a region, and in completing the tissue's outline where an instrument hides it."""

    speck_fraction: float = Field(default=0.02, ge=0.0, lt=1.0)
    """A connected part below this fraction of the largest one is no part of the region: such specks of colour
    elsewhere would pull the convex hull across the image."""
    blood_fraction: float = Field(default=0.1, ge=0.0, lt=1.0)
    """Parts below this fraction of the tissue may be blood on an instrument, as red as tissue."""
    blood_ring_fraction: float = Field(default=0.5, gt=0.0, le=1.0)
    """Of what surrounds such a part, the share of dark shaft above which it is blood, where tissue is placed in 3D: a
    part of the tissue that a shaft cuts off has the shaft on one side."""

    sample_step_px: float = Field(default=2.0, gt=0.0)
    """Distance of the hull's samples; whole pixels tell no finer ones apart."""
    max_sample_count: int = Field(default=480, ge=30)
    """Upper bound of the samples of one hull: longer hulls are sampled at a larger step."""
    gap_reach_px: float = Field(default=2.0, ge=1.0, le=20.0)
    """A sample of the hull further than this from any visible pixel bridges a gap."""
    straight_length_per_root_px: float = Field(default=4.5, gt=0.0)
    """Length of the stretches that are tested for straightness, over the square root of the object's radius, both in
    px. A chord of c √R over a circle of radius R is c² / 8 = 2.5 px off its middle, whatever the radius. This tells it
    from a straight edge, which rounding to whole pixels leaves within one."""
    straight_within_px: float = Field(default=0.8, gt=0.0)
    """A stretch that stays this close to its chord is straight: it is flatter than a circle of three times the
    radius, so that the edge is the instrument's and not the object's."""
    shoulder_samples: int = Field(default=4, ge=0)
    """This many samples on both sides of a hidden one are dropped too, because the corners of the cut lie there."""

    harmonics: int = Field(default=6, ge=2, le=12)
    """Number of harmonics of the Fourier series r(θ)."""
    irregularity: float = Field(default=0.2, gt=0.0, lt=1.0)
    """Standard deviation of the second harmonic over the radius: 0.2 is an ellipse of 3:2, as outlines of organs have
    it. The k-th falls as 1 / k³, so that the harmonics of the curvature, k² times as large, fall too."""
    min_visible_fraction: float = Field(default=0.25, gt=0.0, le=1.0)
    """With less of the outline than this the prior alone would shape the curve; the hull is used as it is."""
    hidden_std: float = Field(default=0.3, gt=0.0)
    """Standard deviation of the hull's centroid over the radius where the hull is used as it is. The hidden part may
    lie anywhere within the hull's own size."""
    max_iterations: int = Field(default=8, ge=1)
    """Upper bound of the moves of the centre; one to three suffice on the golden logs."""

    correlation_samples: float = Field(default=3.0, ge=1.0)
    """Number of neighbouring samples, 2 px apart, with a common error: the steps of a border in whole pixels reach as
    far."""
    mask_std_px: float = Field(default=0.3, gt=0.0)
    """Standard deviation of a mask's border: that of rounding to whole pixels, 1 / √12."""
    border_std_px: float = Field(default=0.3, ge=0.0)
    """Standard deviation of an error that is common to a whole side. A threshold cuts a blurred border, two pixels
    wide, anywhere in its middle half: up to half a pixel outside or inside. One side is lit alike, and differs alike
    from what is behind it."""
    outside_deviations: float = Field(default=3.0, gt=0.0)
    """Samples this many standard deviations outside the curve lose weight."""
    inside_deviations: float = Field(default=2.0, gt=0.0)
    """Samples this many standard deviations inside the curve lose weight. It is less than outside, because what covers
    an object can only cut its outline short."""
