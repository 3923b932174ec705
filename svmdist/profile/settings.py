"""What a user may change of detectors and estimators: the tables `[settings.NAME]` of a profile.

The suffix of a name is its unit; what has none is a ratio or a count; levels are of 255.
"""

from __future__ import annotations

import logging
import tomllib
from functools import cache
from pathlib import Path
from typing import Any

from pydantic import Field

from svmdist.profile.toml import Count, Level, NonNegative, Positive, Share, StrictModel

LOG = logging.getLogger(__name__)


@cache
def former_keys() -> dict[str, set[str]]:
    """The keys of older profiles that are no longer settings, by the dotted name of their table."""
    text = Path(__file__).with_name("former_settings.toml").read_text("utf-8")
    return {table: set(keys.split()) for table, keys in tomllib.loads(text).items()}


def without_former_keys(table: dict[str, Any], name: str = "") -> dict[str, Any]:
    """A profile, or its table `name`, without the keys of older profiles; each is named in a warning."""
    kept: dict[str, Any] = {}
    for key, value in table.items():
        inner = f"{name}.{key}" if name else key
        if key in former_keys().get(name, ()):
            LOG.warning("%s is no longer a setting; ignored", inner)
        elif not isinstance(value, dict) or inner.count(".") > 1:  # no former table is deeper
            kept[key] = value
        elif (rest := without_former_keys(value, inner)) or inner not in former_keys():
            kept[key] = rest
    return kept


class InterlaceSettings(StrictModel):
    """When the rows of an image show two instants; the first field is kept, whose instant the stamp is."""

    comb_levels: Positive = 14.0  # levels by which a combed row differs from both neighbours: above noise


class ExposureSettings(StrictModel):
    """When an image counts as dim or veiled, and how far it is corrected."""

    dark_level: Level = 45.0  # level that the darkest things reach without a veil: a dark shaft has 20 to 40
    fair_level: float = Field(default=110.0, gt=0.0, le=255.0)  # of a scene's middle; less is dim


class AutoSettings(StrictModel):
    """Segmentation without colours from the user, in a working image that is reduced."""

    working_px: int = Field(default=320, ge=160, le=1280)  # longer side of the working image
    least_area: float = Field(default=0.003, gt=0.0, lt=0.5)  # an instrument's least part of the picture
    most_instruments: int = Field(default=5, ge=1, le=16)  # instruments of one image


class OutlineSettings(StrictModel):
    """Completing a region's outline where an instrument hides it."""

    irregularity: Share = 0.2
    """Standard deviation of the second harmonic over the radius: 0.2 is an ellipse of 3:2; the k-th falls as 1 / k³."""
    min_visible_fraction: float = Field(default=0.25, gt=0.0, le=1.0)
    """Visible part of the outline below which the hull is used: the prior alone would shape the curve."""
    border_std_px: NonNegative = 0.3  # standard deviation of an error that a whole side has in common


class MarkerSettings(StrictModel):
    """Judging the homography of the static virtual marker."""

    max_area_ratio: float = Field(default=4.0, gt=1.0)
    """Change of the marker's area beyond which matches are wrong: it is pasted without scaling."""


class ShaftSettings(StrictModel):
    """Finding a shaft, its edges and its end, and fitting its pose."""

    min_contrast_levels: float = Field(default=12.0, gt=0.0, lt=255.0)  # an edge's step
    end_model_std_m: float = Field(default=0.0002, ge=0.0, lt=0.1)  # standard deviation of the end
    unknown_bend_rad: float = Field(default=0.8, gt=0.0, lt=3.2)
    """Standard deviation of the wrist's bend about each axis without joints: any bend within 1.4 rad is as likely."""
    max_position_std_m: float = Field(default=0.015, gt=0.0, lt=1.0)
    """Largest standard deviation up to 10 cm, in proportion beyond: half of a shaft is twice as far, and as unsure."""


class DistalMarkerSettings(StrictModel):
    """Measuring the coloured distal marker, a sphere of the profile's `knuckle_radius_m`."""

    min_saturation: Level = 50.0  # median below which a region is bare steel, even in coloured light
    visible_radius: float = Field(default=0.98, gt=0.5, le=1.5)
    """Apparent radius over that of the whole sphere: 0.98 ± 0.01 in 240 simulated frames, for jaws and shade."""
    radius_std: Share = 0.04  # standard deviation of that ratio: twice the measured one, for light and blood


class StereoSettings(StrictModel):
    """Matching the two views of a stereo pair."""

    near_m: float = Field(default=0.04, gt=0.0, lt=10.0)  # an endoscope's shortest working distance
    far_m: float = Field(default=0.25, gt=0.0, lt=10.0)  # an endoscope's longest working distance
    min_matches: int = Field(default=2000, ge=100)  # pixels of the tissue that must match: an organ's
    block_px: int = Field(default=9, ge=3, le=31)
    """Side of the blocks of semi-global matching in the reduced views, an odd number: wet tissue needs as much."""
    row_pairs: int = Field(default=4, ge=0, le=100)
    """Pairs of a log's beginning that the offset between the rows of both views is found from; 0: no offset."""
    max_row_offset_px: float = Field(default=8.0, gt=0.0, le=100.0)  # the largest such offset
    max_depth_std_m: Positive = 0.015  # as `shaft.max_position_std_m`

    def _require_sound(self) -> None:
        if self.block_px % 2 == 0:  # a block has a pixel in its middle
            raise ValueError(f"block_px: expected an odd number, found {self.block_px}")


class TagSettings(StrictModel):
    """Detecting a fiducial tag."""

    min_side_px: float = Field(default=8.0, ge=4.0)
    """Side of the smallest tag that is looked for: a cell of 1 px; faster than OpenCV's own bound."""
    error_correction_rate: float = Field(default=1.0, ge=0.0, le=1.0)
    """Share of the wrong bits that a code can correct that are accepted: 86 of 116 tags are found, 62 with 0.6."""
    plate_ratio: float = Field(default=1.45, ge=1.0, le=4.0)  # a tag's plate over its black square


class FilterSettings(StrictModel):
    """The filter over kinematic errors, and when it withholds a distance."""

    gate_z: Positive = 3.09  # normal quantile of the gate of the tissue's height: 1 in 1,000 true ones
    point_correlation_time_s: Positive = 30.0  # of the bias of points and sizes: what hides a marker is fixed
    edge_correlation_time_s: Positive = 30.0  # of the bias of shaft edges: shading changes as the shaft turns
    max_consistency: Positive = 4.0
    """Mean normalised innovation per degree of freedom beyond which no distance is reported: 1 where models hold."""
    max_constant_deviations: Positive = 4.0
    """Standardised error of a calibration constant beyond which no distance is reported: 1 log in 1,000 has one."""
    given_lag_std_s: NonNegative = 5e-3  # standard deviation after `--lag`, in place of `time_offset_std_s`


class FusedSettings(StrictModel):
    """How a detection's error splits into white noise and bias."""

    lasting_share: float = Field(default=0.5, ge=0.0, lt=1.0)
    """Correlated fraction of a tag's and an edge's variance: shading shifts an edge while the light stays."""


class HandEyeSettings(StrictModel):
    """The fit of the camera-to-base transform."""

    min_count: int = Field(default=8, ge=4)  # frames in which the detected tool agrees with the robot's
    max_turn_std_rad: Positive = 0.26  # largest standard deviation of the rotation, 15°: the tool must move
    pose_std_m: Positive = 1e-3  # standard deviation of recorded poses along each axis: cables stretch


class AssociationSettings(StrictModel):
    """Assigning coloured regions and dark shafts to instruments."""

    miss_cost: NonNegative = 3.0  # -log of the probability that an instrument shows no region: 1 in 20
    acceleration_widths: Positive = 3.0  # standard deviation of the acceleration, in image widths per s²


class TissueTrackingSettings(StrictModel):
    """Averaging the tissue's pose over frames."""

    moved_count: Count = 5  # poses in a row away from the average that mean that the tissue has moved
    memory_count: float = Field(default=15.0, gt=1.0)  # poses older than as many fade, by 1/15 a frame


class Settings(StrictModel):
    """All settings, a table for each detector or estimator."""

    interlace: InterlaceSettings = InterlaceSettings()
    exposure: ExposureSettings = ExposureSettings()
    auto: AutoSettings = AutoSettings()
    outline: OutlineSettings = OutlineSettings()
    marker: MarkerSettings = MarkerSettings()
    shaft: ShaftSettings = ShaftSettings()
    distal_marker: DistalMarkerSettings = DistalMarkerSettings()
    stereo: StereoSettings = StereoSettings()
    tag: TagSettings = TagSettings()
    filter: FilterSettings = FilterSettings()
    fused: FusedSettings = FusedSettings()
    hand_eye: HandEyeSettings = HandEyeSettings()
    association: AssociationSettings = AssociationSettings()
    tissue: TissueTrackingSettings = TissueTrackingSettings()
