"""Blur bench: Table I made reproducible, the same frames degraded in every way and measured each time."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from svmdist.errors import RecordingError
from svmdist.estimation.frame import Frame
from svmdist.recording.log import Recording
from svmdist.results import FrameResult
from svmdist.vision.colour import to_grey
from svmdist.vision.degradations import Blur
from svmdist.vision.marker import EDGE_MARGIN_PX, detect_orb, paste_marker
from svmdist.vision.regions import find_region
from svmdist.workflows.parallel import Steps
from svmdist.workflows.replay import replay
from svmdist.workflows.request import BlurCondition, Request
from svmdist.workflows.scoring.references import Truth
from svmdist.workflows.scoring.scores import Readings

DEFAULT_KERNELS_PX: Mapping[Blur, int] = {
    Blur.NONE: 1,
    Blur.EROSION: 3,
    Blur.DILATION: 3,
    Blur.GAUSSIAN: 5,
    Blur.MEDIAN: 5,
    Blur.BILATERAL: 9,
}
"""The paper states no kernels. These are the smallest usual ones: an instrument region is some 15 px across."""


@dataclass(frozen=True, slots=True)
class PrintedRow:
    """A row of the paper's Table I, as published."""

    keypoint_count: int
    contour_area_px: int


MEANS = ("keypoint_count", "contour_area_px", "marker_keypoint_count", "match_count", "inlier_count")
TABLE_I: Mapping[Blur, PrintedRow] = {
    Blur.EROSION: PrintedRow(7, 221),
    Blur.DILATION: PrintedRow(2, 219),
    Blur.GAUSSIAN: PrintedRow(7, 215),
    Blur.MEDIAN: PrintedRow(3, 215),
    Blur.BILATERAL: PrintedRow(3, 218),
}


@dataclass(frozen=True, slots=True)
class BlurRow:
    """One blur over all frames, means where they exist; features and area of the instrument alone come first."""

    blur: Blur
    kernel_px: int
    frame_count: int
    keypoint_count: float | None
    contour_area_px: float | None
    marker_keypoint_count: float | None
    match_count: float | None
    inlier_count: float | None
    coverage: float
    rmse_m: float | None
    printed: PrintedRow | None


@dataclass
class BlurTally:
    """What one blur collects over the frames of a log: `values` by the column that has their mean."""

    frame_count: int = 0
    measured_count: int = 0
    values: dict[str, list[float]] = field(default_factory=lambda: {name: [] for name in MEANS})
    squared_errors_m2: list[float] = field(default_factory=list)


def blur_tallies(
    recording: Recording,
    request: Request,
    jobs: int | None,
    kernels_px: Mapping[Blur, int],
    steps: Steps | None = None,
) -> dict[Blur, BlurTally]:
    """Degrade each frame by every blur, paste the marker behind it, measure and count; an image is a step."""
    tallies = {blur: BlurTally() for blur in kernels_px}
    readings = {blur: Readings() for blur in kernels_px}
    conditions = [BlurCondition(blur, kernel_px) for blur, kernel_px in kernels_px.items()]
    steps = steps or Steps()
    steps.total, first = recording.image_count(), recording.instruments[:1]
    for replayed in steps.of(replay(recording, [request.setup], conditions, wanted=first, jobs=jobs)):
        for blur, lane in zip(kernels_px, replayed, strict=True):
            (result,) = lane.results
            readings[blur].add(result)
            for frame in lane.frames:
                _count(frame, result, tallies[blur].values)
    truth = recording.distance_track()
    for blur, found in readings.items():
        tallies[blur].frame_count = len(found)
        tallies[blur].measured_count = len(found) - found.rejected.total()
        pairs = found.pairs("planar", Truth(truth.at(found.stamps_ns).values))
        tallies[blur].squared_errors_m2 = ((pairs.estimate_m - pairs.truth_m) ** 2).tolist()
    return tallies


def blur_rows(parts: Sequence[Mapping[Blur, BlurTally]], kernels_px: Mapping[Blur, int]) -> list[BlurRow]:
    """A row a blur, over all recordings; RecordingError where there is no image."""
    found = []
    for blur, kernel_px in kernels_px.items():
        tallies = [part[blur] for part in parts]
        frame_count = sum(tally.frame_count for tally in tallies)
        if not frame_count:
            raise RecordingError("there is no image to measure in these recordings")
        mse_m2 = _mean([square for tally in tallies for square in tally.squared_errors_m2])
        found.append(
            BlurRow(
                blur=blur,
                kernel_px=kernel_px,
                frame_count=frame_count,
                coverage=sum(tally.measured_count for tally in tallies) / frame_count,
                rmse_m=None if mse_m2 is None else math.sqrt(mse_m2),
                printed=TABLE_I.get(blur),
                **{name: _mean([v for tally in tallies for v in tally.values[name]]) for name in MEANS},
            )
        )
    return found


def _mean(values: Sequence[float]) -> float | None:
    return float(np.mean(values)) if values else None


def _count(frame: Frame, result: FrameResult, values: dict[str, list[float]]) -> None:
    profile, masks, context = frame.arm.profile, frame.left.masks_as_recorded, frame.left.context
    instrument = find_region(masks.instrument, profile.segmentation.instrument, profile.settings.outline)
    if instrument is None:
        return
    size_px, feature_count = profile.marker.size_px, profile.features.feature_count
    marked = paste_marker(context.bgr_as_recorded, instrument.centroid_px, size_px, EDGE_MARGIN_PX)
    points_px = detect_orb(to_grey(marked.window_bgr), feature_count).points_px - EDGE_MARGIN_PX
    counts = (
        len(detect_orb(context.grey, feature_count, masks.instrument)),
        instrument.area_px,
        np.count_nonzero(np.all((points_px >= 0) & (points_px < size_px), axis=1)),
        result.image.match_count,
        result.image.inlier_count,
    )
    for name, count in zip(MEANS, counts, strict=True):
        if count is not None:
            values[name].append(int(count))
