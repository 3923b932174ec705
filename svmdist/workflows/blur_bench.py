"""Blur bench: Table I made reproducible, the same frames degraded in every way and measured each time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from svmdist.recording.log import Recording
from svmdist.vision.colour import to_grey
from svmdist.vision.degradations import Blur
from svmdist.vision.marker import EDGE_MARGIN_PX, detect_orb, paste_marker
from svmdist.workflows.replay import Replayed, replay
from svmdist.workflows.request import Condition, Request
from svmdist.workflows.scoring.references import Truth
from svmdist.workflows.scoring.scores import Figures, Readings, figures_of, pooled_figures

TABLE_I: Mapping[Blur, tuple[int, tuple[int, int] | None]] = {
    Blur.NONE: (1, None),
    Blur.EROSION: (3, (7, 221)),
    Blur.DILATION: (3, (2, 219)),
    Blur.GAUSSIAN: (5, (7, 215)),
    Blur.MEDIAN: (5, (3, 215)),
    Blur.BILATERAL: (9, (3, 218)),
}
"""Each blur's kernel in px, and its row in the paper as published: features, and the contour's area in px.

The paper states no kernels. These are the smallest usual ones: an instrument region is some 15 px across.
"""

Counts = tuple[int | None, int | None, int | None, int | None, int | None]
"""Keypoints and area in px of the instrument alone; keypoints in the marker's window, matches and inliers."""


@dataclass(frozen=True)
class BlurTally:
    """What one blur did to the frames of a log, or of several: figures, and the counts of each frame."""

    blur: Blur
    kernel_px: int
    figures: Figures
    counts: list[Counts]

    @property
    def means(self) -> list[float | None]:
        """The mean of each count over the frames that have it; None where none has."""
        known = [[count for count in of if count is not None] for of in zip(*self.counts, strict=True)]
        return [float(np.mean(of)) if of else None for of in known]

    @property
    def published(self) -> tuple[int, int] | None:
        """The row of the paper's Table I; None where it has none."""
        return TABLE_I[self.blur][1]


def blur_tallies(
    recording: Recording, request: Request, jobs: int | None, kernels_px: Mapping[Blur, int]
) -> list[BlurTally]:
    """Degrade each frame by every blur, paste the marker behind it, measure and count."""
    readings = {blur: Readings() for blur in kernels_px}
    counts: dict[Blur, list[Counts]] = {blur: [] for blur in kernels_px}
    conditions = [Condition(blur, kernel_px) for blur, kernel_px in kernels_px.items()]
    recording = replace(recording, wanted=recording.instruments[:1])
    for replayed in replay(recording, [request.setup], conditions, jobs=jobs):
        for blur, one in zip(kernels_px, replayed, strict=True):
            readings[blur].add(one.results[0])
            counts[blur].append(_counts(one))
    track, tallies = recording.distance_track(), []
    for blur, rows in readings.items():
        figures = figures_of(rows, Truth(track.at(rows.stamps_ns).values))
        tallies.append(BlurTally(blur, kernels_px[blur], figures, counts[blur]))
    return tallies


def pooled_tallies(parts: Sequence[Sequence[BlurTally]]) -> list[BlurTally]:
    """The tallies of several recordings together, by blur."""
    pooled = []
    for of_blur in zip(*parts, strict=True):
        figures = pooled_figures([one.figures for one in of_blur])
        pooled.append(replace(of_blur[0], figures=figures, counts=[frame for one in of_blur for frame in one.counts]))
    return pooled


def _counts(one: Replayed) -> Counts:
    """The counts of one image; None of one that could not be read, or without an instrument."""
    instrument = one.frames[0].left.regions_as_recorded[1] if one.frames else None
    if instrument is None:
        return (None,) * 5
    (frame,), (result,) = one.frames, one.results
    profile, context = frame.arm.profile, frame.left.context
    size_px, feature_count = profile.marker.size_px, profile.features.feature_count
    marked_bgr, _ = paste_marker(context.bgr_as_recorded, instrument.centroid_px, size_px, EDGE_MARGIN_PX)
    points_px = detect_orb(to_grey(marked_bgr), feature_count).points_px - EDGE_MARGIN_PX
    return (
        len(detect_orb(context.grey, feature_count, frame.left.masks_as_recorded.instrument)),
        instrument.area_px,
        int(np.count_nonzero(np.all((points_px >= 0) & (points_px < size_px), axis=1))),
        result.image.match_count,
        result.image.inlier_count,
    )
