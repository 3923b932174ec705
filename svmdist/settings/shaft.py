"""Settings of finding a shaft, its edges and its end, and fitting its pose."""

from __future__ import annotations

from pydantic import Field

from svmdist.settings.base import MethodSettings


class ShaftSettings(MethodSettings):
    """What is assumed in finding a shaft, its edges and its end, and fitting its pose."""

    view_border_fraction: float = Field(default=0.006, ge=0.0, lt=0.1)
    """The outermost part of the field of view that is left out, over the image's width: optics fade there."""
    glare_width_fraction: float = Field(default=0.03, ge=0.0, lt=0.2)
    """Bright stripes on the shaft up to this fraction of the image's width are reflections, and are closed."""
    speck_width_fraction: float = Field(default=0.008, ge=0.0, lt=0.2)
    """Dark lines up to this fraction of the image's width are vessels or gaps, and are opened."""
    min_side_px: float = Field(default=6.0, gt=1.0)
    """The shortest piece of a contour that counts as a side of the shaft: the least that a line can be fitted to."""
    max_taper_rad: float = Field(default=0.6, gt=0.0, lt=1.5)
    """Between the two sides. A cylinder that points at the camera more than this has no contour lines to measure."""
    max_printed_fraction: float = Field(default=0.1, gt=0.0, lt=1.0)
    """Bright part of a dark stub above which it is the print of a tag: half of a tag's cells are white, of a shaft
    few pixels."""

    edge_reach_fraction: float = Field(default=0.007, gt=0.0, lt=0.1)
    """How far sub-pixel edges are searched from the mask's contour, over the image's width."""
    min_edge_reach_px: float = Field(default=4.0, gt=1.0)
    """The least of that reach: a threshold cuts an edge of usual blur within this."""
    min_contrast_levels: float = Field(default=18.0, gt=0.0, lt=255.0)
    """Levels of 255 between shaft and background: less is a shadow."""
    side_trim_fraction: float = Field(default=0.06, ge=0.0, lt=0.5)
    """Of a side at each of its ends: the corners of the shaft's end and of the picture's border round it."""
    slope_sigma_px: float = Field(default=1.2, gt=0.3)
    """Scale of the derivative of Gaussian: as wide as usual optics blur, so that noise is averaged but not shape."""
    slope_sigma_per_blur: float = Field(default=0.8, ge=0.0)
    """A blurred edge is sought at this scale over its own: moved images have ramps, whose steepest point is
    anywhere."""
    blur_reach_fraction: float = Field(default=0.022, gt=0.0, lt=0.2)
    """How far the blur of an edge is measured, over the image's width: a tool at 200 mm/s moves so far in 1/60 s."""
    penumbra_ratio: float = Field(default=1.6, ge=1.0)
    """Blur of one edge over that of the other, beyond which it is the soft border of a shadow beside the shaft: both
    edges of a shaft are equally far from the camera, and move alike."""
    penumbra_blur_px: float = Field(default=1.0, ge=0.0)
    """Blur that any edge may have, px: below it the ratio of two blurs is noise."""
    point_correlation_px: float = Field(default=2.0, gt=0.0)
    """Neighbouring edge points share pixels: points closer than this along the edge err alike."""
    min_point_std_px: float = Field(default=0.05, gt=0.0)
    """The pixel grid and interpolation leave this much of an edge point's error even without noise."""
    line_inlier_px: float = Field(default=0.5, gt=0.0)
    """How far a point of an edge may lie off its line: ten times the least deviation of a point."""
    line_inlier_per_blur: float = Field(default=0.2, ge=0.0)
    """How that grows with the edge's blur: shading over twice the width shifts the steepest point by more."""
    line_inlier_per_width: float = Field(default=0.012, ge=0.0)
    """The same over the shaft's width, for edges of a silhouette: near ones are less sharp, and lenses bend them."""
    shading_std_px: float = Field(default=0.08, ge=0.0)
    """What shading beside an edge shifts it, in addition to noise: see the error budget."""
    shading_std_per_blur: float = Field(default=0.05, ge=0.0)
    """How that grows with the edge's blur, for the same reason."""
    outline_shading_std_px: float = Field(default=0.15, ge=0.0)
    """The same where nothing is known of the light: a limb that fades or shines may shift either edge, as sharpening in
    a camera does."""
    end_strip_fraction: float = Field(default=0.25, gt=0.0, le=1.0)
    """The shaft's end is searched in this part of its half width about the middle, where its arc has its apex."""
    end_reach_half_widths: float = Field(default=0.9, gt=0.0)
    """How far along the shaft its end is searched: an arc's apex lies up to one half width before the corners."""
    min_end_std_px: float = Field(default=0.3, gt=0.0)
    """The least deviation of the shaft's end: a few points across a rounded end share their error."""

    end_model_std_m: float = Field(default=0.0002, ge=0.0, lt=0.1)
    """A bevel, and glare on it, hide where exactly the dark part ends."""
    outline_end_std_radii: float = Field(default=0.25, ge=0.0)
    """How far from where the profile says it the outline stops being a cylinder's, over the shaft's radius: clevises
    differ, and a bent wrist hides their ends."""
    unknown_outline_end_std_radii: float = Field(default=0.45, ge=0.0)
    """The same where the profile does not say it: on two real instruments it was 0 and 0.9 radii before the
    hinge, half of that from the middle."""
    jaw_tip_std: float = Field(default=0.35, gt=0.0)
    """How far the tip of an outline is from where closed, straight jaws would end, over their length: they open and
    turn against the wrist."""
    unknown_bend_rad: float = Field(default=0.8, gt=0.0, lt=3.2)
    """Standard deviation of the wrist's bend about each axis, where no joints tell it: any bend within its usual limits
    of 1.4 rad is as likely as another."""
    gate_chi2: float = Field(default=12.0, gt=0.0)
    """Squared deviation, in units of the variance, that one in 400 true measurements of two numbers exceeds."""
    doubt_square: float = Field(default=2.25, ge=0.0)
    """Squared deviation of the marker's size from what the depth by the shaft makes it, beyond which their difference
    is stated as uncertainty: at 1.5 deviations it begins to be more than chance."""
    max_position_std_m: float = Field(default=0.008, gt=0.0, lt=1.0)
    """A position less certain than this along any direction is no measurement: a shaft whose radius is known to 2 %
    leaves 2 mm of depth, one that is seen as a stub twice that."""
    near_m: float = Field(default=0.2, gt=0.0, lt=10.0)
    """Up to this distance from the camera that deviation holds; beyond, it grows in proportion: a radius known to 2 %
    leaves 2 % of the distance."""
