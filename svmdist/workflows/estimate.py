"""Estimate: the rows of one log, after the time offset of its images; how they ended, in words; and over time."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from svmdist.camera import Camera
from svmdist.errors import KinematicsError, RecordingError
from svmdist.estimation.alarms import AlarmRules
from svmdist.estimation.alignment import estimate_lag
from svmdist.estimation.plane_mapping import PUBLISHED_MAPPING
from svmdist.recording.log import Recording
from svmdist.results import Z_95, AlarmEvent, FrameResult
from svmdist.samples import Status
from svmdist.tracks import LagEstimate, Mask
from svmdist.transforms import Array, Stamps
from svmdist.workflows.replay import replay
from svmdist.workflows.request import Lag, Request, Setup
from svmdist.workflows.scoring import references
from svmdist.workflows.scoring.references import PoseAt, Reference, TruthRules
from svmdist.workflows.scoring.scores import DISTANCES, Readings

FOUND_LAG_STD_S = 0.01
"""The middle of an instrument that enters the image or is partly hidden moves otherwise than its tool: lags that are
found on six seconds of such a log are off by as much, beside what noise does."""
MAX_REMARKS = 6  # lines
APART_S = 1.0  # between two of the worst frames


@dataclass(frozen=True)
class Measured:
    """The rows of one recording, the recording as it is and as methods read it, and the lag that was applied."""

    recording: Recording
    read: Recording
    rows: tuple[FrameResult, ...]
    lag: LagEstimate | None
    by: Mapping[tuple[Reference, str], Readings] = field(default_factory=dict)
    """What was measured in the same pass as a truth, by reference and instrument."""


Keep = Callable[[Measured], None]  # is called with all rows of a recording, where something is made of them together


def estimate(
    recording: Recording, setup: Setup, jobs: int | None = None, *, rest: bool = True, alarms: AlarmRules | None = None
) -> Iterator[FrameResult]:
    """One result per image and wanted instrument, in order; of an image that cannot be decoded its rejection."""
    results = replay(recording, [setup], jobs=jobs, rest=rest, alarms=alarms)
    return (result for (replayed,) in results for result in replayed.results)


def with_lag(recording: Recording, request: Request, jobs: int | None = None) -> tuple[Recording, LagEstimate]:
    """Apply the time offset of a request; `auto` is one pass over the images."""
    found = given_lag(request.lag)
    if request.lag == "auto":
        # From the middle of each instrument in the image, whatever the method: nothing of the joints is in that. Of
        # several instruments, which share a clock, the most confident one counts.
        seen = Setup(request.setup.profile, "centroid", mapping=PUBLISHED_MAPPING)
        readings = {name: Readings() for name in recording.measured}
        for result in estimate(recording, seen, jobs):
            readings[result.instrument].add(result)
        each = [recording_lag(rows, recording.for_instrument(name), request.rules) for name, rows in readings.items()]
        found = max(each, key=lambda one: (one.is_observable, one.confidence))
    if request.lag is None or not found.is_observable:
        return recording, found
    std_s = 0.0 if found.std_s is None else float(np.hypot(found.std_s, FOUND_LAG_STD_S))
    return replace(recording, lag=replace(found, std_s=std_s)), found


def given_lag(lag: Lag | None) -> LagEstimate:
    """A time offset as the user states it; 0 for `auto`, until it is found."""
    return LagEstimate(0.0 if lag is None or lag == "auto" else float(lag), None, 1.0)


def recording_lag(readings: Readings, log: Recording, rules: TruthRules) -> LagEstimate:
    """Estimate the lag of a recording from where its measured rows saw the tool, by kinematics or another reference."""
    seen = np.isfinite(readings.tool_px).all(axis=1)
    problems = []
    for reference in (Reference.KINEMATICS, Reference.POSE, Reference.TF, Reference.GROUND_TRUTH):
        try:
            at = references.tool_track(log, reference, rules)
        except (RecordingError, KinematicsError) as problem:
            problems.append(str(problem))
            continue
        predict = partial(predicted_tool_px, at, log.camera)
        return estimate_lag(readings.stamps_ns[seen], readings.tool_px[seen], predict)
    return LagEstimate(0.0, None, 0.0, f"the log has no motion of the tool but in its images: {problems[0]}")


def predicted_tool_px(at: PoseAt, camera: Camera, stamps_ns: Stamps) -> tuple[Array, Mask]:
    """Project the tool's origin by poses `T_camera_tool` into the image: pixels, shape (n, 2), and which are known."""
    pose = at(stamps_ns)
    p_camera_m = pose.values[:, :3, 3]
    known = pose.valid & (np.where(pose.valid, p_camera_m[:, 2], 0.0) > 1e-3)
    predicted = np.full((len(stamps_ns), 2), np.nan)
    predicted[known] = camera.project(p_camera_m[known])
    return predicted, known


@dataclass
class Ending:
    """Counts over the rows of a log, and its alarms."""

    counts: dict[str, Counter[str]] = field(default_factory=dict)  # by status and detail, as these first came
    seen: Counter[str] = field(default_factory=Counter)  # rows in which a detection was measured,
    refused: Counter[str] = field(default_factory=Counter)  # and in which it contradicted the rest
    events: dict[str, dict[int, AlarmEvent]] = field(default_factory=dict)  # by instrument and first image
    remarks: list[str] = field(default_factory=list)  # on the recording
    least: FrameResult | None = None  # the row of the smallest clearance

    @classmethod
    def of(cls, rows: Iterable[FrameResult], remarks: Iterable[str] = ()) -> Ending:
        """The ending of all rows of a log, and what is remarked on it."""
        ending = cls(remarks=list(remarks))
        for row in rows:
            ending.add(row)
        return ending

    def add(self, row: FrameResult) -> None:
        """Count a row."""
        self.counts.setdefault(str(row.status), Counter())[row.detail] += 1
        least = None if self.least is None else self.least.distances.clearance
        found = row.distances.clearance if row.measured else None
        if found is not None and (least is None or found.value_m < least.value_m):
            self.least = row
        self.seen.update((*row.accepted, *row.refused))
        self.refused.update(row.refused)
        events = self.events.setdefault(row.instrument, {})
        if (event := row.alarm.event) is not None:
            events[event.start_number] = event

    @property
    def alarms(self) -> list[AlarmEvent]:
        """The alarms of all instruments in the order of time."""
        every = (event for events in self.events.values() for event in events.values())
        return sorted(every, key=lambda event: event.start_s)

    @property
    def least_in_words(self) -> str:
        """The smallest clearance, with its interval, and where it is; raises ValueError without any."""
        if self.least is None or (clearance := self.least.distances.clearance) is None:
            raise ValueError("no clearance was measured")
        half = "" if clearance.half_m is None else f" ± {clearance.half_m * 1e3:.2f}"
        return (
            f"smallest clearance {clearance.value_m * 1e3:z.2f}{half} mm at {self.least.seconds:.2f} s"
            f" (frame {self.least.number}, {self.least.instrument})"
        )

    @property
    def statuses(self) -> dict[str, int]:
        """The counts by status."""
        return {status: details.total() for status, details in self.counts.items()}


def refusals_in_words(endings: Iterable[Ending]) -> Iterator[str]:
    """One text for each detection that was refused anywhere, the most refused one first."""
    seen, refused = Counter[str](), Counter[str]()
    for one in endings:
        seen.update(one.seen)
        refused.update(one.refused)
    # It contradicts those that were refused in less than half of their rows, and nominal kinematics else.
    inliers = [name for name in seen if 2 * refused[name] < seen[name]]
    for name, count in refused.most_common():
        others = [one for one in inliers if one != name] or ["the joints"]
        listed = " and ".join(filter(None, (", ".join(others[:-1]), others[-1])))
        yield f"{name} refused in {count} of {seen[name]} frames: it contradicts {listed}"


def endings_in_words(endings: Mapping[str, Ending], rules: AlarmRules | None) -> Iterator[str]:
    """Which detections were refused, what is remarked on logs, of many the first few, and alarms, by logs' names."""
    yield from refusals_in_words(endings.values())
    every = [(log, line) for log, one in endings.items() for line in one.remarks]
    for log, line in every[:MAX_REMARKS]:
        yield f"{log}: {line}" if len(endings) > 1 else line
    if more := {log for log, _ in every[MAX_REMARKS:]}:
        yield f"the like of {len(more)} more logs"
    if rules is not None:
        yield alarms_in_words(endings, rules)


def alarms_in_words(endings: Mapping[str, Ending], rules: AlarmRules) -> str:
    """How many alarms logs had, and the first and the longest of them."""
    every = [(log, event) for log, one in endings.items() for event in one.alarms]
    instruments = {event.instrument for _, event in every}

    def where(log: str, event: AlarmEvent) -> str:
        names = [log] * (len(endings) > 1) + [event.instrument] * (len(instruments) > 1)
        return f"({' '.join(names)}{', ' * bool(names)}frame {event.start_number})"

    said = f"{len(every) or 'no'} alarm{'s' * (len(every) > 1)} ({rules.in_words})"
    if every:
        longest = max(every, key=lambda one: one[1].duration_s)
        said += f": first at {every[0][1].start_s:.2f} s {where(*every[0])}"
        said += f", longest {longest[1].duration_s:.2f} s {where(*longest)}"
    lost = (count for one in endings.values() for status, count in one.statuses.items() if status != Status.OK)
    if count := sum(lost):
        said += f"; {count} frames without a clearance raise none, which does not make them safe"
    return said


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
    def severity_m(self) -> Array:
        """Of each frame, its error where there is truth, else the interval's width; -1 where it has neither."""
        severity_m = np.abs(self.error_m) if np.isfinite(self.error_m).any() else self.half_m
        return np.asarray(np.where(np.isfinite(severity_m), severity_m, -1.0))


@dataclass(frozen=True, slots=True)
class WorstFrame:
    """One of the worst frames of a log: its place in a series, and its severity."""

    series: Series
    at: int
    number: int
    seconds: float
    severity_m: float

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
        columns = one.number.tolist(), one.seconds.tolist(), one.severity_m.tolist()
        every += [WorstFrame(one, at, *frame) for at, frame in enumerate(zip(*columns, strict=True))]
    ranked, worst = sorted(every, key=lambda frame: -frame.severity_m), list[WorstFrame]()
    for apart_s in (APART_S, 0.0):
        for frame in ranked:
            of_log = [one for one in worst if one.series.recording == frame.series.recording]
            is_apart = all(one.number != frame.number and abs(one.seconds - frame.seconds) >= apart_s for one in of_log)
            if len(worst) < count and is_apart:
                worst.append(frame)
    return sorted(worst, key=lambda frame: -frame.severity_m)


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
        at_ns = readings.stamps_ns - references.reference_lag_ns(recording, asked, one.lag)
        try:
            by = one.by.get((asked, name))
            truth = by.truth if by else references.truth_at(recording, asked, at_ns, setup.equations, request.rules)
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
