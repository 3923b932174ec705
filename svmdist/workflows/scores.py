"""Scores: the estimates of recordings, paired by time with one reference, and their figures."""

from __future__ import annotations

from array import array
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property

import numpy as np

from svmdist import metrics
from svmdist.errors import ProfileError, RecordingError, UsageError
from svmdist.estimation.alarms import AlarmEvent, AlarmRules, AlarmWatch, alarm_events
from svmdist.estimation.lag import LagEstimate
from svmdist.estimation.methods import PLANAR_METHODS, SPATIAL_METHODS
from svmdist.estimation.plane_mapping import Equations
from svmdist.profile import Profile
from svmdist.recording.log import KnownLag, Recording
from svmdist.results import FrameResult
from svmdist.tracks import Sampled
from svmdist.transforms import Array, Stamps
from svmdist.workflows import references
from svmdist.workflows.request import Setup

BOOTSTRAP_SEED = 36
DISTANCES = ("planar", "spatial", "clearance")


@dataclass(frozen=True)
class Pairs:
    """Measured frames with a reference, shape (n,) each: stamps, and estimate, truth and deviation (or NaN) in m."""

    stamps_ns: Stamps
    estimate_m: Array
    truth_m: Array
    std_m: Array

    def __len__(self) -> int:
        return len(self.stamps_ns)


@dataclass(frozen=True, slots=True)
class DistanceScore:
    """Error figures of a distance in m, and the share of truths inside the 95 % interval (None without intervals)."""

    statistics: metrics.ErrorStatistics
    interval_coverage: float | None
    pairs: Pairs = field(repr=False)


class Readings:
    """The numbers that scoring takes from rows, collected as they arrive: 72 bytes per row."""

    def __init__(self, rows: Iterable[FrameResult] = ()) -> None:
        self._stamps_ns = array("q")
        self._numbers = array("d")
        self.rejected: Counter[str] = Counter()
        for row in rows:
            self.add(row)

    def __len__(self) -> int:
        return len(self._stamps_ns)

    def add(self, row: FrameResult) -> None:
        """Take the tool's pixel and each distance from a row; NaN where it has none."""
        self._stamps_ns.append(row.stamp_ns)
        numbers = [*(row.image.tool_px or (np.nan, np.nan))]
        for found in (getattr(row.distances, name) for name in DISTANCES):
            std_m = np.nan if found is None or found.std_m is None else found.std_m
            numbers += [np.nan if found is None else found.value_m, std_m]
        if not row.measured:
            self.rejected[str(row.status)] += 1
            numbers = [np.nan] * len(numbers)
        self._numbers.extend(numbers)

    @property
    def stamps_ns(self) -> Stamps:
        """The stamps of the rows, shape (n,)."""
        return np.array(self._stamps_ns, np.int64)

    @property
    def tool_px(self) -> Array:
        """Where the tool was seen, shape (n, 2); NaN where it was not."""
        return self._pairs[:, 0]

    def distance(self, name: str) -> tuple[Array, Array]:
        """Estimates and standard deviations of a distance in m, shape (n,) each."""
        estimate_m, std_m = self._pairs[:, 1 + DISTANCES.index(name)].T
        return estimate_m, std_m

    @property
    def _pairs(self) -> Array:
        return np.array(self._numbers, np.float64).reshape(-1, 1 + len(DISTANCES), 2)

    def pairs(self, name: str, truth: Sampled, stamps_ns: Stamps | None = None) -> Pairs:
        """Pair a distance with its truth at the rows' stamps, or at others, shape (n,); pairs without a value go."""
        estimate_m, std_m = self.distance(name)
        truth_m = truth.values[:, DISTANCES.index(name)]
        kept = truth.valid & np.isfinite(truth_m) & np.isfinite(estimate_m)
        at_ns = self.stamps_ns if stamps_ns is None else stamps_ns
        return Pairs(at_ns[kept], estimate_m[kept], truth_m[kept], std_m[kept])


def pooled(parts: Sequence[Pairs]) -> Pairs:
    """The pairs of several recordings: every frame counts the same."""
    columns = ([getattr(part, column.name) for part in parts] for column in fields(Pairs))
    return Pairs(*map(np.concatenate, columns))


def score_pairs(pairs: Pairs) -> DistanceScore | None:
    """The figures of pairs; None for no pairs."""
    statistics, known = metrics.error_statistics(pairs.estimate_m, pairs.truth_m), np.isfinite(pairs.std_m)
    held = metrics.interval_coverage(pairs.estimate_m[known], pairs.truth_m[known], pairs.std_m[known])
    return DistanceScore(statistics, held, pairs) if statistics else None


def pooled_score(parts: Sequence[DistanceScore | None]) -> DistanceScore | None:
    """The figures of several recordings together; None where none has any."""
    known = [part.pairs for part in parts if part]
    return score_pairs(pooled(known)) if known else None


def require_clearance(method: str, profile: Profile | None = None) -> None:
    """Refuse alarms where no clearance is estimated: no alarm would ever be raised, which looks like safety."""
    if method in PLANAR_METHODS:
        choices = ", ".join(SPATIAL_METHODS)
        raise UsageError(
            f"alarms need a clearance; {method} measures in the plane: the choices are {choices}"
        )
    if profile is not None and profile.instrument is None:
        raise ProfileError(
            f"profile {profile.name} has no [instrument]: alarms need a clearance, which needs the instrument's sizes"
        )


def score_alarms(
    rows: Sequence[FrameResult], truth: Sampled, stamps_ns: Stamps, rules: AlarmRules
) -> metrics.AlarmStatistics:
    """Score the alarms of all rows at their true clearances; RecordingError where none of these is known."""
    clearance_m = truth.values[:, DISTANCES.index("clearance")]
    known = truth.valid & np.isfinite(clearance_m)
    if not known.any():
        raise RecordingError("there is no frame with a true clearance to score alarms against")
    watch, order = AlarmWatch(rules), np.argsort(stamps_ns, kind="stable")
    states = {index: watch.watch(rows[index]).alarm for index in order.tolist()}
    kept = order[known[order]].tolist()
    seconds = (stamps_ns[kept] - stamps_ns[order[0]]) / 1e9
    alarms, judged = [states[at] is True for at in kept], [states[at] is not None for at in kept]
    return metrics.alarm_statistics(seconds, alarms, clearance_m[kept], rules.below_m, judged)


@dataclass(frozen=True)
class Score:
    """The score of one method on one recording, or on all of them, against one reference.

    `pairs` are of the planar distance. `rejected` counts the frames that could not be measured, by reason. `fitted_on`
    says that the calibration was fitted on this recording. `lag` was subtracted from the image stamps before pairing;
    `uncorrected` are the planar figures without that.
    """

    recording: str
    method: str
    equations: Equations
    reference: references.Reference
    frame_count: int
    rejected: Mapping[str, int]
    pairs: Pairs = field(repr=False)
    fitted_on: bool = False
    lag: LagEstimate | None = None
    uncorrected: metrics.ErrorStatistics | None = None
    spatial: DistanceScore | None = None
    clearance: DistanceScore | None = None
    alarms: metrics.AlarmStatistics | None = None
    instrument: str = ""
    start_ns: int = 0  # stamp of the first image of the log
    alarm_events: tuple[AlarmEvent, ...] = ()

    @cached_property
    def planar(self) -> DistanceScore | None:
        """The figures of the planar distance; None for no pairs."""
        return score_pairs(self.pairs)

    @property
    def statistics(self) -> metrics.ErrorStatistics | None:
        """The error figures of the planar distance, in m."""
        return self.planar.statistics if self.planar else None

    @property
    def rmse_interval_m(self) -> metrics.Interval | None:
        """The bootstrap interval of the planar RMSE; None for few pairs."""
        return self._intervals[0]

    @property
    def r_squared_interval(self) -> metrics.Interval | None:
        """The bootstrap interval of the planar R²; None where it is undefined."""
        return self._intervals[1]

    @cached_property
    def _intervals(self) -> tuple[metrics.Interval | None, metrics.Interval | None]:
        return metrics.bootstrap_intervals(self.pairs.estimate_m, self.pairs.truth_m, BOOTSTRAP_SEED)

    @property
    def sample_count(self) -> int:
        """Number of scored pairs."""
        return len(self.pairs)

    @property
    def rejected_count(self) -> int:
        """Number of frames that could not be measured."""
        return sum(self.rejected.values())

    @property
    def unpaired_count(self) -> int:
        """Number of frames that were measured where the reference has no value."""
        return self.frame_count - self.rejected_count - self.sample_count

    @property
    def coverage(self) -> float:
        """Measured frames per frame."""
        return metrics.coverage(self.frame_count - self.rejected_count, self.frame_count)


def truth_lag_ns(
    recording: Recording, setup: Setup, reference: references.Reference, lag: LagEstimate | None
) -> int:
    """Time offset from a reference's stamps to the images': the lag, or 0 where the reference has the images' clock."""
    if lag and lag.lag_s and reference is references.Reference.GROUND_TRUTH:
        corrected = replace(recording, lag=KnownLag(lag.lag_s))
        if references.truth_follows_images(corrected, setup.profile):
            return 0
    return round(lag.lag_s * 1e9) if lag else 0


def score_rows(
    rows: Sequence[FrameResult],
    recording: Recording,
    setup: Setup,
    reference: references.Reference,
    rules: references.TruthRules = references.ANY_TRUTH,
    lag: LagEstimate | None = None,
    alarms: AlarmRules | None = None,
) -> Score:
    """Score the estimates of one recording, shape (n_frames,), against one reference."""

    def truth_at(at_ns: Stamps) -> Sampled:
        return references.distance_truth(recording, setup.profile, reference, at_ns, setup.equations, rules)

    readings = Readings(rows)
    lag_ns = truth_lag_ns(recording, setup, reference, lag)
    stamps_ns = readings.stamps_ns - lag_ns
    truth = truth_at(stamps_ns)
    planar, spatial, clearance = (readings.pairs(distance, truth, stamps_ns) for distance in DISTANCES)
    is_truth = reference is references.Reference.GROUND_TRUTH
    unshifted = readings.pairs("planar", truth_at(readings.stamps_ns)) if lag_ns else planar
    return Score(
        *(recording.name, setup.method, setup.equations, reference, len(rows)),
        dict(sorted(readings.rejected.items())),
        planar,
        setup.was_fitted_on(recording),
        lag,
        metrics.error_statistics(unshifted.estimate_m, unshifted.truth_m),
        score_pairs(spatial),
        score_pairs(clearance),
        score_alarms(rows, truth, stamps_ns, alarms) if alarms and is_truth else None,
        start_ns=rows[0].stamp_ns - round(rows[0].seconds * 1e9) if rows else 0,
        alarm_events=tuple(alarm_events(rows, alarms)),
    )


def pool_scores(scores: Sequence[Score], named: str = "overall") -> Score:
    """One score over the pairs of several scores of one instrument: every frame counts the same."""
    # By name: the bootstrap draws blocks of neighbours, and the order of logs must not change its result.
    scores = sorted(scores, key=lambda score: (score.recording, score.pairs.stamps_ns[:1].tolist()))
    rejected = sum((Counter(score.rejected) for score in scores), Counter[str]())
    alarms = [score.alarms for score in scores if score.alarms]
    return replace(
        scores[0],
        recording=named,
        frame_count=sum(score.frame_count for score in scores),
        rejected=dict(sorted(rejected.items())),
        pairs=pooled([score.pairs for score in scores]),
        fitted_on=False,
        lag=None,
        uncorrected=None,
        spatial=pooled_score([score.spatial for score in scores]),
        clearance=pooled_score([score.clearance for score in scores]),
        alarms=metrics.pooled_alarms(alarms) if alarms else None,
        alarm_events=(),
    )
