"""Settings of telling several instruments apart."""

from __future__ import annotations

from pydantic import Field

from svmdist.settings.base import MethodSettings


class AssociationSettings(MethodSettings):
    """How coloured regions and dark shafts are given to instruments; widths are those of the image."""

    placed_fraction: float = Field(default=0.05, gt=0.0, lt=1.0)
    """Of the width: where a hidden region's expected place is less certain than this, no shaft is assigned by it."""
    min_depth_m: float = Field(default=0.02, gt=0.0)
    """A tool's nominal depth is taken to be at least this, since its pixel diverges towards the camera."""
    gate_d2: float = Field(default=18.4, gt=0.0)
    """Squared Mahalanobis distance in two dimensions that a right region exceeds once in 10,000."""
    miss_cost: float = Field(default=3.0, ge=0.0)
    """-log of the chance that an instrument shows no region: it is hidden or outside one frame in twenty."""
    clutter_count: float = Field(default=0.05, gt=0.0)
    """Regions of nothing that an image of any size has, on average."""
    margin: float = Field(default=2.0, ge=0.0)
    """A newcomer is named when no other naming is more than e^-2 times as likely."""
    contest: float = Field(default=4.6, ge=0.0)
    """Two tracks contest a region that is less than a hundred times (e^4.6) as likely one's as the other's."""
    uncertain_fraction: float = Field(default=0.08, gt=0.0, lt=1.0)
    """Of the width: a prediction less certain than this identifies nothing any more."""
    merged_area: float = Field(default=1.4, gt=1.0)
    """A region this much larger than its instrument's is two that touch."""
    max_regions: int = Field(default=6, ge=1, le=8)
    """The largest regions that are considered; the assignments grow with their number to the power of the tracks."""
    spread_fraction: float = Field(default=0.2, ge=0.0)
    """A region's centroid strays from the instrument's by so much of its radius: shading, jaws before it."""
    min_std_px: float = Field(default=1.0, gt=0.0)
    """Standard deviation of a centroid at least, by segmentation."""
    acceleration_widths: float = Field(default=0.8, gt=0.0)
    """Standard deviation of an instrument's acceleration, in widths per s²: a brisk turn of the wrist."""
    first_speed_widths: float = Field(default=0.6, gt=0.0)
    """Standard deviation of the speed of what was detected once, in widths per s."""
    linear_std: float = Field(default=0.4, gt=0.0)
    """How much the seen motion differs from the nominal one, over it: the nominal depth is off by as much."""
    drift_widths: float = Field(default=0.01, gt=0.0)
    """How the offset between seen and nominal place drifts, in widths per square root of s."""
    linear_drift: float = Field(default=0.05, gt=0.0)
    """How the relation of seen and nominal motion drifts, as the depth changes, per square root of s."""
    ray_count: int = Field(default=12, ge=2)
    """Points along a shaft's expected axis at which the image is asked whether it is dark."""
    ray_span: tuple[float, float] = (1.25, 2.2)
    """Where along the axis they lie, over the distance from the region to the shaft's end."""
    likely_dark: float = Field(default=0.85, gt=0.0, lt=1.0)
    """How much of the line where its shaft should be is dark, for the right instrument."""
    unlikely_dark: float = Field(default=0.3, gt=0.0, lt=1.0)
    """The same for another instrument."""
    min_ray_fraction: float = Field(default=0.4, gt=0.0, le=1.0)
    """A line of which less is inside the picture tells nothing."""
    shaft_reach: float = Field(default=2.5, gt=0.0)
    """A dark pixel farther from an axis than so many radii is not that shaft's."""
    grown_px: int = Field(default=5, ge=1)
    """The other instruments' masks are dilated by a square of this side, since borders differ between detectors."""
    fragment_reach: float = Field(default=2.5, gt=0.0)
    """Coloured fragments within so many radii of an instrument's region belong to it: what hides it cuts them off."""

    side_std: float = Field(default=0.25, gt=0.0)
    """How far from the middle of its side an instrument comes in that was not seen before, over the image's size."""
    entry_std: float = Field(default=0.04, gt=0.0)
    """How far from where it was it comes in at the next moment: the outline is found a little longer or wider."""
    entry_speed: float = Field(default=0.05, gt=0.0)
    """How that grows, per s: a trocar holds the instrument, and the camera moves slowly."""
    end_std: float = Field(default=0.06, gt=0.0)
    """The same for the shaft's end."""
    end_speed: float = Field(default=0.3, gt=0.0)
    """The same for the shaft's end, per s, as instruments move."""
    unseen_cost: float = Field(default=6.0, ge=0.0)
    """-log of the chance that an instrument is not seen although it is there, or is not there."""
    unnamed_cost: float = Field(default=6.0, ge=0.0)
    """-log of the chance that what is seen as an instrument is none of those in the profile."""
