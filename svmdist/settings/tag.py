"""Settings of detecting a fiducial tag and refining its pose."""

from __future__ import annotations

from pydantic import Field

from svmdist.settings.base import MethodSettings


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
