"""Settings of matching the two views of a stereo pair."""

from __future__ import annotations

from pydantic import Field

from svmdist.settings.base import MethodSettings


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
