"""Series: what a method gave over time for one instrument of one log, beside the truth where there is one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svmdist.errors import KinematicsError, RecordingError
from svmdist.estimation.lag import LagEstimate
from svmdist.recording.log import Recording
from svmdist.results import Z_95, FrameResult
from svmdist.tracks import SampledDistances
from svmdist.transforms import Array
from svmdist.workflows.estimate import Measured
from svmdist.workflows.references import Reference, TruthRules, distance_truth
from svmdist.workflows.request import Request, Setup
from svmdist.workflows.scores import CLEARANCE, PLANAR, SPATIAL, Distance, truth_lag_ns

PREFERRED = (CLEARANCE, SPATIAL, PLANAR)


@dataclass(frozen=True)
class Series:
    """One of the three distances over the frames of a log, shape (n,) each; NaN for what does not exist.

    `number` counts the images of the log from 0, `seconds` from the first one. `tool_px`, shape (n, 2), is where the
    tool was seen. `reference` says what the truth is, None where there is none.
    """

    recording: str
    instrument: str
    method: str
    distance: str
    number: NDArray[np.int64]
    stamps_ns: NDArray[np.int64]
    seconds: Array
    status: tuple[str, ...]
    detail: tuple[str, ...]
    estimate_m: Array
    std_m: Array
    truth_m: Array
    tool_px: Array
    consistency: Array
    reference: Reference | None = None

    def __len__(self) -> int:
        return len(self.number)

    @property
    def measured(self) -> NDArray[np.bool_]:
        """Which frames have the distance."""
        return np.isfinite(self.estimate_m)

    @property
    def error_m(self) -> Array:
        """Estimate less truth; NaN without either."""
        return np.asarray(self.estimate_m - self.truth_m)

    @property
    def half_m(self) -> Array:
        """Half of the stated 95 % interval."""
        return np.asarray(Z_95 * self.std_m)

    @property
    def badness_m(self) -> Array:
        """How bad each frame is: its error where there is truth, else the interval's width; -1 where it has neither."""
        badness_m = np.abs(self.error_m)
        if not np.isfinite(badness_m).any():
            badness_m = self.half_m
        return np.asarray(np.where(np.isfinite(badness_m), badness_m, -1.0))


@dataclass(frozen=True, slots=True)
class WorstFrame:
    """One of the worst frames of a log: its place in a series, and how bad it is."""

    at: int
    series: Series
    badness_m: float

    @property
    def number(self) -> int:
        """Its image's number in the log."""
        return int(self.series.number[self.at])

    @property
    def in_words(self) -> str:
        """What is bad about it, for a person."""
        series, at = self.series, self.at
        where = f"frame {self.number} at {series.seconds[at]:.2f} s, {series.instrument}"
        if not series.measured[at]:
            detail = f" ({series.detail[at]})" if series.detail[at] else ""
            return f"{where}: not measured: {series.status[at]}{detail}"
        interval = f"interval ±{series.half_m[at] * 1e3:.2f} mm" if np.isfinite(series.half_m[at]) else ""
        if np.isfinite(series.error_m[at]):
            error = f"{where}: {series.distance} error {series.error_m[at] * 1e3:+.2f} mm"
            return f"{error}, {interval}" if interval else error
        return f"{where}: {series.distance} {interval or f'{series.estimate_m[at] * 1e3:.2f} mm'}"


def worst_frames(series: Sequence[Series], count: int) -> list[WorstFrame]:
    """The worst frames of several logs and instruments, each image once, the worst first."""
    frames = [
        WorstFrame(at, one, badness_m)
        for one in series
        for at, badness_m in enumerate(one.badness_m.tolist())
    ]
    worst: dict[tuple[str, int], WorstFrame] = {}
    for frame in sorted(frames, key=lambda frame: -frame.badness_m):
        worst.setdefault((frame.series.recording, frame.number), frame)
    return list(worst.values())[:count]


def series_of(
    measured: Iterable[Measured], request: Request, reference: Reference | None = None
) -> list[Series]:
    """The series of several recordings."""
    setup, rules = request.setup, request.rules
    return [
        made
        for one in measured
        for made in make_series(one.rows, one.recording, setup, rules, reference, one.lag)
    ]


def make_series(
    rows: Sequence[FrameResult],
    recording: Recording,
    setup: Setup,
    rules: TruthRules | None = None,
    reference: Reference | None = None,
    lag: LagEstimate | None = None,
) -> list[Series]:
    """A series for each instrument of the rows of one recording, in which every image has a row per instrument.

    The distance is the clearance where there is any, else the spatial, else the planar one. The truth is by
    `reference`; None takes the simulator's truth where the log has it. `lag` is taken off the stamps of images before.
    """
    found = []
    for name in dict.fromkeys(row.instrument for row in rows):
        own = [row for row in rows if row.instrument == name]
        view, seen = recording.for_instrument(name), setup.for_instrument(name)
        asked = reference or Reference.GROUND_TRUTH
        stamps_ns = np.array([row.stamp_ns for row in own], np.int64)
        at_ns = stamps_ns - truth_lag_ns(view, seen, asked, lag)
        truth: SampledDistances | None = None
        try:
            truth = distance_truth(view, seen.profile, asked, at_ns, seen.equations, rules)
        except (RecordingError, KinematicsError):
            if reference is not None:
                raise
        distance = _most_telling(own, truth)
        read = np.array([distance.read(row) if row.measured else (np.nan, np.nan) for row in own])
        truth_m = np.full(len(own), np.nan)
        if truth is not None:
            truth_m = np.where(truth.valid, distance.truth_of(truth), np.nan)
        found.append(
            Series(
                recording=recording.name,
                instrument=name,
                method=seen.method,
                distance=distance.name,
                number=np.array([row.number for row in own], np.int64),
                stamps_ns=stamps_ns,
                seconds=np.array([row.seconds for row in own]),
                status=tuple(str(row.status) for row in own),
                detail=tuple(row.detail for row in own),
                estimate_m=read[:, 0],
                std_m=read[:, 1],
                truth_m=truth_m,
                tool_px=np.array([row.image.tool_px or (np.nan, np.nan) for row in own]),
                consistency=np.array([np.nan if row.consistency is None else row.consistency for row in own]),
                reference=None if truth is None else asked,
            )
        )
    return found


def _most_telling(rows: Sequence[FrameResult], truth: SampledDistances | None) -> Distance:
    for distance in PREFERRED:
        has_values = any(row.measured and distance.of(row.distances) is not None for row in rows)
        if has_values and (truth is None or np.isfinite(distance.truth_of(truth)[truth.valid]).any()):
            return distance
    return PLANAR
