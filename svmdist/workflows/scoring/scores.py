"""Scores: the estimates of recordings, paired by time with one reference, and their figures."""

from __future__ import annotations

import math
from array import array
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from functools import cached_property

import numpy as np

from svmdist import metrics, transforms
from svmdist.errors import RecordingError
from svmdist.estimation.plane_mapping import Equations
from svmdist.recording.log import Recording
from svmdist.results import Z_95, AlarmEvent, FrameResult
from svmdist.tracks import LagEstimate, Mask
from svmdist.transforms import Array, Stamps
from svmdist.workflows.request import Request
from svmdist.workflows.scoring.references import Reference, Truth, reference_lag_ns, truth_at

BOOTSTRAP_SEED = 36
SPHERE_95 = 2.7955
"""Standard deviations of an isotropic error in 3D that 95 % of positions are within: sqrt(χ²(0.95; 3))."""
DISTANCES = ("planar", "spatial", "clearance")
SCORED = (*DISTANCES, "tool", "rotation")
NUMBERS = 16  # of a row: its pixel, distances with deviations, the tool's deviation, position and quaternion


@dataclass(frozen=True, repr=False)
class Pairs:
    """Measured frames with a reference, shape (n,) each: stamps, and estimate, truth and deviation (or NaN) in m."""

    stamps_ns: Stamps
    estimate_m: Array
    truth_m: Array
    std_m: Array

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def __repr__(self) -> str:
        """The figures, not the numbers."""
        return f"Pairs({self.statistics}, interval_coverage={self.interval_coverage})"

    @cached_property
    def statistics(self) -> metrics.ErrorStatistics | None:
        """The error figures in m; None for no pairs."""
        return metrics.error_statistics(self.estimate_m, self.truth_m)

    @cached_property
    def interval_coverage(self) -> float | None:
        """The share of truths inside the 95 % interval; None without intervals."""
        known = np.isfinite(self.std_m)
        return metrics.interval_coverage(self.estimate_m[known], self.truth_m[known], self.std_m[known])

    @property
    def normalized_rmse(self) -> float | None:
        """The root of the mean squared error over its standard deviation; None without any."""
        known = np.isfinite(self.std_m) & (self.std_m > 0.0)
        errors = (self.estimate_m - self.truth_m)[known] / self.std_m[known]
        return float(np.sqrt(np.mean(errors**2))) if known.any() else None


NO_PAIRS = Pairs(np.empty(0, np.int64), *(np.empty(0) for _ in range(3)))


class Readings:
    """The numbers that scoring takes from rows, collected as they arrive: 136 bytes per row."""

    def __init__(self, rows: Iterable[FrameResult] = ()) -> None:
        self._stamps_ns, self._numbers = array("q"), array("d")
        self.rejected = Counter[str]()
        for row in rows:
            self.add(row)

    def __len__(self) -> int:
        return len(self._stamps_ns)

    def add(self, row: FrameResult) -> None:
        """Take the tool's pixel, each distance and the tool's pose from a row; NaN where it has none."""
        self._stamps_ns.append(row.stamp_ns)
        numbers = [*(row.image.tool_px or (np.nan, np.nan))]
        for found in (getattr(row.distances, name) for name in DISTANCES):
            std_m = np.nan if found is None or found.std_m is None else found.std_m
            numbers += [np.nan if found is None else found.value_m, std_m]
        if row.tool is not None:
            pose = row.tool.pose
            turned = transforms.quaternion_xyzw_from_rotation(pose.T_camera_tool[:3, :3])
            numbers += [pose.position_std_m, *pose.position_m.tolist(), *turned.tolist()]
        if not row.measured:
            self.rejected[str(row.status)] += 1
            numbers = []
        self._numbers.extend(numbers + [np.nan] * (NUMBERS - len(numbers)))

    @property
    def stamps_ns(self) -> Stamps:
        """The stamps of the rows, shape (n,)."""
        return np.array(self._stamps_ns, np.int64)

    @property
    def tool_px(self) -> Array:
        """Where the tool was seen, shape (n, 2); NaN where it was not."""
        return self._table[:, :2]

    def distance(self, name: str) -> tuple[Array, Array]:
        """Estimates and standard deviations of a distance in m, shape (n,) each."""
        at = 2 + 2 * DISTANCES.index(name)
        estimate_m, std_m = self._table[:, at : at + 2].T
        return estimate_m, std_m

    @property
    def is_rejected(self) -> Mask:
        """Which rows have no number, shape (n,)."""
        return np.asarray(np.isnan(self._table).all(axis=1))

    @property
    def truth(self) -> Truth:
        """The distances and poses of these rows, to hold others against."""
        table = self._table
        R = transforms.known_rotations(table[:, 12:])
        return Truth(table[:, 2:8:2], transforms.make_transform(R, table[:, 9:12]))

    @property
    def _table(self) -> Array:
        return np.array(self._numbers, np.float64).reshape(-1, NUMBERS)

    def pairs(self, name: str, truth: Truth, stamps_ns: Stamps | None = None, other: Readings | None = None) -> Pairs:
        """Pair a distance with its truth at the rows' stamps, or at others, shape (n,); pairs without a value go.

        `tool` and `rotation` are how far it is from its true pose, in m and rad, paired with zero. A truth by `other`
        estimates adds their deviations.
        """
        if name in DISTANCES:
            (estimate, std), true = self.distance(name), truth.distances_m[:, DISTANCES.index(name)]
            others = None if other is None else other.distance(name)[1]
        else:
            T, true = self.truth.T_camera_tool, np.zeros(len(self))
            of, others = truth.T_camera_tool, None if other is None else SPHERE_95 / Z_95 * other._table[:, 8]
            std, estimate = SPHERE_95 / Z_95 * self._table[:, 8], np.full(len(self), np.nan)
            if of is not None and T is not None and name == "tool":
                estimate = np.linalg.norm(T[:, :3, 3] - of[:, :3, 3], axis=1)
            elif of is not None and T is not None:
                estimate, std = transforms.rotation_angle(T[:, :3, :3], of[:, :3, :3]), estimate
        std = std if others is None else np.hypot(std, others)
        kept = np.isfinite(true) & np.isfinite(estimate)
        at_ns = self.stamps_ns if stamps_ns is None else stamps_ns
        return Pairs(at_ns[kept], estimate[kept], true[kept], std[kept])


def pooled_pairs(parts: Sequence[Pairs | None]) -> Pairs | None:
    """The pairs of several recordings together; None where none has any."""
    known = [pairs for pairs in parts if pairs]
    columns = ([getattr(pairs, column.name) for pairs in known] for column in fields(Pairs))
    return Pairs(*map(np.concatenate, columns)) if known else None


def score_alarms(
    rows: Sequence[FrameResult], truth: Truth, stamps_ns: Stamps, below_m: float
) -> metrics.AlarmStatistics:
    """Score the alarms of all rows at their true clearances; RecordingError where none of these is known."""
    clearance_m = truth.distances_m[:, DISTANCES.index("clearance")]
    known = np.isfinite(clearance_m)
    if not known.any():
        raise RecordingError("there is no frame with a true clearance to score alarms against")
    order = np.argsort(stamps_ns, kind="stable")
    kept = order[known[order]].tolist()
    seconds = (stamps_ns[kept] - stamps_ns[order[0]]) / 1e9
    raised = [rows[at].alarm.is_raised for at in kept]
    alarms, judged = [one is True for one in raised], [one is not None for one in raised]
    return metrics.alarm_statistics(seconds, alarms, clearance_m[kept], below_m, judged)


@dataclass(frozen=True)
class Figures:
    """The figures of rows, or of those of several recordings, where every frame counts the same.

    A distance without estimate or truth is None; `tool` is how far off its position is, `rotation` how far it is turned
    in rad. `seconds`: processor time of estimates and detections; methods share the cost of what several use.
    """

    frame_count: int
    measured_count: int
    seconds: float = math.nan
    planar: Pairs | None = None
    spatial: Pairs | None = None
    clearance: Pairs | None = None
    tool: Pairs | None = None
    rotation: Pairs | None = None

    @property
    def coverage(self) -> float:
        """Measured frames per frame; 0 for no frames."""
        return self.measured_count / self.frame_count if self.frame_count else 0.0

    @property
    def ms_per_frame(self) -> float:
        """Processor time per frame."""
        return 1e3 * self.seconds / max(self.frame_count, 1)


def figures_of(
    rows: Readings, truth: Truth | None, other: Readings | None = None, at_ns: Stamps | None = None
) -> Figures:
    """The figures of rows, paired as `Readings.pairs` does; without a truth their counts."""
    unmeasured = rows.rejected.total()
    if other is not None:
        unmeasured = int(np.count_nonzero(rows.is_rejected | other.is_rejected))
    pairs = (None if truth is None else rows.pairs(name, truth, at_ns, other) or None for name in SCORED)
    return Figures(len(rows), len(rows) - unmeasured, math.nan, *pairs)


def pooled_figures(figures: Sequence[Figures]) -> Figures:
    """Several figures as one."""
    return Figures(
        sum(one.frame_count for one in figures),
        sum(one.measured_count for one in figures),
        sum(one.seconds for one in figures),
        *(pooled_pairs([getattr(one, name) for one in figures]) for name in SCORED),
    )


@dataclass(frozen=True, kw_only=True)
class Score(Figures):
    """The figures of one method on one recording, or on all of them, against one reference.

    `rejected` counts unmeasured frames by reason. `fitted_on` says that the calibration was fitted on this recording.
    `lag` was subtracted from the image stamps before pairing; `uncorrected` are the planar figures without that.
    """

    recording: str
    method: str
    equations: Equations
    reference: Reference
    rejected: Mapping[str, int]
    fitted_on: bool = False
    lag: LagEstimate | None = None
    uncorrected: metrics.ErrorStatistics | None = None
    alarms: metrics.AlarmStatistics | None = None
    instrument: str = ""
    start_ns: int = 0  # stamp of the first image of the log
    alarm_events: tuple[AlarmEvent, ...] = ()

    @property
    def pairs(self) -> Pairs:
        """Those of the planar distance."""
        return self.planar or NO_PAIRS

    @property
    def statistics(self) -> metrics.ErrorStatistics | None:
        """The error figures of the planar distance, in m."""
        return self.pairs.statistics

    @cached_property
    def intervals(self) -> metrics.Intervals:
        """The bootstrap intervals of the planar RMSE and R²; None for few pairs, and where R² is undefined."""
        return metrics.bootstrap_intervals(self.pairs.estimate_m, self.pairs.truth_m, BOOTSTRAP_SEED)

    @property
    def sample_count(self) -> int:
        """Number of scored pairs."""
        return len(self.pairs)

    @property
    def rejected_count(self) -> int:
        """Number of frames that could not be measured."""
        return self.frame_count - self.measured_count

    @property
    def unpaired_count(self) -> int:
        """Number of frames that were measured where the reference has no value."""
        return self.measured_count - self.sample_count


def score_rows(
    rows: Sequence[FrameResult],
    recording: Recording,
    request: Request,
    reference: Reference,
    lag: LagEstimate | None = None,
    by: Readings | None = None,
) -> Score:
    """Score the estimates of one recording, shape (n_frames,), against one reference.

    Of a reference whose tissue is seen in the images, `by` are its rows. Raises RecordingError or KinematicsError where
    the log does not have the reference, or that has nothing of what was estimated.
    """

    def truth_of(at_ns: Stamps) -> Truth:
        if by is not None:
            return by.truth
        return truth_at(recording, reference, at_ns, setup.equations, request.rules)

    setup, alarms, readings = request.setup, request.alarms, Readings(rows)
    lag_ns = reference_lag_ns(recording, reference, lag)
    stamps_ns = readings.stamps_ns - lag_ns
    truth = truth_of(stamps_ns)
    figures = figures_of(readings, truth, at_ns=stamps_ns)
    if figures.tool is None and not np.isfinite(truth.distances_m).any() and figures.measured_count:
        raise RecordingError("it has no tissue to measure to; --truth plane takes the profile's")
    is_truth = reference is Reference.GROUND_TRUTH
    unshifted = readings.pairs("planar", truth_of(readings.stamps_ns)) if lag_ns else figures.planar
    return Score(
        **vars(figures),
        recording=recording.name,
        method=setup.method,
        equations=setup.equations,
        reference=reference,
        rejected=dict(sorted(readings.rejected.items())),
        fitted_on=setup.was_fitted_on(recording),
        lag=lag,
        uncorrected=unshifted.statistics if unshifted else None,
        alarms=score_alarms(rows, truth, stamps_ns, alarms.below_m) if alarms and is_truth else None,
        start_ns=rows[0].stamp_ns - round(rows[0].seconds * 1e9) if rows else 0,
    )


def pool_scores(scores: Sequence[Score], named: str = "overall") -> Score:
    """One score over the pairs of several scores of one instrument: every frame counts the same."""
    # By name: the bootstrap draws blocks of neighbours, and the order of logs must not change its result.
    scores = sorted(scores, key=lambda score: (score.recording, score.pairs.stamps_ns[:1].tolist()))
    rejected = sum((Counter(score.rejected) for score in scores), Counter[str]())
    alarms = [score.alarms for score in scores if score.alarms]
    return replace(
        scores[0],
        **vars(pooled_figures(scores)),
        recording=named,
        rejected=dict(sorted(rejected.items())),
        fitted_on=False,
        lag=None,
        uncorrected=None,
        alarms=metrics.pooled_alarms(alarms) if alarms else None,
        alarm_events=(),
    )
