"""Every metric, declared once: tables, CSV, JSON, baselines and docs/metrics.md are made from these declarations.

A new metric is one entry in one of the tuples below. Give it `is_late=True`: columns may be added at the end only.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from enum import Flag, StrEnum, auto
from operator import attrgetter
from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from svmdist.metrics import COUNT, DEGREES, LENGTH, RATIO, SECONDS, SHARE, TEXT, Unit

Value = str | int | float | None


class Better(StrEnum):
    """Which way a metric gets better."""

    HIGHER = "higher"
    LOWER = "lower"


class Output(Flag):
    """Where a metric stands: in CSV and JSON (SCORES, FIGURES) or in a table for a person."""

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
class Metric:
    """One metric of a score, or of a part of it; `key` is its name in CSV, JSON and baselines.

    `of` reads it, a function or a path of attributes, from the last of the `parts`, of which each is an attribute of
    the one before. A baseline stores it where it has a `tolerance`, which needs `better`. `in_3d` is of the spatial
    distance and the clearance. `is_late` moves its columns behind all others, where new columns belong.
    """

    key: str
    unit: Unit
    of: Callable[[Any], Value] | str
    meaning: str
    better: Better | None = None
    title: str = ""
    outputs: Output = Output.SCORES
    tolerance: Tolerance | None = None
    outputs_in_3d: Output = Output(0)  # noqa: RUF009  (it is a constant)
    tolerance_in_3d: Tolerance | None = None
    narrow_title: str = ""
    source: str = ""
    group: str = ""
    is_late: bool = False
    parts: tuple[str, ...] = ()

    def value(self, source: Any) -> Value:
        """The metric of a score; None where that lacks one of the parts."""
        for part in self.parts:
            if (source := getattr(source, part)) is None:
                return None
        found: Value = self.of(source) if callable(self.of) else attrgetter(self.of)(source)
        return found


def of_part(metrics: Iterable[Metric], name: str) -> list[Metric]:
    """Metrics of a part, an attribute of the whole, as metrics of the whole."""
    return [replace(metric, parts=(name, *metric.parts)) for metric in metrics]


def of_distance(metrics: Iterable[Metric], distance: str) -> list[Metric]:
    """Metrics of a distance as metrics of scores and figures, which have an attribute of its name."""
    named = [replace(metric, group=distance) for metric in metrics]
    if distance != "planar":
        named = [replace(one, outputs=one.outputs_in_3d, tolerance=one.tolerance_in_3d) for one in named]
        named = [replace(one, key=f"{distance}_{one.key}") for one in named]
    return of_part(named, distance)


def within(metrics: Iterable[Metric], output: Output) -> list[Metric]:
    """The metrics that stand in an output."""
    return [metric for metric in metrics if output & metric.outputs]


def cells(metrics: Iterable[Metric], of: object) -> dict[str, Value]:
    """The values of metrics by their keys."""
    return {metric.key: metric.value(of) for metric in metrics}


LOWER, HIGHER = Better.LOWER, Better.HIGHER
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
FRAME_COUNT = Metric("frame_count", COUNT, "frame_count", "Number of frames.", outputs=SCORES | FIGURES)
COVERAGE = Metric("coverage", SHARE, "coverage", "Share of the frames that were measured.",
                  HIGHER, "cov. %", SCORE_TABLE | REPLAY | PAIRS, Tolerance(absolute=0.0))

COUNTS = (
    Metric("sample_count", COUNT, "sample_count", "Measured frames with a truth.", title="n", outputs=SCORE_TABLE),
    Metric("rejected_count", COUNT, "rejected_count", "Frames that could not be measured.", LOWER),
    COVERAGE,
)
"""How many frames `validate` scored."""

ERRORS = (
    Metric("count", COUNT, "statistics.count", "Number of pairs.", title="n", outputs=Output.DISTANCE_TABLE),
    Metric("r_squared", RATIO, "statistics.r_squared",
           "Coefficient of determination, 1 - SS_res / SS_tot against the identity line.",
           HIGHER, "R²", EVERYWHERE, R_SQUARED_TOLERANCE, FIGURES, source="the paper's eq. (36)"),
    Metric("rmse_m", LENGTH, "statistics.rmse", "Root of the mean squared error.",
           LOWER, "RMSE", EVERYWHERE | PAIRS, RMSE_TOLERANCE, IN_3D | PAIRS, RMSE_TOLERANCE),
    Metric("mae_m", LENGTH, "statistics.mae", "Mean of the absolute error.", LOWER, "MAE", SCORE_TABLE),
    Metric("median_abs_error_m", LENGTH, "statistics.median_abs_error",
           "Median of the absolute error.", LOWER, "med.", SCORE_TABLE),
    Metric("p95_abs_error_m", LENGTH, "statistics.p95_abs_error",
           "95th percentile of the absolute error.", LOWER, "p95", EVERYWHERE | PAIRS, P95_TOLERANCE, IN_3D | PAIRS),
    Metric("max_abs_error_m", LENGTH, "statistics.max_abs_error", "Largest absolute error.",
           LOWER, "max", SCORE_TABLE),
    Metric("bias_m", LENGTH, "statistics.bias", "Mean of estimate minus truth; best at 0.",
           title="bias", outputs=SCORE_TABLE | Output.DISTANCE_TABLE, outputs_in_3d=SCORES),
    Metric("truth_std_m", LENGTH, "statistics.truth_std", "Standard deviation of the truth.",
           title="σ", outputs=SCORE_TABLE | Output.DISTANCE_TABLE),
    Metric("pearson_r", RATIO, "statistics.pearson_r",
           "Pearson's correlation of estimate and truth.", HIGHER, "r", SCORE_TABLE),
)
"""How far the estimates of a distance are from the truth."""

INTERVALS = (
    Metric("interval_coverage", SHARE, "interval_coverage",
           "Share of truths inside estimate ± 1.96 standard deviations; best at 0.95.", title="in 95 %",
           narrow_title="∈95 %", outputs=SCORES | Output.DISTANCE_TABLE | REPLAY, outputs_in_3d=IN_3D),
    Metric("normalized_rmse", Unit("1", digits=2), "normalized_rmse",
           "RMSE of errors over their (joint) standard deviations; best at 1.",
           title="/ σ", outputs=SCORES | FIGURES | PAIRS, outputs_in_3d=SCORES | FIGURES | PAIRS, is_late=True),
)
"""Whether the stated standard deviations of a distance are honest."""

POSITION_ERRORS = "Errors of the tool's position: RMSE, median, 95th percentile."
ROTATION_ERRORS = "Errors of the tool's rotation: median, 95th percentile."
TOOL = (
    Metric("tool_sample_count", COUNT, "statistics.count", "Measured frames with a true pose of the tool.",
           title="n", outputs=TOOL_TABLE),
    Metric("tool_rmse_m", LENGTH, "statistics.rmse", POSITION_ERRORS,
           LOWER, "RMSE", TOOL_TABLE | REPLAY | PAIRS, RMSE_TOLERANCE),
    Metric("tool_median_abs_error_m", LENGTH, "statistics.median_abs_error",
           POSITION_ERRORS, LOWER, "med.", TOOL_TABLE),
    Metric("tool_p95_abs_error_m", LENGTH, "statistics.p95_abs_error",
           POSITION_ERRORS, LOWER, "p95", TOOL_TABLE | REPLAY | PAIRS),
    Metric("tool_interval_coverage", SHARE, "interval_coverage",
           "Share of true positions within 2.80 times `tool_std_m`, the 95 % of an isotropic error.",
           title="in 95 %", outputs=TOOL_TABLE),
)
ROTATION = (
    Metric("rotation_median_rad", DEGREES, "statistics.median_abs_error",
           ROTATION_ERRORS, LOWER, "rot. °", TOOL_TABLE | REPLAY | PAIRS),
    Metric("rotation_p95_rad", DEGREES, "statistics.p95_abs_error", ROTATION_ERRORS, LOWER, "p95 °", TOOL_TABLE)
)
"""How far the tool's poses are from the true ones."""

UNPAIRED = Metric("unpaired_count", COUNT, "unpaired_count", "Measured frames without a truth.")

BOOTSTRAP = "moving-block bootstrap, Künsch 1989"
RMSE_BOUNDS = (
    Metric("rmse_low_m", LENGTH, "low", "95 % interval of `rmse_m`.", source=BOOTSTRAP),
    Metric("rmse_high_m", LENGTH, "high", "95 % interval of `rmse_m`.", source=BOOTSTRAP),
)
R_SQUARED_BOUNDS = (
    Metric("r_squared_low", RATIO, "low", "95 % interval of `r_squared`.", source=BOOTSTRAP),
    Metric("r_squared_high", RATIO, "high", "95 % interval of `r_squared`.", source=BOOTSTRAP),
)
MARKS = (
    Metric("fitted_on", COUNT, "fitted_on",
           "Whether the calibration was fitted on this log: left out of the overall score."),
    Metric("rejected", TEXT, lambda s: " ".join(f"{reason}={count}" for reason, count in s.rejected.items()),
           "Frames that could not be measured, by status."),
)
LAG = (
    Metric("lag_s", SECONDS, "lag_s", "Time by which image stamps are late; it was taken off."),
    Metric("lag_confidence", RATIO, "confidence",
           "How much better this lag explains the images than its best rival: 1 - J_best / J_rival.", HIGHER),
)
UNCORRECTED = (
    Metric("r_squared_uncorrected", RATIO, "r_squared", "The same with the lag left in.", HIGHER),
    Metric("rmse_uncorrected_m", LENGTH, "rmse", "The same with the lag left in.", LOWER),
)

LEADS = "Median and shortest time from the start of an alarm to its event; negative where it came late."
ALARMS = (
    Metric("unsafe", COUNT, lambda a: f"{a.unsafe_count} of {a.frame_count}", "Unsafe frames, and all.",
           title="unsafe", outputs=Output.ALARM_TABLE),
    Metric("alarm_frame_count", COUNT, "frame_count", "Frames with a true clearance."),
    Metric("alarm_unsafe_count", COUNT, "unsafe_count",
           "Unsafe frames: those whose true clearance is below the threshold."),
    Metric("alarm_unjudged_count", COUNT, "unjudged_count",
           "Frames without an estimated clearance: no alarm.", LOWER),
    Metric("alarm_unsafe_unjudged_count", COUNT, "unsafe_unjudged_count",
           "Those of them that are unsafe; missed, for the recall.", LOWER),
    Metric("alarm_precision", SHARE, "precision", "Share of the alarmed frames that are unsafe.",
           HIGHER, "precision", ALARM_TABLE),
    Metric("alarm_recall", SHARE, "recall", "Share of the unsafe frames that are alarmed.",
           HIGHER, "recall", ALARM_TABLE, ALARM_TOLERANCE),
    Metric("false_alarm_fraction", SHARE, "false_alarm_fraction",
           "Share of the safe frames that are alarmed.", LOWER, "safe alarmed", ALARM_TABLE, ALARM_TOLERANCE),
    Metric("false_alarms_per_minute", Unit("1/min", digits=1), "false_alarms_per_minute",
           "Unbroken stretches of alarmed frames without an unsafe frame, per minute of recording.",
           LOWER, "false/min", ALARM_TABLE),
    Metric("warned", COUNT, lambda a: f"{len(a.lead_times_s)} of {a.event_count}", "Events with an alarm, and all.",
           title="warned", outputs=Output.ALARM_TABLE),
    Metric("alarm_event_count", COUNT, "event_count",
           "Events: unbroken stretches of unsafe frames that begin inside the recording."),
    Metric("alarm_missed_event_count", COUNT, "missed_event_count", "Events without an alarm.", LOWER),
    Metric("alarm_lead_median_s", SECONDS, "median_lead_s", LEADS, HIGHER, "lead", ALARM_TABLE),
    Metric("alarm_lead_min_s", SECONDS, "min_lead_s", LEADS, HIGHER, "least", ALARM_TABLE),
)
"""How alarms did, with `--alarm-below`. Recall is stored with the share of false alarms: alarming always has a
recall of 1."""

REPLAYS = (
    FRAME_COUNT,
    Metric("measured_count", COUNT, "measured_count", "Measured frames.", HIGHER, outputs=FIGURES),
    COVERAGE,
    Metric("ms_per_frame", Unit("ms", digits=0), "ms_per_frame",
           "Processor time per frame of the method alone.", LOWER, "ms", REPLAY),
)
"""What `compare` and the degradation grid tell beside the distances."""
# fmt: on

FIRST_KEYS = ("r_squared", "rmse_m", "p95_abs_error_m", "coverage")
"""The metrics that every baseline stores; those declared later are missing in older ones."""


def score_metrics() -> list[Metric]:
    """All metrics of a score of `validate`, in the order of its columns."""
    return [
        *COUNTS,
        *of_distance(ERRORS, "planar"),
        *(FRAME_COUNT, UNPAIRED),
        *of_part(RMSE_BOUNDS, "rmse_interval_m"),
        *of_part(R_SQUARED_BOUNDS, "r_squared_interval"),
        *MARKS,
        *of_part(LAG, "lag"),
        *of_part(UNCORRECTED, "uncorrected"),
        *of_distance(INTERVALS, "planar"),
        *of_distance(distance_metrics(), "spatial"),
        *of_distance(distance_metrics(), "clearance"),
        *of_part(ALARMS, "alarms"),
        *tool_metrics(),
    ]


def tool_metrics() -> list[Metric]:
    """All metrics of the tool's pose, of scores and figures."""
    parts = [*of_part(TOOL, "tool"), *of_part(ROTATION, "rotation")]
    return [replace(one, group="tool", is_late=True) for one in parts]


def distance_metrics() -> tuple[Metric, ...]:
    """All metrics of one distance."""
    return ERRORS + INTERVALS


def figure_metrics() -> list[Metric]:
    """All metrics of the figures of a replay, in the order of their columns."""
    distances = (of_distance(distance_metrics(), distance) for distance in ("planar", "spatial", "clearance"))
    return [*REPLAYS, *(metric for metrics in distances for metric in metrics), *tool_metrics()]


def stored_metrics() -> dict[str, Metric]:
    """The metrics that a baseline stores, by their keys, in the order of its file."""
    metrics = {metric.key: metric for metric in score_metrics() if metric.tolerance is not None}
    return {key: metrics[key] for key in (*FIRST_KEYS, *metrics)}
