"""Settings of `method = "auto"`: what instruments look like, whatever their colour."""

from __future__ import annotations

from pydantic import Field

from svmdist.settings.base import MethodSettings


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
