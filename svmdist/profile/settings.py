"""What a user may change of detectors and estimators: the tables `[settings.NAME]` of a profile.

The suffix of a name is its unit; what has none is a ratio or a count. Every other number is a constant beside its use.
"""

from __future__ import annotations

import logging
from typing import Annotated, Any

from pydantic import Field, model_validator

from svmdist.profile.toml import StrictModel

Positive = Annotated[float, Field(gt=0.0)]
Share = Annotated[float, Field(gt=0.0, lt=1.0)]
Count = Annotated[int, Field(ge=1)]


class InterlaceSettings(StrictModel):
    """When the rows of an image show two instants; the first field is kept, whose instant the stamp is."""

    comb_levels: Positive = 14.0
    """Levels of 255 by which a row differs from both neighbours where motion combs it: above a sensor's noise."""


class ExposureSettings(StrictModel):
    """When an image counts as dim or veiled, and how far it is corrected; levels are of 255."""

    dark_level: float = Field(default=45.0, ge=0.0, le=255.0)
    """Level that the darkest things reach without a veil: a dark shaft has 20 to 40."""
    fair_level: float = Field(default=110.0, gt=0.0, le=255.0)
    """Where automatic exposure puts the middle of a scene at least; less is dim light."""


class AutoSettings(StrictModel):
    """Segmentation without colours from the user, in a working image that is reduced."""

    working_px: int = Field(default=320, ge=160, le=1280)
    """Longer side of the working image: a shaft of 8 mm at 200 mm is 10 to 20 px wide there."""
    network_weight: float = Field(default=1.0, ge=0.0, le=4.0)
    """Weight of the log odds of the network that ships beside those of learnt colours. 1: both count as independent.
    0: the network is not run."""
    adapting_frames: int = Field(default=8, ge=1, le=64)
    """Images of a log, evenly over its length, that colours are learnt from before the first row: so many, or up to
    twice as many."""
    least_area: float = Field(default=0.003, gt=0.0, lt=0.5)
    """An instrument's least part of the picture."""
    most_instruments: int = Field(default=5, ge=1, le=16)
    """Instruments of one image."""


class OutlineSettings(StrictModel):
    """Completing a region's outline where an instrument hides it."""

    irregularity: Share = 0.2
    """Standard deviation of the second harmonic over the radius: 0.2 is an ellipse of 3:2, as outlines of organs have
    it; the k-th falls as 1 / k³."""
    min_visible_fraction: float = Field(default=0.25, gt=0.0, le=1.0)
    """With less of the outline than this the prior alone would shape the curve; the hull is used as it is."""
    border_std_px: float = Field(default=0.3, ge=0.0)
    """Standard deviation of an error that a whole side has in common: a threshold cuts a blurred border up to half a
    pixel outside or inside."""


class MarkerSettings(StrictModel):
    """Judging the homography of the static virtual marker."""

    max_area_ratio: float = Field(default=4.0, gt=1.0)
    """Change of the marker's area beyond which matches are wrong: the marker is pasted without scaling."""


class ShaftSettings(StrictModel):
    """Finding a shaft, its edges and its end, and fitting its pose."""

    min_contrast_levels: float = Field(default=18.0, gt=0.0, lt=255.0)
    """Levels of 255 between shaft and background: less is a shadow."""
    end_model_std_m: float = Field(default=0.0002, ge=0.0, lt=0.1)
    """Standard deviation of the dark part's end: a bevel, and glare on it, hide it."""
    unknown_bend_rad: float = Field(default=0.8, gt=0.0, lt=3.2)
    """Standard deviation of the wrist's bend about each axis without joints: any bend within 1.4 rad is as likely."""
    max_position_std_m: float = Field(default=0.008, gt=0.0, lt=1.0)
    """A position less certain than this along any direction is no measurement: a shaft whose radius is known to 2 %
    leaves 2 mm of depth, one that is seen as a stub twice that."""


class DistalMarkerSettings(StrictModel):
    """Measuring the coloured distal marker, a sphere of the profile's `knuckle_radius_m`."""

    min_saturation: float = Field(default=50.0, ge=0.0, le=255.0)
    """Median saturation, of 255, below which the region is bare steel, even in coloured light."""
    visible_radius: float = Field(default=0.97, gt=0.5, le=1.5)
    """Apparent radius over that of the whole sphere: jaws and fork hide a part, and the limb is in shade. Measured 0.96
    ± 0.02 in 72 simulated frames."""
    radius_std: Share = 0.04
    """Standard deviation of that ratio: twice the measured one, for light from the endoscope's tip, and blood."""


class StereoSettings(StrictModel):
    """Matching the two views of a stereo pair."""

    near_m: float = Field(default=0.04, gt=0.0, lt=10.0)
    """The shortest working distance of an endoscope: it bounds the disparities."""
    far_m: float = Field(default=0.25, gt=0.0, lt=10.0)
    """The longest working distance of an endoscope."""
    min_matches: int = Field(default=2000, ge=100)
    """Pixels of the tissue that must match: fewer are no view of an organ."""
    block_px: int = Field(default=9, ge=3, le=31)
    """Side of the blocks of semi-global matching in the reduced views, an odd number: wet tissue shows its texture over
    no less."""
    row_pairs: int = Field(default=4, ge=0, le=100)
    """Pairs of a log's beginning from which the offset between the rows of both views is found; 0: rows are as the
    calibration has them."""
    max_row_offset_px: float = Field(default=8.0, gt=0.0, le=100.0)
    """The largest offset between rows that is looked for."""
    max_depth_std_m: Positive = 0.008
    """A tool whose position is less certain than this along any direction is not measured."""


class TagSettings(StrictModel):
    """Detecting a fiducial tag."""

    min_side_px: float = Field(default=8.0, ge=4.0)
    """Side of the smallest tag that is looked for: a cell of 1 px. Faster than OpenCV's own bound, and no tag of 12 px
    or more is lost."""
    error_correction_rate: float = Field(default=1.0, ge=0.0, le=1.0)
    """Share of the wrong bits that a code can correct that are accepted: of 116 synthetic tags 86 are found, 62 at
    OpenCV's 0.6, and no other tag in 430 images."""
    plate_ratio: float = Field(default=1.45, ge=1.0, le=4.0)
    """Size of a tag's plate over that of its black square: a white margin of a cell or more, and blur."""


class FilterSettings(StrictModel):
    """The filter over kinematic errors, and when it withholds a distance."""

    gate_z: Positive = 3.09
    """Normal quantile of the gate, which rejects 1 in 1,000 true measurements."""
    point_correlation_time_s: Positive = 30.0
    """Of the bias of points and sizes: what hides a part of the distal marker is fixed to it."""
    edge_correlation_time_s: Positive = 30.0
    """Of the bias of shaft edges: shading changes as the shaft turns in the light, hardly in logs of 8 s."""
    depth_candidates_m: tuple[Positive, ...] = (0.05, 0.1, 0.2)
    """Depths at which an update also starts while the tool's depth is unknown: an endoscope's working range."""
    max_consistency: Positive = 4.0
    """Mean normalised innovation per degree of freedom beyond which no distance is reported: 1 where models hold, 4 for
    deviations that are wrong by a factor of two."""
    max_constant_deviations: Positive = 4.0
    """Deviations of a constant from the profile's value beyond which no distance is reported: true deviations exceed
    it in one log of a thousand."""
    given_lag_std_s: float = Field(default=5e-3, ge=0.0)
    """Standard deviation of the time offset that `--lag` leaves, in place of `time_offset_std_s`."""


class FusedSettings(StrictModel):
    """How a detection's error splits into white noise and bias."""

    lasting_share: float = Field(default=0.5, ge=0.0, lt=1.0)
    """Share of a tag's and an edge's variance that lasts from frame to frame: shading shifts an edge for as long as the
    light falls on it so."""


class HandEyeSettings(StrictModel):
    """The fit of the camera-to-base transform."""

    min_count: int = Field(default=8, ge=4)
    """Frames in which the detected tool agrees with the robot's."""
    max_turn_std_rad: Positive = 0.26
    """Largest standard deviation of the rotation, 15°: beyond it the tool has not moved enough."""
    pose_std_m: Positive = 1e-3
    """Standard deviation of recorded poses along each axis, where no joints are known: cables stretch."""


class AssociationSettings(StrictModel):
    """Assigning coloured regions and dark shafts to instruments."""

    miss_cost: float = Field(default=3.0, ge=0.0)
    """-log of the probability that an instrument shows no region: hidden or outside in one frame of twenty."""
    acceleration_widths: Positive = 0.8
    """Standard deviation of an instrument's acceleration, in image widths per s²: a brisk turn of the wrist."""


class TissueTrackingSettings(StrictModel):
    """Averaging the tissue's pose over frames."""

    moved_count: Count = 5
    """Poses in a row away from the remembered one that mean that the tissue has moved: one or two are wild."""
    memory_count: float = Field(default=15.0, gt=1.0)
    """Poses older than as many fade (by 1/15 a frame), so that tissue that creeps or breathes is followed."""


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

    @model_validator(mode="before")
    @classmethod
    def _without_former_keys(cls, data: Any) -> Any:
        """Drop the keys of older profiles that are constants now, with a warning for each."""
        if not isinstance(data, dict):
            return data
        kept = {}
        for table, given in data.items():
            former = set(FORMER.get(table, "").split()) & set(given) if isinstance(given, dict) else set()
            for key in sorted(former):
                LOG.warning("settings.%s.%s is no longer a setting; ignored", table, key)
            rest = {key: value for key, value in given.items() if key not in former} if former else given
            if rest or table in cls.model_fields:
                kept[table] = rest
        return kept


LOG = logging.getLogger(__name__)
FORMER = {
    "interlace": "comb_ratio block_px min_fraction colour_delay_std_s min_pixels",
    "exposure": """
        sampling_px border_fraction black_percentile middle_percentile distinct_fraction noisy_gain
        noise_sigma_px
    """,
    "auto": """
        border_levels border_floor_level border_fraction level_offset most_area line_within_px least_side_px
        most_taper_cos usual_taper_rad least_width_fraction most_width_fraction least_length_widths
        least_length_px reach_px colour_step brightness_step least_step_fraction least_ratio_step least_cooler
        least_darker most_warmer grey_chroma most_yellower yellow_from least_evidence teaching_evidence
        sure_evidence beside_widths distal_widths distal_half_widths
    """,
    "outline": """
        speck_fraction blood_fraction blood_ring_fraction sample_step_px max_sample_count gap_reach_px
        straight_length_per_root_px straight_within_px shoulder_samples harmonics hidden_std max_iterations
        correlation_samples mask_std_px outside_deviations inside_deviations
    """,
    "marker": "refit_thresholds_px refit_min_count",
    "shaft": """
        view_border_fraction glare_width_fraction speck_width_fraction min_side_px max_taper_rad
        max_printed_fraction edge_reach_fraction min_edge_reach_px side_trim_fraction slope_sigma_px
        slope_sigma_per_blur blur_reach_fraction penumbra_ratio penumbra_blur_px point_correlation_px
        min_point_std_px line_inlier_px line_inlier_per_blur line_inlier_per_width shading_std_px
        shading_std_per_blur outline_shading_std_px end_strip_fraction end_reach_half_widths min_end_std_px
        outline_end_std_radii unknown_outline_end_std_radii jaw_tip_std gate_chi2 doubt_square near_m
    """,
    "silhouette": """
        min_side_per_width max_taper_rad edge_reach_fraction edge_reach_widths edge_turn_widths
        search_scale_widths texture_factor full_contrast_levels min_contrast_levels min_found min_seen
        min_support straight_px straight_widths end_share end_reach_widths ends_agree_widths min_end_std_widths
        wrist_reach wrist_std min_wrist_widths min_wrist_share flank_stds flank_light_levels flank_colour_levels
        max_flank_outliers
    """,
    "distal_marker": """
        min_chroma min_agreeing_fraction max_log_ratio border_points border_std_per_blur centroid_std
        visible_middle shading_bias centre_noise unknown_shape_std_px min_visible_fraction whole_area_spread
        min_relative_depth_std
    """,
    "stereo": """
        min_agreeing_matches matched_disparities margin_px smoothing_px surface_std_px clean_mismatch_px
        inner_radius smooth_fraction max_spread tool_speed_m_s row_stride min_row_offset_px min_row_points
        row_tolerance_px marker_disparity_std marker_disparity_noise_px tracked_disparity_noise
        interlaced_disparity_noise lasting_disparity even_area_fraction size_tolerance hidden_disparity_std
        other_part_place part_disparity_std mistaken_edge mistaken_stub mistaken_rim mistaken_marker
        mistaken_size mistaken_disparity max_refused watch_frames watch_bound_stds kept_doubt_stds
        depth_gate_stds
    """,
    "tag": """
        cell_samples cell_margin corner_window_cells min_edge_reach_px edge_steps window_margin margin_cells
        blur_starts_px blur_min_px blur_max_px coarse_pixels coarse_steps coarsely_settled coarse_bound
        fine_steps settled outlier_bound edge_slope min_pixels min_contrast cluster_inflation decided_ratio
        near_rad sure_rad predicted_within_rad
    """,
    "filter": """
        pose_correlation_time_s max_iterations depth_unknown_std_m max_rejections max_contradictions
        window_solves window_depth_offsets_m window_depth_offset_frames window_max_steps window_max_deviation
        consistency_window_s consistency_min_degrees max_refused_frames max_refused_share
        max_young_refused_share usual_constant_deviations max_time_offset_deviations probation_s
    """,
    "fused": "depth_known_fraction",
    "hand_eye": """
        min_fraction gate huber trials axis_floor_rad axis_tilt_floor_rad position_floor_m correlation_time_s
    """,
    "association": """
        placed_fraction min_depth_m gate_d2 clutter_count margin contest uncertain_fraction merged_area
        max_regions spread_fraction min_std_px first_speed_widths linear_std drift_widths linear_drift ray_count
        ray_span likely_dark unlikely_dark min_ray_fraction shaft_reach grown_px fragment_reach side_std
        entry_std entry_speed end_std end_speed unseen_cost unnamed_cost
    """,
    "tissue": "min_scatter_count shape_count gate_z lasting_height_share height_correlation_time_s",
}
