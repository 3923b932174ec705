"""What detectors and estimators may assume, as frozen settings: the tables `[settings.NAME]` of a profile."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from svmdist.profile.toml import StrictModel


class MethodSettings(StrictModel):
    """A table `[settings.NAME]` of a profile.

    The name of every field says its unit; the docstring below it its meaning, and where the default is from.
    """


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


class AutoSettings(MethodSettings):
    """What tells an instrument from tissue without a colour from the user; levels are of 255.

    Pixels named here are those of the working image, whose longer side has `working_px`. What is found there is
    enlarged to the image's own resolution.
    """

    working_px: int = Field(default=320, ge=160, le=1280)
    """Longer side of the image that is worked on: a shaft of 8 mm at 200 mm is 10 to 20 px wide there."""
    network_weight: float = Field(default=1.0, ge=0.0, le=4.0)
    """How much the log odds of the network that ships count beside those of the colours that were learnt. 1: both are
    taken for independent. 0: it is not run."""
    adapting_frames: int = Field(default=8, ge=1, le=64)
    """Images of a log, evenly over its length, that colours are learnt from before the first row: so many, or up to
    twice as many."""

    border_levels: float = Field(default=6.0, ge=0.0, le=64.0)
    """A black border differs from the darkest thing in the image by no more: noise and compression."""
    border_floor_level: float = Field(default=10.0, ge=0.0, le=64.0)
    """What is darker than this is border, whatever the darkest thing is."""

    border_fraction: float = Field(default=0.4, gt=0.0, le=1.0)
    """A border is darker than this part of the picture's median; haze may lift it so far. Else there is none."""

    level_offset: float = Field(default=8.0, gt=0.0, le=64.0)
    """Added to levels before their logarithm is taken: noise of one or two levels must not be a colour."""
    least_area: float = Field(default=0.003, gt=0.0, lt=0.5)
    """An instrument's least part of the picture."""
    most_area: float = Field(default=0.45, gt=0.0, le=1.0)
    """What is larger is background that shares the instrument's colour."""
    line_within_px: float = Field(default=1.3, gt=0.0)
    """How far points of a straight edge may lie off its line: a pixel's rounding, and the working image's blur."""
    least_side_px: float = Field(default=8.0, gt=2.0)
    """Points of an outline that must lie on a line for it to be a side."""
    most_taper_cos: float = Field(default=0.92, gt=0.0, le=1.0)
    """Cosine of the largest angle between both sides, 23°: a cylinder seen along its axis has none to measure."""
    usual_taper_rad: float = Field(default=0.2, gt=0.0)
    """Standard deviation of that angle: of lines that fit as well, a shaft's run more alike than those of jaws."""
    least_width_fraction: float = Field(default=0.02, gt=0.0, lt=1.0)
    """An instrument's least width, over the working image's: less is a thread or a vessel."""
    most_width_fraction: float = Field(default=0.4, gt=0.0, le=1.0)
    """An instrument's largest width, over the working image's."""
    least_length_widths: float = Field(default=0.8, gt=0.0)
    """Of both sides, over the width: less is not straight-edged, but any blob that has been cut off."""
    least_length_px: float = Field(default=12.0, gt=0.0)
    """The same in px: shorter edges of tissue are straight by chance."""
    reach_px: float = Field(default=2.5, gt=0.5)
    """Colours beside a side are compared this far inside and outside of it."""
    colour_step: float = Field(default=0.12, gt=0.0)
    """A difference of logarithms of two channels' ratio that is seen as a step of colour."""
    brightness_step: float = Field(default=0.25, gt=0.0)
    """The same of brightness, which shading changes more."""
    least_step_fraction: float = Field(default=0.6, gt=0.0, le=1.0)
    """Part of each side along which there is a step; shadows have none of that height."""
    least_ratio_step: float = Field(default=1.0, gt=0.0)
    """The same step in how likely colours are an instrument's, as the logarithm of a ratio, once they are known."""
    least_cooler: float = Field(default=0.05, ge=0.0)
    """How much less red an instrument is than what is on either side of it, as a logarithm."""
    least_darker: float = Field(default=0.25, ge=0.0)
    """How much darker, where it is not less red: dark steel on grey paper."""
    most_warmer: float = Field(default=0.08, ge=0.0)
    """How much redder it may then be, where it has a colour."""
    grey_chroma: float = Field(default=0.15, ge=0.0)
    """What has less chroma, as a logarithm, has no colour: paper in bluish light makes grey steel look redder."""
    most_yellower: float = Field(default=0.15, ge=0.0)
    """How much more yellow than either side it may be: fat is less red than muscle, and no instrument."""
    yellow_from: float = Field(default=0.3)
    """log(G/B) from which on something is yellow at all: beside purple tissue steel is more yellow, and has none."""
    least_evidence: float = Field(default=0.2, gt=0.0, lt=1.0)
    """Evidence, from 0 to 1, of two straight edges: what has less is tissue."""
    teaching_evidence: float = Field(default=0.44, gt=0.0, lt=1.0)
    """Evidence that the surest bar of an image must have for anything to be learnt from it."""
    sure_evidence: float = Field(default=0.4, gt=0.0, lt=1.0)
    """Evidence from which on a bar's colours are learnt."""
    most_instruments: int = Field(default=5, ge=1, le=16)
    """Instruments of one image."""
    beside_widths: float = Field(default=0.5, ge=0.0)
    """How far, over its width, an instrument goes beyond its bar's sides where its colours leave no doubt."""
    distal_widths: float = Field(default=4.5, gt=0.0)
    """How far wrist and jaws reach beyond the end of the shaft, over its width there."""
    distal_half_widths: float = Field(default=1.3, gt=0.0)
    """How far they reach to either side of its axis, over its width."""


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


class StereoSettings(MethodSettings):
    """What is assumed in matching the two views of a stereo pair."""

    near_m: float = Field(default=0.04, gt=0.0, lt=10.0)
    """The shortest working distance of an endoscope: it bounds the disparities that mean something."""
    far_m: float = Field(default=0.25, gt=0.0, lt=10.0)
    """The longest working distance of an endoscope."""

    min_matches: int = Field(default=2000, ge=100)
    """Pixels of the tissue that must match: fewer are no view of an organ."""
    min_agreeing_matches: float = Field(default=0.8, ge=0.0, le=1.0)
    """Of the matches, those that lie on the surface: where noise is matched for want of
    texture, two of three do, and on tissue nearly all."""
    block_px: int = Field(default=9, ge=3, le=31)
    """Side of the blocks of semi-global matching, in pixels of the reduced views, an odd number: wet tissue shows its
    texture over no less."""
    matched_disparities: int = Field(default=32, ge=16, le=512)
    """Both views are reduced by a whole factor until the search spans about so many disparities: matching need only
    place the surface within a pixel or two, from where the alignment goes on at full resolution."""
    margin_px: int = Field(default=7, ge=0, le=100)
    """Matches this close to the tissue's edge mix two surfaces within one block."""
    smoothing_px: float = Field(default=1.5, gt=0.0)
    """Both views are smoothed before they are aligned, so that a step of a pixel stays on a slope."""
    surface_std_px: float = Field(default=0.12, gt=0.0)
    """What an aligned low-order surface leaves of the disparity: measured 0.36 mm at 105 mm and a baseline of 5 mm."""
    clean_mismatch_px: float = Field(default=0.36, gt=0.0)
    """The mismatch in those measurements, where the images differ by no more than noise of 2 levels makes them. Blocks
    of JPEG and noise in the dark shift pixels more, and the surface with them, in proportion."""

    inner_radius: float = Field(default=0.9, gt=0.0, lt=1.0)
    """Of the dome, normalised: beyond it the rim is too steep for a surface of low order."""
    smooth_fraction: float = Field(default=0.4, gt=0.0, le=1.0)
    """Part of a point's deviation that is as smooth as a dome's apex and height: the surface errs most in its highest
    coefficients, at the rim. Measured over seven organs: fitted without a prior, shapes stand 0.11 mm off the real
    ones."""
    max_spread: float = Field(default=3.0, gt=0.0)
    """Points that scatter about the dome by so many of their deviations are no view of it."""

    tool_speed_m_s: float = Field(default=0.05, ge=0.0)
    """How fast the tool moves along each axis, as a standard deviation: it stands elsewhere in a later view."""
    row_pairs: int = Field(default=4, ge=0, le=100)
    """Pairs of a log's beginning from which the offset between the rows of both views is found; 0: rows are as the
    calibration has them."""
    row_stride: int = Field(default=12, ge=1, le=1000)
    """The steps between these pairs."""
    max_row_offset_px: float = Field(default=8.0, gt=0.0, le=100.0)
    """The largest offset between rows that is looked for."""
    min_row_offset_px: float = Field(default=0.5, ge=0.0)
    """A smaller offset is left: it does less harm than shifting an image between its pixels."""
    min_row_points: int = Field(default=40, ge=5)
    """Points in all these pairs that must agree on an offset."""
    row_tolerance_px: float = Field(default=3.0, gt=0.0)
    """Corresponding points of rectified images lie on one row; the marker is cut a little differently in each."""
    marker_disparity_std: float = Field(default=0.012, gt=0.0)
    """Of the marker's disparity over its radius, where one frame stands alone: jaws and fork hide other parts of it
    from another side. 3 degrees between the views of the 45 thousandths by which they move the centroid in either."""
    marker_disparity_noise_px: float = Field(default=0.05, gt=0.0)
    """Noise of the marker's disparity: that of two centroids of some hundred pixels."""
    tracked_disparity_noise: float = Field(default=0.008, gt=0.0)
    """Of the marker's disparity over its radius, where a filter estimates the part that lasts: two views see the
    marker from 3 degrees apart."""
    interlaced_disparity_noise: float = Field(default=0.03, ge=0.0)
    """The same noise in an interlaced image, where colours of both fields are mixed: 0.4 px at a radius of 12."""
    lasting_disparity: float = Field(default=0.016, ge=0.0)
    """Of the marker's disparity over its radius, what lasts: blood, shading and colour at half the resolution cut the
    marker differently in either view. Over six logs of such worlds 0.1 to 0.2 px at a radius of 12."""
    even_area_fraction: float = Field(default=0.02, ge=0.0)
    """By how much the marker's areas in both views differ when nothing is wrong, over their sum."""
    size_tolerance: float = Field(default=0.2, gt=0.0)
    """A whole marker is as large as its depth makes it; what is smaller is partly hidden, in both views alike."""
    hidden_disparity_std: float = Field(default=0.15, ge=0.0)
    """Of the disparity of a disc of which the same part is hidden in both views, over the radius and that part: what is
    hidden moves the centroid by up to half of itself, and from 3 degrees aside by a quarter more or less."""
    other_part_place: float = Field(default=3.0, ge=0.0)
    """How far a disc that has not the marker's size may be from the marker's place, as a standard deviation over the
    marker's radius: a ring behind it or a clip, anywhere on the distal part."""
    part_disparity_std: float = Field(default=0.04, ge=0.0)
    """Of the disparity of a coloured part that is no disc, over the radius of a disc of its area: from 3 degrees aside
    another part of it shows."""
    max_depth_std_m: float = Field(default=0.008, gt=0.0)
    """A tool whose place is less certain than this along any direction is not measured."""
    mistaken_edge: float = Field(default=0.03, gt=0.0, lt=1.0)
    """How often an edge of a shaft that is longer than wide belongs to something else. By these shares it is decided
    what to leave out where measurements contradict each other."""
    mistaken_stub: float = Field(default=0.2, gt=0.0, lt=1.0)
    """The same for a stub: one edge in five."""
    mistaken_rim: float = Field(default=0.2, gt=0.0, lt=1.0)
    """How often the cylinder's end is something else: what lies across the shaft ends it, too."""
    mistaken_marker: float = Field(default=0.05, gt=0.0, lt=1.0)
    """How often what has the marker's colour is not the marker. A disc in both views never is."""
    mistaken_size: float = Field(default=0.1, gt=0.0, lt=1.0)
    """How often the marker's size is not that of the whole marker: blood and jaws hide a part."""
    mistaken_disparity: float = Field(default=0.02, gt=0.0, lt=1.0)
    """How often the marker's disparity is wrong."""
    max_refused: int = Field(default=4, ge=0, le=10)
    """What both views show of the tool may contradict the rest in so many parts; with more there is no telling what is
    right."""
    watch_frames: int = Field(default=20, ge=1, le=1000)
    """Frames over which disparities are held against the instrument's sizes."""
    watch_bound_stds: float = Field(default=2.5, gt=0.0)
    """Deviations of their difference, in the median, beyond which it is stated as uncertainty of depth: it is the same
    in all frames, so that one log in eighty is beyond it by chance."""
    kept_doubt_stds: float = Field(default=2.5, gt=0.0)
    """The same in one frame, of a disparity that is not refused."""
    depth_gate_stds: float = Field(default=3.5, gt=0.0)
    """Deviations between the disparity and a pose of one view above which they contradict each other."""


class TagSettings(MethodSettings):
    """What is assumed in detecting a fiducial tag and refining its pose."""

    min_side_px: float = Field(default=8.0, ge=4.0)
    """Side of the smallest tag that is looked for, in px: a cell of 1 px. A fifth of the search's time is saved over
    OpenCV's own bound, and no tag of 12 px or more is lost."""

    error_correction_rate: float = Field(default=1.0, ge=0.0, le=1.0)
    """Share of the wrong bits that a family's code can correct that are accepted. Of 116 synthetic tags with glare or
    blood or 12 to 20 px wide 86 are found, and 62 at OpenCV's 0.6, and no other tag in 430 images. Families of 4 x 4
    cells correct at most OpenCV's share."""

    cell_samples: int = Field(default=6, ge=1, le=32)
    """Samples along a cell from which a code's bits are read. With OpenCV's 4 a cell of a small or slanting tag mixes
    with its neighbours: of 47 tags of 12 to 50 px in photographs 41 are found with 4, and 44 with 6."""

    cell_margin: float = Field(default=0.2, ge=0.0, lt=0.5)
    """Share of a cell at each of its edges that is left out there."""

    corner_window_cells: float = Field(default=0.6, gt=0.0, le=1.0)
    """Half the window in which the edges that meet in a corner are measured, in cells: black and white are a cell wide
    beside an edge."""

    min_edge_reach_px: float = Field(default=2.0, gt=0.0, le=20.0)
    """The same in px, at least: a rough corner is off by a pixel or two."""

    edge_steps: int = Field(default=2, ge=1, le=20)
    """How often edges are measured anew along the corners that they gave."""

    plate_ratio: float = Field(default=1.45, ge=1.0, le=4.0)
    """Size of a tag's plate over that of its black square: the white margin of a cell or more, and the blur
    around it."""

    window_margin: float = Field(default=0.2, ge=0.1, le=1.0)
    """How far around a tag's corners pixels are compared with the pattern, over the tag's size in the image. A margin
    of 0.6 cells of a tag of 8 cells needs 0.075, what is more allows for wrong corners."""

    margin_cells: float = Field(default=0.6, ge=0.0, le=2.0)
    """How much of the white margin is compared, in cells. What lies behind the plate shines into the rest of it."""

    blur_starts_px: tuple[float, ...] = Field(default=(0.8, 1.6, 3.2), min_length=1)
    """Standard deviations of the image's blur of which the best one starts the search: sharp, soft, and moving."""

    blur_min_px: float = Field(default=0.3, gt=0.0, le=6.0)
    """The sharpest image that is considered: a pixel's own area blurs by 0.29 px."""

    blur_max_px: float = Field(default=6.0, gt=0.0, le=20.0)
    """The most blurred image that is considered. Of a tag 40 px wide no cell would be seen any more."""

    coarse_pixels: int = Field(default=1500, ge=100)
    """How many pixels the search from a first pose looks at; a tag 40 px wide has twice as many."""

    coarse_steps: int = Field(default=16, ge=1, le=200)
    """Steps of the search from each first pose, at most. It takes 4 on a clear image."""

    coarsely_settled: float = Field(default=3e-3, gt=0.0, le=0.1)
    """A step of which no part is larger, in tag sides, rad and px of blur, ends the search from a first pose."""

    coarse_bound: float = Field(default=3.0, gt=0.0)
    """On the way from a first pose, pixels that differ by more standard deviations than this count singly (Huber)."""

    fine_steps: int = Field(default=16, ge=1, le=200)
    """Steps of the refinement, at most. It takes 4 on a clear image."""

    settled: float = Field(default=1e-4, gt=0.0, le=1e-2)
    """A step of which no part is larger ends the refinement. Steps shrink threefold at the least: what is left is some
    0.3 µm of a tag of 7 mm, a hundredth of what it is uncertain by."""

    outlier_bound: float = Field(default=6.0, gt=1.0)
    """Pixels that differ by more standard deviations than this do not count, the others the less the more they differ
    (Tukey's biweight; at this bound it is 95 % efficient on normal errors). Glare and blood are outliers."""

    edge_slope: float = Field(default=0.2, gt=0.0, lt=1.0)
    """Pixels count as on an edge where the pattern's slope is more than this share of its largest. Their residuals tell
    the standard deviation: those of the even cells are smaller and say nothing about the pose."""

    min_pixels: int = Field(default=50, ge=10)
    """Pixels on the tag below which there is no pose."""

    min_contrast: float = Field(default=4.0, gt=0.0)
    """Grey levels between black and white below which there is no pattern to compare."""

    cluster_inflation: float = Field(default=2.2, ge=1.0)
    """By how much the covariance by clusters of pixels is too small. Pixels that sample a point, as a renderer without
    antialiasing or a sensor without a low-pass does, shift an edge that is nearly parallel to the rows by up to half a
    pixel over its whole length, across many cells. Measured, not derived: on 450 synthetic tags of 40 px, tilted by
    11° to 46°, the squared errors over their variances, per degree of freedom, are 1.8 to 2.8 without it and 0.9 to
    1.5 with it where each pixel samples a point, 1.3 to 1.5 and 0.8 to 0.9 where it integrates over its area."""

    decided_ratio: float = Field(default=1.15, ge=1.0)
    """Ratio of the residuals above which the image itself decides between the two poses. Over 347 frames of simulated
    logs the ratio was above 1.3 in nine of ten."""

    near_rad: float = Field(default=0.05, ge=0.0)
    """Poses closer than this are one: a tag that is seen head-on has one minimum, with a wide covariance."""

    sure_rad: float = Field(default=0.03, ge=0.0)
    """A predicted rotation whose standard deviation is below this tells the two poses apart even where they are
    closest, at 10° of tilt 0.35 rad."""

    predicted_within_rad: float = Field(default=0.35, gt=0.0)
    """How far the predicted rotation may be off for it to decide: twice 2° about each axis and 1° in each of seven
    joints."""


Positive = Annotated[float, Field(gt=0.0)]
Count = Annotated[int, Field(ge=1)]


class FilterSettings(MethodSettings):
    """What is assumed in the filter over kinematic errors: its gate, bias states, iterations and first frames."""

    gate_z: Positive = 3.09
    """Normal quantile of the gate: a measurement that is less likely than this is rejected. 3.09: 1 in 1,000."""

    point_correlation_time_s: Positive = 30.0
    """Correlation time of the bias of points and sizes. What hides a part of the distal marker is fixed to it: its
    visible middle stays where it is on the tool. Longer than the logs of 8 s that it was found on."""

    edge_correlation_time_s: Positive = 30.0
    """Correlation time of the bias of shaft edges. Shading beside an edge changes as the shaft turns in the light:
    hardly in logs of 8 s."""

    pose_correlation_time_s: Positive = 0.5
    """Correlation time of the bias of a tag's pose. How a tag's edges fall on the pixels changes with every pixel of
    motion."""

    max_iterations: Count = 8
    """Gauss–Newton steps of one update. Two or three are usual; more where the first frames are centimetres off."""

    depth_candidates_m: tuple[Positive, ...] = (0.05, 0.1, 0.2)
    """Depths at which an update also starts while the tool's depth is unknown: where an endoscope's tool may be, a
    factor of two apart."""

    depth_unknown_std_m: Positive = 0.01
    """Standard deviation of the tool's depth above which it counts as unknown."""

    max_rejections: Count = 8
    """After so many frames in a row with measurements but none accepted, the filter has lost the arm and starts
    anew."""

    max_contradictions: Count = 25
    """After so many frames in a row whose measurements contradict each other, the filter starts anew: what profile
    and log state wrongly will contradict again, a filter that went astray will not."""

    window_solves: tuple[Count, ...] = Field(default=(1, 2, 3, 5, 8, 12, 20), min_length=1)
    """Numbers of frames after which a young filter solves for all of them anew. Linearisation is off by tens
    of millimetres in the first frames; after 20 it no longer is."""

    window_depth_offsets_m: tuple[float, ...] = (0.0, 0.03, -0.03)
    """Offsets in depth at which that solution starts too: depth is the least observable at first. Half of a working
    range."""

    window_depth_offset_frames: Annotated[int, Field(ge=0)] = 3
    """Up to so many frames it starts there; later the last solution is a start that needs no others."""

    window_max_steps: Count = 20
    """Levenberg–Marquardt steps from each start."""

    window_max_deviation: Positive = 2.0
    """Normalised square over the gate's bound beyond which a measurement of the first frames is left out for good: its
    weight in the solution is less than a half there."""

    consistency_window_s: Positive = 1.5
    """Normalised innovations are averaged over so long: some ten degrees of freedom at 1 Hz, a hundred at 10 Hz."""

    consistency_min_degrees: Count = 8
    """Fewer degrees of freedom in that window tell nothing of consistency."""

    max_consistency: Positive = 4.0
    """Mean normalised innovation per degree of freedom beyond which no distance is told. Where models hold it is 1 or
    less; deviations that are wrong by a factor of two give 4."""

    max_refused_frames: Count = 4
    """So many frames in a row, of which all that was measured is refused, tell no distance: what hides an instrument
    misleads two or three."""

    max_refused_share: float = Field(default=0.5, gt=0.0, le=1.0)
    """Share of measured degrees of freedom, refused by the gate, beyond which no distance is told: more than half
    contradicts the prediction."""

    max_young_refused_share: float = Field(default=0.2, gt=0.0, le=1.0)
    """The same in the first frames, as long as a young filter solves for all of them anew: what it refuses then, later
    frames are judged by."""

    usual_constant_deviations: Positive = 2.5
    """A constant (focal length, tag size, a length, …) that is found so many stated deviations from its stated value
    is usual: one of twenty is, one time in four. Beyond, all deviations grow in proportion."""

    max_constant_deviations: Positive = 4.0
    """Beyond so many what is stated and what is seen contradict each other, and no distance is told. True deviations
    leave it to one log in a thousand."""

    given_lag_std_s: Annotated[float, Field(ge=0.0)] = 5e-3
    """Standard deviation of what is left of the offset between joints and images where `--lag` says what it is. It
    stands in for `time_offset_std_s` of the profile then."""

    max_time_offset_deviations: Positive = 5.0
    """Where the offset between joints and images is found so many stated deviations from what is stated, no distance
    is told: with those of the profile that is beyond the joints that travel with an image."""

    probation_s: Positive = 3.0
    """After such a new start no distance is told for so long: what was stated wrongly contradicts again by then."""


class FusedSettings(MethodSettings):
    """What of a detection's error is noise, and what lasts."""

    depth_known_fraction: float = Field(default=0.05, gt=0.0)
    """Standard deviation of depth over depth below which the predicted depth tells how large the whole marker is."""
    lasting_share: float = Field(default=0.5, ge=0.0, lt=1.0)
    """Share of a tag's and of an edge's variance that lasts from frame to frame: how a tag's edges fall on the
    pixels changes with motion, shading shifts an edge for as long as the light falls on it so."""


class HandEyeSettings(MethodSettings):
    """What the fit of the camera-to-base transform assumes, and when it refuses."""

    min_count: int = Field(default=8, ge=4)
    """Frames in which the seen tool agrees with the robot's: fewer say nothing of each other."""
    min_fraction: float = Field(default=0.5, gt=0.0, le=1.0)
    """Part of the frames that must agree: else what is seen is another thing than what the robot moves."""
    gate: float = Field(default=16.3, gt=0.0)
    """Largest squared normalised residual of a place that agrees: chi square of 3 degrees of freedom, 99.9 %."""
    huber: float = Field(default=2.0, gt=0.0)
    """Normalised residual from which on a frame counts less."""
    trials: int = Field(default=400, ge=10)
    """Samples of three frames that the fit starts from."""
    axis_floor_rad: float = Field(default=0.01, gt=0.0)
    """Standard deviation added to that of a shaft's direction in the image: what its outline does not show, 0.6°."""
    axis_tilt_floor_rad: float = Field(default=0.17, gt=0.0)
    """The same towards the camera, 10°: without joints, edges in shadows tilted it by that in simulated rooms."""
    position_floor_m: float = Field(default=2e-4, gt=0.0)
    """Standard deviation added to that of a place, along each axis."""
    max_turn_std_rad: float = Field(default=0.26, gt=0.0)
    """Largest standard deviation of the rotation, 15°: beyond it the tool has not moved enough."""
    pose_std_m: float = Field(default=1e-3, gt=0.0)
    """Standard deviation of recorded poses along each axis, where no joints are known: cables stretch."""
    correlation_time_s: float = Field(default=0.5, gt=0.0)
    """How long errors of a detection and play of joints last: between two reversals of a joint."""


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


class TissueTrackingSettings(MethodSettings):
    """How the tissue's pose is averaged over frames, and when it counts as moved."""

    moved_count: int = Field(default=5, ge=1)
    """So many poses in a row away from the remembered one mean that the tissue has moved: one or two are wild."""
    min_scatter_count: float = Field(default=4.0, ge=2.0)
    """Fewer poses do not tell how much they scatter beyond their stated covariance."""
    memory_count: float = Field(default=15.0, gt=1.0)
    """Poses older than as many fade (by 1/15 a frame), so that tissue that creeps or breathes is followed."""
    shape_count: int = Field(default=8, ge=1)
    """So many views of the dome's shape are taken first, then one in as many frames: all of them err nearly alike."""
    gate_z: float = Field(default=3.09, gt=0.0)
    """Normal quantile of the gate for a pose against the remembered one: 1 in 1,000 true ones is refused."""
    lasting_height_share: float = Field(default=0.98, ge=0.0, lt=1.0)
    """Part of a stereo surface's deviation by which all of it is off for as long as it shows the same texture. Of six
    logs with wet, breathing tissue in light from the endoscope's tip, heights scatter by 0.10 to 0.20 of the stated
    deviation from frame to frame: a share of 0.98 leaves 0.20."""
    height_correlation_time_s: float = Field(default=30.0, gt=0.0)
    """How long that lasts: longer than the logs of 8 s that it was seen in."""


class Settings(StrictModel):
    """All settings, a group for each detector or estimator; a profile may set any of them."""

    interlace: InterlaceSettings = InterlaceSettings()
    exposure: ExposureSettings = ExposureSettings()
    auto: AutoSettings = AutoSettings()
    outline: OutlineSettings = OutlineSettings()
    marker: MarkerSettings = MarkerSettings()
    shaft: ShaftSettings = ShaftSettings()
    silhouette: SilhouetteSettings = SilhouetteSettings()
    distal_marker: DistalMarkerSettings = DistalMarkerSettings()
    stereo: StereoSettings = StereoSettings()
    tag: TagSettings = TagSettings()
    filter: FilterSettings = FilterSettings()
    fused: FusedSettings = FusedSettings()
    hand_eye: HandEyeSettings = HandEyeSettings()
    association: AssociationSettings = AssociationSettings()
    tissue: TissueTrackingSettings = TissueTrackingSettings()
