"""Series: what a method gave over time for one instrument of one log, beside the truth where there is one."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from svmdist.errors import KinematicsError, RecordingError
from svmdist.results import Z_95, AlarmEvent
from svmdist.transforms import Array
from svmdist.workflows.ending import Ending
from svmdist.workflows.estimate import Measured
from svmdist.workflows.request import Request
from svmdist.workflows.scoring.references import Reference, reference_lag_ns, truth_at
from svmdist.workflows.scoring.scores import DISTANCES, Readings

APART_S = 1.0  # between two of the worst frames


@dataclass(frozen=True)
class Series:
    """One of the three distances over the frames of a log, shape (n,) each; NaN for what does not exist.

    `number` counts the images of the log from 0, `seconds` from the first one. `tool_px`, shape (n, 2), is where the
    tool was seen; `events` are its alarms, of a clearance below `alarm_below_m`.
    """

    recording: str
    instrument: str
    method: str
    distance: str
    number: NDArray[np.int64]
    seconds: Array
    status: tuple[str, ...]
    detail: tuple[str, ...]
    estimate_m: Array
    std_m: Array
    truth_m: Array
    tool_px: Array
    consistency: Array
    events: Sequence[AlarmEvent] = ()
    alarm_below_m: float | None = None

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
        """Half of the reported 95 % interval."""
        return np.asarray(Z_95 * self.std_m)

    @property
    def badness_m(self) -> Array:
        """How bad each frame is: its error where there is truth, else the interval's width; -1 where it has neither."""
        badness_m = np.abs(self.error_m) if np.isfinite(self.error_m).any() else self.half_m
        return np.asarray(np.where(np.isfinite(badness_m), badness_m, -1.0))


@dataclass(frozen=True, slots=True)
class WorstFrame:
    """One of the worst frames of a log: its place in a series, and how bad it is."""

    series: Series
    at: int
    number: int
    seconds: float
    badness_m: float

    @property
    def in_words(self) -> str:
        """What is bad about it, human-readable."""
        series, at = self.series, self.at
        where = f"frame {self.number} at {self.seconds:.2f} s, {series.instrument}"
        if not series.measured[at]:
            detail = f" ({series.detail[at]})" if series.detail[at] else ""
            return f"{where}: not measured: {series.status[at]}{detail}"
        interval = f"interval ±{series.half_m[at] * 1e3:.2f} mm" if np.isfinite(series.half_m[at]) else ""
        if np.isfinite(series.error_m[at]):
            error = f"error {series.error_m[at] * 1e3:+z.2f} mm"
            return f"{where}: {series.distance} {', '.join(filter(None, (error, interval)))}"
        return f"{where}: {series.distance} {interval or f'{series.estimate_m[at] * 1e3:z.2f} mm'}"


def worst_frames(series: Sequence[Series], count: int) -> list[WorstFrame]:
    """The worst frames of several instruments, the worst first: a second apart, for neighbours show the same.

    Where a log is too short for that many, nearer ones, too; each image once.
    """
    every = list[WorstFrame]()
    for one in series:
        columns = one.number.tolist(), one.seconds.tolist(), one.badness_m.tolist()
        every += [WorstFrame(one, at, *frame) for at, frame in enumerate(zip(*columns, strict=True))]
    ranked, worst = sorted(every, key=lambda frame: -frame.badness_m), list[WorstFrame]()
    for apart_s in (APART_S, 0.0):
        for frame in ranked:
            of_log = [one for one in worst if one.series.recording == frame.series.recording]
            is_apart = all(one.number != frame.number and abs(one.seconds - frame.seconds) >= apart_s for one in of_log)
            if len(worst) < count and is_apart:
                worst.append(frame)
    return sorted(worst, key=lambda frame: -frame.badness_m)


def series_of(measured: Iterable[Measured], request: Request, reference: Reference | None = None) -> list[Series]:
    """A series for each instrument of each recording.

    The distance is the clearance where there is any, else the spatial, else the planar one. The truth is by
    `reference`; None takes the simulator's truth where the log has it. The lag is taken off the stamps of images.
    """
    found, asked = [], reference or Reference.GROUND_TRUTH
    each = [(one, name) for one in measured for name in dict.fromkeys(row.instrument for row in one.rows)]
    for one, name in each:
        rows = [row for row in one.rows if row.instrument == name]
        recording, setup = one.recording.for_instrument(name), request.setup
        readings, truth_m, has_truth = Readings(rows), np.full((len(rows), 3), np.nan), False
        at_ns = readings.stamps_ns - reference_lag_ns(recording, asked, one.lag)
        try:
            by = one.by.get((asked, name))
            truth = by.truth if by else truth_at(recording, asked, at_ns, setup.equations, request.rules)
            truth_m, has_truth = truth.distances_m, True
        except (RecordingError, KinematicsError):
            if reference is not None:
                raise
        found_any = np.array([np.isfinite(readings.distance(of)[0]).any() for of in DISTANCES])
        known = found_any & np.isfinite(truth_m).any(0) if has_truth else found_any
        distance = DISTANCES[max(np.flatnonzero(known), default=0)]  # the last one says most
        series = Series(
            *(recording.name, name, setup.method, distance),
            np.array([row.number for row in rows], np.int64),
            np.array([row.seconds for row in rows]),
            tuple(str(row.status) for row in rows),
            tuple(row.detail for row in rows),
            *readings.distance(distance),
            truth_m[:, DISTANCES.index(distance)],
            np.array([row.image.tool_px or (np.nan, np.nan) for row in rows]),
            np.array([np.nan if row.consistency is None else row.consistency for row in rows]),
            Ending.of(rows).alarms,
            request.alarms.below_m if request.alarms else None,
        )
        found.append(series)
    return found
