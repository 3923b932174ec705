"""Settings of finding an instrument's shaft by its silhouette: two straight sides, their end, and the wrist beyond."""

from __future__ import annotations

from pydantic import Field

from svmdist.settings.base import MethodSettings


class SilhouetteSettings(MethodSettings):
    """What is assumed in finding shaft and wrist in the outline of a whole instrument, whatever its colours.

    The outline is rough: sides are sought in it, and then in the image's own gradients.
    """

    min_side_per_width: float = Field(default=0.5, ge=0.0)
    """The shorter side over the shaft's width: less of it does not tell where it points."""
    max_taper_rad: float = Field(default=0.6, gt=0.0, lt=1.5)
    """Between both sides: a cylinder that points at the camera more than this shows no length to measure."""

    edge_reach_fraction: float = Field(default=0.012, gt=0.0, lt=0.1)
    """How far from a rough side the image's edge is searched, over the image's width."""
    edge_reach_widths: float = Field(default=0.3, ge=0.0)
    """The same over the shaft's width, where that is more: jaws and ears lead a rough side astray."""
    edge_turn_widths: float = Field(default=0.35, ge=0.0)
    """How far the edge's ends may be off in opposite directions beside that, over the shaft's width."""
    search_scale_widths: float = Field(default=0.04, ge=0.0)
    """Scale of the slope that is sought first, over the shaft's width: texture of tissue is finer."""
    texture_factor: float = Field(default=1.5, ge=0.0)
    """A slope of so many times the neighbourhood's median counts half as much as the largest one."""
    full_contrast_levels: float = Field(default=16.0, gt=0.0)
    """A step of so many levels of 255 across a side counts half as much as the largest one: edges are told by their
    straightness, not by their strength."""
    min_contrast_levels: float = Field(default=12.0, gt=0.0, lt=255.0)
    """The least step of colour at a point of an edge, levels of 255: compression leaves less."""
    min_found: float = Field(default=0.7, gt=0.0, le=1.0)
    """Of the profiles across an edge that show one, how many must show it on the line: of texture most do beside it."""
    min_seen: float = Field(default=0.3, gt=0.0, le=1.0)
    """Of all profiles across an edge, how many must show it: a dark shaft before dark tissue has none for a while."""
    min_support: float = Field(default=0.4, gt=0.0, lt=1.0)
    """Response below which there is no edge of an instrument: one goes on for as long as it has more on average."""
    straight_px: float = Field(default=0.6, gt=0.0)
    """How far an edge's point may lie off the shaft's line: the wrist goes on beside it a pixel or two off."""
    straight_widths: float = Field(default=0.02, ge=0.0)
    """The same over the shaft's width, where that is more."""
    end_share: float = Field(default=0.6, gt=0.0, lt=1.0)
    """The cylinder ends where less than this part of the points beyond lie on its line."""
    end_reach_widths: float = Field(default=2.0, gt=0.0)
    """How far beyond a rough side its continuation is followed, over the shaft's width."""
    ends_agree_widths: float = Field(default=0.3, ge=0.0)
    """Both edges' ends are this close along the shaft, over its width, where both are seen: clevises are lopsided."""
    min_end_std_widths: float = Field(default=0.08, gt=0.0)
    """The least deviation of the cylinder's end, over the shaft's width: ears and bevels hide it."""

    wrist_reach: float = Field(default=1.25, gt=0.0)
    """How far beyond the cylinder's end wrist and jaws may reach, over their length when straight: they may come
    towards the camera."""
    wrist_std: float = Field(default=0.12, gt=0.0)
    """The tool's origin in the outline beyond the cylinder's end, over the length of that: jaws open and turn."""
    min_wrist_widths: float = Field(default=0.5, gt=0.0)
    """An outline that ends closer than this behind the cylinder's end, over its width, shows no wrist."""
    min_wrist_share: float = Field(default=0.5, ge=0.0, le=1.0)
    """The same over the length of a straight wrist with closed jaws: less of it is another tip than the profile's, a
    wrist that points at the camera by more than 60°, or one of which most is missed."""
    flank_stds: float = Field(default=4.0, gt=0.0)
    """What is this far, in their own scatter, from the colours on both sides of a wrist is wrist: one pixel of paper in
    a thousand is so far, and specks do not count."""
    flank_light_levels: float = Field(default=8.0, gt=0.0)
    """The least scatter of lightness, levels of 255: light falls off over a wrist's length."""
    flank_colour_levels: float = Field(default=3.0, gt=0.0)
    """The least scatter of Lab's a and b: compression leaves as much."""
    max_flank_outliers: float = Field(default=0.05, ge=0.0, lt=1.0)
    """Part of a flank that may differ from its own colour so far: with more of it, fat or vessels lie beside the wrist,
    and only what the segmentation knows is taken for it."""
