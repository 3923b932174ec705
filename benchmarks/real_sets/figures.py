"""Figures of one set: a row per method, and the lines of a table."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from svmdist.estimation.hand_eye import rigid_fit
from svmdist.recording.log import Recording
from svmdist.results import FrameResult
from svmdist.samples import Image, ImageSample
from svmdist.transforms import Array, transform_points

CHI_95, CHI_5_STD = 7.81, 31.8
"""Squares of normalised errors of 3 degrees of freedom: 95 %, and what five deviations of one are as unlikely as."""
ESTIMATE, REFERENCE = (60, 220, 255), (80, 255, 80)


@dataclass(frozen=True)
class SetFigures:
    """A set's title, the names of its columns, and a row for each method."""

    title: str
    columns: tuple[str, ...]
    rows: list[tuple[str, ...]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def lines(self) -> Iterator[str]:
        """The set as Markdown."""
        yield f"### {self.title}"
        yield ""
        yield f"| {' | '.join(self.columns)} |"
        yield "|" + "---|" * len(self.columns)
        for row in self.rows:
            yield f"| {' | '.join(row)} |"
        for note in self.notes:
            yield ""
            yield note


def number(values: Array, percentile: float = 50.0, digits: int = 2) -> str:
    """A percentile of values, a dash where there is none."""
    return f"{np.percentile(values, percentile):.{digits}f}" if len(values) else "–"


def share(values: NDArray[np.bool_]) -> str:
    """How many of truth values hold, in percent."""
    return f"{100.0 * float(np.mean(values)):.0f} %" if len(values) else "–"


def measured(rows: Sequence[FrameResult]) -> list[FrameResult]:
    """The rows with a distance and a tool."""
    return [row for row in rows if row.measured and row.tool is not None]


def normalised(rows: Sequence[FrameResult], errors_m: Array, reference: Array) -> Array:
    """Squared errors (n, 3) over the stated covariance with the reference's own, (n, 3, 3) in m²."""
    found = []
    for row, error, covariance in zip(rows, errors_m, reference, strict=True):
        assert row.tool is not None
        S = row.tool.pose.position_covariance + covariance
        found.append(float(error @ np.linalg.solve(S, error)))
    return np.array(found)


def after_rigid_fit(places_m: Array, reference_m: Array) -> Array:
    """Distances in m of places (n, 3) from a reference in another frame, after a rigid fit of least distances."""
    weights = np.ones(len(places_m))
    off_m = np.zeros(len(places_m))
    for _ in range(10):
        T = rigid_fit(places_m, reference_m, weights)
        off_m = np.linalg.norm(transform_points(T, reference_m) - places_m, axis=1)
        weights = 1.0 / np.maximum(off_m, max(float(np.median(off_m)), 1e-6))
    return off_m


def draw_overlays(
    recording: Recording,
    rows: Sequence[FrameResult],
    references: dict[int, list[Array]],
    path: Path,
    every: int,
) -> None:
    """Draw where each instrument was found, and its reference by stamp, on every nth left image."""
    path.parent.mkdir(parents=True, exist_ok=True)
    by_stamp: dict[int, list[FrameResult]] = {}
    for row in rows:
        by_stamp.setdefault(row.stamp_ns, []).append(row)
    for place, image in enumerate(recording.images()):
        if place % every or not isinstance(image, ImageSample):
            continue
        pixels = np.array(image.image_bgr)
        for px in references.get(image.stamp_ns, []):
            _cross(pixels, px, REFERENCE)
        for row in by_stamp.get(image.stamp_ns, []):
            if row.measured and row.image.tool_px is not None:
                _cross(pixels, np.array(row.image.tool_px), ESTIMATE)
        cv2.imwrite(str(path.with_name(f"{path.name}-{place:03d}.png")), pixels)


def _cross(pixels: Image, px: Array, colour: tuple[int, int, int]) -> None:
    cv2.drawMarker(pixels, (round(px[0]), round(px[1])), colour, cv2.MARKER_CROSS, 16, 2, cv2.LINE_AA)
