"""Every metric, declared once: tables, CSV, JSON and baselines are made from these declarations.

A new metric is one entry in one of the tuples below. Give it `is_late=True`: columns may be added at the end only. What
it means is described in docs/metrics.md, whose keys and tolerances are these.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from enum import Flag, auto
from itertools import chain

from pydantic import BaseModel, ConfigDict, Field

from svmdist.metrics import COUNT, DEGREES, LENGTH, RATIO, SECONDS, SHARE, TEXT, Column, Unit


class Output(Flag):
    """Where a metric stands: in CSV and JSON (SCORES, FIGURES) or in a human-readable table."""

    SCORES = auto()  # of `validate`
    SCORE_TABLE = auto()
    DISTANCE_TABLE = auto()
    ALARM_TABLE = auto()
    FIGURES = auto()  # of `compare` and `blur-bench`
    FIGURE_TABLE = auto()
    TOOL_TABLE = auto()  # of `validate`
    PAIR_TABLE = auto()  # of `compare`: one method against another


class Tolerance(BaseModel):
    """How much worse a figure may get: the larger of an absolute and a relative allowance."""

    model_config = ConfigDict(extra="forbid", frozen=True)
    absolute: float = Field(default=0.0, ge=0.0)
    relative: float = Field(default=0.0, ge=0.0)

    def allows(self, loss: float, stored: float) -> bool:
        """Whether a loss, positive when worse, is within the tolerance of the stored figure."""
        return loss <= max(self.absolute, self.relative * abs(stored))


@dataclass(frozen=True, slots=True)
class Metric(Column):
    """A column of a score or of figures, or of a part of them; `key` is its name in CSV, JSON and baselines.

    A baseline stores it where it has a `tolerance`, of how much it may grow, or fall where `higher_is_better`. `in_3d`
    is of the spatial distance and the clearance. `is_late` moves its columns behind all others, where new ones belong.
    """

    outputs: Output = Output.SCORES
    tolerance: Tolerance | None = None
    higher_is_better: bool = False
    outputs_in_3d: Output = Output(0)  # noqa: RUF009  (it is a constant)
    tolerance_in_3d: Tolerance | None = None
    narrow_heading: str = ""
    group: str = ""
    is_late: bool = False


def of_part(metrics: Iterable[Metric], name: str) -> list[Metric]:
    """Metrics of a part, an attribute of the whole that may be None, as metrics of the whole."""
    return [replace(metric, of=f"{name}.{metric.of or metric.key}") for metric in metrics]


def of_distance(metrics: Iterable[Metric], distance: str) -> list[Metric]:
    """Metrics of a distance as metrics of scores and figures, which have an attribute of its name."""
    named = of_part((replace(one, group=distance) for one in metrics), distance)
    if distance == "planar":
        return named
    named = [replace(one, outputs=one.outputs_in_3d, tolerance=one.tolerance_in_3d) for one in named]
    return [replace(one, key=f"{distance}_{one.key}") for one in named]


def within(metrics: Iterable[Metric], output: Output) -> list[Metric]:
    """The metrics that stand in an output."""
    return [metric for metric in metrics if output & metric.outputs]


SCORES, FIGURES = Output.SCORES, Output.FIGURES
SCORE_TABLE = SCORES | Output.SCORE_TABLE
ALARM_TABLE = SCORES | Output.ALARM_TABLE
REPLAY = FIGURES | Output.FIGURE_TABLE
PAIRS = Output.PAIR_TABLE
EVERYWHERE = SCORE_TABLE | Output.DISTANCE_TABLE | REPLAY
IN_3D = SCORES | REPLAY
TOOL_TABLE = SCORES | FIGURES | Output.TOOL_TABLE

# Room for another build of OpenCV, which moves a homography's corners by up to 1e-3 px and may flip a match; not for
# another result. A frame that is no longer measured has no such excuse.
R_SQUARED_TOLERANCE = Tolerance(absolute=0.002)
RMSE_TOLERANCE = Tolerance(absolute=2e-5, relative=0.02)
P95_TOLERANCE = Tolerance(absolute=5e-5, relative=0.05)
ALARM_TOLERANCE = Tolerance(absolute=0.005)

# fmt: off
FRAME_COUNT = Metric("frame_count", outputs=SCORES | FIGURES)
COVERAGE = Metric("coverage", SHARE, "cov. %", outputs=SCORE_TABLE | REPLAY | PAIRS | TOOL_TABLE,
                  tolerance=Tolerance(), higher_is_better=True)

COUNTS = (Metric("sample_count", COUNT, "n", outputs=SCORE_TABLE), Metric("rejected_count"), COVERAGE)
"""How many frames `validate` scored."""

ERRORS = (
    Metric("count", COUNT, "n", "statistics.count", outputs=Output.DISTANCE_TABLE),
    Metric("r_squared", RATIO, "R²", "statistics.r_squared", outputs=EVERYWHERE, tolerance=R_SQUARED_TOLERANCE,
           outputs_in_3d=FIGURES, higher_is_better=True),
    Metric("rmse_m", LENGTH, "RMSE", "statistics.rmse", outputs=EVERYWHERE | PAIRS, tolerance=RMSE_TOLERANCE,
           outputs_in_3d=IN_3D | PAIRS, tolerance_in_3d=RMSE_TOLERANCE),
    Metric("mae_m", LENGTH, "MAE", "statistics.mae", outputs=SCORE_TABLE),
    Metric("median_abs_error_m", LENGTH, "med.", "statistics.median_abs_error", outputs=SCORE_TABLE),
    Metric("p95_abs_error_m", LENGTH, "p95", "statistics.p95_abs_error", outputs=EVERYWHERE | PAIRS,
           tolerance=P95_TOLERANCE, outputs_in_3d=IN_3D | PAIRS),
    Metric("max_abs_error_m", LENGTH, "max", "statistics.max_abs_error", outputs=SCORE_TABLE),
    Metric("bias_m", LENGTH, "bias", "statistics.bias", outputs=SCORE_TABLE | Output.DISTANCE_TABLE,
           outputs_in_3d=SCORES),
    Metric("truth_std_m", LENGTH, "σ", "statistics.truth_std", outputs=SCORE_TABLE | Output.DISTANCE_TABLE),
    Metric("pearson_r", RATIO, "r", "statistics.pearson_r", outputs=SCORE_TABLE),
)
"""How far the estimates of a distance are from the truth."""

SPREAD = tuple(
    replace(one, outputs_in_3d=SCORES, is_late=True) for one in ERRORS if one.key in ("r_squared", "truth_std_m")
)
"""What the table of distances in 3D shows beside, as columns of `validate`."""

INTERVALS = (
    Metric("interval_coverage", SHARE, "in 95 %", "interval_coverage", narrow_heading="∈95 %",
           outputs=SCORES | Output.DISTANCE_TABLE | REPLAY, outputs_in_3d=IN_3D),
    Metric("normalized_rmse", Unit("1", digits=2), "/ σ", "normalized_rmse", outputs=SCORES | FIGURES | PAIRS,
           outputs_in_3d=SCORES | FIGURES | PAIRS, is_late=True),
)
"""Whether the reported standard deviations of a distance are consistent with its errors."""

OF_DISTANCE = ERRORS + INTERVALS

TOOL = tuple(replace(one, group="tool", is_late=True) for one in (
    Metric("tool_sample_count", COUNT, "n", "tool.statistics.count", outputs=TOOL_TABLE),
    Metric("tool_rmse_m", LENGTH, "RMSE", "tool.statistics.rmse", outputs=TOOL_TABLE | REPLAY | PAIRS,
           tolerance=RMSE_TOLERANCE),
    Metric("tool_median_abs_error_m", LENGTH, "med.", "tool.statistics.median_abs_error", outputs=TOOL_TABLE),
    Metric("tool_p95_abs_error_m", LENGTH, "p95", "tool.statistics.p95_abs_error", outputs=TOOL_TABLE | REPLAY | PAIRS),
    Metric("tool_interval_coverage", SHARE, "in 95 %", "tool.interval_coverage", outputs=TOOL_TABLE),
    Metric("rotation_median_rad", DEGREES, "rot. °", "rotation.statistics.median_abs_error",
           outputs=TOOL_TABLE | REPLAY | PAIRS),
    Metric("rotation_p95_rad", DEGREES, "p95 °", "rotation.statistics.p95_abs_error", outputs=TOOL_TABLE),
))
"""How far the tool's poses are from the true ones."""

FRAMES_AND_BOUNDS = (
    FRAME_COUNT,
    Metric("unpaired_count"),
    Metric("rmse_low_m", LENGTH, "", "intervals.rmse.low"),
    Metric("rmse_high_m", LENGTH, "", "intervals.rmse.high"),
    Metric("r_squared_low", RATIO, "", "intervals.r_squared.low"),
    Metric("r_squared_high", RATIO, "", "intervals.r_squared.high"),
    Metric("fitted_on"),
    Metric("rejected", TEXT, "", lambda s: " ".join(f"{reason}={count}" for reason, count in s.rejected.items())),
    Metric("lag_s", SECONDS, "", "lag.lag_s"),
    Metric("lag_confidence", RATIO, "", "lag.confidence"),
    Metric("r_squared_uncorrected", RATIO, "", "uncorrected.r_squared"),
    Metric("rmse_uncorrected_m", LENGTH, "", "uncorrected.rmse"),
)
"""The frames of a score and what was done to them, and the intervals of its figures."""

ALARMS = (
    Metric("unsafe", COUNT, "unsafe", lambda s: s.alarms and f"{s.alarms.unsafe_count} of {s.alarms.frame_count}",
           outputs=Output.ALARM_TABLE),
    Metric("alarm_frame_count", COUNT, "", "alarms.frame_count"),
    Metric("alarm_unsafe_count", COUNT, "", "alarms.unsafe_count"),
    Metric("alarm_unjudged_count", COUNT, "", "alarms.unjudged_count"),
    Metric("alarm_unsafe_unjudged_count", COUNT, "", "alarms.unsafe_unjudged_count"),
    Metric("alarm_precision", SHARE, "precision", "alarms.precision", outputs=ALARM_TABLE),
    Metric("alarm_recall", SHARE, "recall", "alarms.recall", outputs=ALARM_TABLE, tolerance=ALARM_TOLERANCE,
           higher_is_better=True),
    Metric("false_alarm_fraction", SHARE, "safe alarmed", "alarms.false_alarm_fraction", outputs=ALARM_TABLE,
           tolerance=ALARM_TOLERANCE),
    Metric("false_alarms_per_minute", Unit("1/min", digits=1), "false/min", "alarms.false_alarms_per_minute",
           outputs=ALARM_TABLE),
    Metric("warned", COUNT, "warned", lambda s: s.alarms and f"{len(s.alarms.lead_times_s)} of {s.alarms.event_count}",
           outputs=Output.ALARM_TABLE),
    Metric("alarm_event_count", COUNT, "", "alarms.event_count"),
    Metric("alarm_missed_event_count", COUNT, "", "alarms.missed_event_count"),
    Metric("alarm_lead_median_s", SECONDS, "lead", "alarms.median_lead_s", outputs=ALARM_TABLE),
    Metric("alarm_lead_min_s", SECONDS, "least", "alarms.min_lead_s", outputs=ALARM_TABLE),
)
"""How alarms did, with `--alarm-below`. Recall is stored with the share of false alarms: alarming always has a
recall of 1."""

REPLAYS = (
    FRAME_COUNT,
    Metric("measured_count", outputs=FIGURES),
    COVERAGE,
    Metric("ms_per_frame", Unit("ms", digits=0), "ms", outputs=REPLAY),
)
"""What `compare` and the degradation grid report beside the distances."""
# fmt: on

FIRST_KEYS = ("r_squared", "rmse_m", "p95_abs_error_m", "coverage")
"""The metrics that every baseline stores; those declared later are missing in older ones."""


def score_metrics() -> list[Metric]:
    """All metrics of a score of `validate`, in the order of its columns."""
    return [
        *COUNTS,
        *of_distance(ERRORS, "planar"),
        *FRAMES_AND_BOUNDS,
        *of_distance(INTERVALS, "planar"),
        *of_distance(OF_DISTANCE, "spatial"),
        *of_distance(OF_DISTANCE, "clearance"),
        *ALARMS,
        *TOOL,
        *of_distance(SPREAD, "spatial"),
        *of_distance(SPREAD, "clearance"),
    ]


def figure_metrics() -> list[Metric]:
    """All metrics of the figures of a replay, in the order of their columns."""
    distances = (of_distance(OF_DISTANCE, distance) for distance in ("planar", "spatial", "clearance"))
    return [*REPLAYS, *chain.from_iterable(distances), *TOOL]


def stored_metrics() -> dict[str, Metric]:
    """The metrics that a baseline stores, by their keys, in the order of its file."""
    metrics = {metric.key: metric for metric in score_metrics() if metric.tolerance is not None}
    return {key: metrics[key] for key in (*FIRST_KEYS, *metrics)}
