"""Blur bench: Table I made reproducible, the same frames degraded in every way and measured each time."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from svmdist.errors import RecordingError
from svmdist.estimation.frame import Frame
from svmdist.recording.log import Recording
from svmdist.results import FrameResult
from svmdist.vision.colour import to_grey
from svmdist.vision.degradations import Blur
from svmdist.vision.marker import EDGE_MARGIN_PX, detect_orb, paste_marker
from svmdist.workflows.parallel import Steps
from svmdist.workflows.replay import replay
from svmdist.workflows.request import Condition, Request
from svmdist.workflows.scoring.references import Truth
from svmdist.workflows.scoring.scores import Figures, Readings, figures_of, pooled_figures

DEFAULT_KERNELS_PX: Mapping[Blur, int] = {
    Blur.NONE: 1,
    Blur.EROSION: 3,
    Blur.DILATION: 3,
    Blur.GAUSSIAN: 5,
    Blur.MEDIAN: 5,
    Blur.BILATERAL: 9,
}
"""The paper states no kernels. These are the smallest usual ones: an instrument region is some 15 px across."""


MEANS = ("keypoint_count", "contour_area_px", "marker_keypoint_count", "match_count", "inlier_count")
"""What is counted in each frame: features and area of the instrument alone come first, as in Table I."""
TABLE_I: Mapping[Blur, tuple[int, int]] = {
    Blur.EROSION: (7, 221),
    Blur.DILATION: (2, 219),
    Blur.GAUSSIAN: (7, 215),
    Blur.MEDIAN: (3, 215),
    Blur.BILATERAL: (3, 218),
}
"""The paper's Table I as published: features, and the contour's area in px."""


@dataclass(frozen=True)
class BlurTally:
    """What one blur did to the frames of a log: its figures, and the counts of each frame by the names in `MEANS`."""

    figures: Figures
    counts: dict[str, list[int]]


def blur_tallies(
    recording: Recording,
    request: Request,
    jobs: int | None,
    kernels_px: Mapping[Blur, int],
    steps: Steps | None = None,
) -> dict[Blur, BlurTally]:
    """Degrade each frame by every blur, paste the marker behind it, measure and count; an image is a step."""
    counts: dict[Blur, dict[str, list[int]]] = {blur: {name: [] for name in MEANS} for blur in kernels_px}
    readings = {blur: Readings() for blur in kernels_px}
    conditions = [Condition(blur, kernel_px) for blur, kernel_px in kernels_px.items()]
    steps = steps or Steps()
    steps.total, first = recording.image_count(), recording.instruments[:1]
    for replayed in steps.of(replay(recording, [request.setup], conditions, wanted=first, jobs=jobs)):
        for blur, lane in zip(kernels_px, replayed, strict=True):
            (result,) = lane.results
            readings[blur].add(result)
            for frame in lane.frames:
                _count(frame, result, counts[blur])
    track = recording.distance_track()
    return {
        blur: BlurTally(figures_of(rows, Truth(track.at(rows.stamps_ns).values)), counts[blur])
        for blur, rows in readings.items()
    }


def blur_rows(
    parts: Sequence[Mapping[Blur, BlurTally]], kernels_px: Mapping[Blur, int]
) -> list[dict[str, str | float | None]]:
    """A row a blur, over all recordings, by its columns; RecordingError where there is no image."""
    rows: list[dict[str, str | float | None]] = []
    for blur, kernel_px in kernels_px.items():
        tallies = [part[blur] for part in parts]
        figures = pooled_figures([tally.figures for tally in tallies])
        if not figures.frame_count:
            raise RecordingError("there is no image to measure in these recordings")
        counts = {name: [count for tally in tallies for count in tally.counts[name]] for name in MEANS}
        paper_count, paper_area_px = TABLE_I.get(blur, (None, None))
        rows.append(
            {
                "blur": blur,
                "kernel_px": kernel_px,
                **{name: float(np.mean(of)) if of else None for name, of in counts.items()},
                "coverage": figures.coverage,
                "rmse_m": figures.planar.statistics.rmse if figures.planar else None,
                "frame_count": figures.frame_count,
                "paper_keypoint_count": paper_count,
                "paper_contour_area_px": paper_area_px,
            }
        )
    return rows


def _count(frame: Frame, result: FrameResult, values: dict[str, list[int]]) -> None:
    profile, context = frame.arm.profile, frame.left.context
    _, instrument = frame.left.regions_as_recorded
    if instrument is None:
        return
    size_px, feature_count = profile.marker.size_px, profile.features.feature_count
    marked_bgr, _ = paste_marker(context.bgr_as_recorded, instrument.centroid_px, size_px, EDGE_MARGIN_PX)
    points_px = detect_orb(to_grey(marked_bgr), feature_count).points_px - EDGE_MARGIN_PX
    counts = (
        len(detect_orb(context.grey, feature_count, frame.left.masks_as_recorded.instrument)),
        instrument.area_px,
        np.count_nonzero(np.all((points_px >= 0) & (points_px < size_px), axis=1)),
        result.image.match_count,
        result.image.inlier_count,
    )
    for name, count in zip(MEANS, counts, strict=True):
        if count is not None:
            values[name].append(int(count))
