"""Validation results for machines: flat rows, and the JSON document `svmdist.validation/1`."""

from __future__ import annotations

from typing import Any

from svmdist.alarm_metrics import AlarmStatistics
from svmdist.report.table import Cell, json_value
from svmdist.workflows.scoring.distances import DistanceScore
from svmdist.workflows.scoring.score import Score
from svmdist.workflows.validate import PAPER_R_SQUARED, Validation

SCHEMA = "svmdist.validation/1"

VALIDATION_KEYS = (
    "recording",
    "method",
    "equations",
    "reference",
    "sample_count",
    "rejected_count",
    "coverage",
    "r_squared",
    "rmse_m",
    "mae_m",
    "median_abs_error_m",
    "p95_abs_error_m",
    "max_abs_error_m",
    "bias_m",
    "truth_std_m",
    "pearson_r",
    "frame_count",
    "unpaired_count",
    "rmse_low_m",
    "rmse_high_m",
    "r_squared_low",
    "r_squared_high",
    "fitted_on",
    "rejected",
    "lag_s",
    "lag_confidence",
    "r_squared_uncorrected",
    "rmse_uncorrected_m",
    "interval_coverage",
    "spatial_rmse_m",
    "spatial_p95_abs_error_m",
    "spatial_bias_m",
    "spatial_interval_coverage",
    "clearance_rmse_m",
    "clearance_p95_abs_error_m",
    "clearance_bias_m",
    "clearance_interval_coverage",
    "alarm_frame_count",
    "alarm_unsafe_count",
    "alarm_unjudged_count",
    "alarm_precision",
    "alarm_recall",
    "false_alarm_fraction",
    "false_alarms_per_minute",
    "alarm_event_count",
    "alarm_missed_event_count",
    "alarm_lead_median_s",
    "alarm_lead_min_s",
    "instrument",
)
"""Columns of the CSV: some may be added at the end, none is renamed or removed. In JSON `rejected` is an object of
counts by reason."""

PAPER_NOTE = (
    f"The paper reports R² = {PAPER_R_SQUARED:.0%} for its own scene and trajectory, without RMSE or n; the scenes"
    " differ, so that figure and ours stand side by side and are not compared."
)


def score_row(score: Score) -> dict[str, Cell]:
    """One score in SI, flat, with the keys of `VALIDATION_KEYS`."""
    statistics, rmse, r2 = score.statistics, score.rmse_interval_m, score.r_squared_interval
    lag, uncorrected = score.lag, score.uncorrected
    return {
        "recording": score.recording,
        "method": score.method,
        "equations": score.equations,
        "reference": str(score.reference),
        "sample_count": score.sample_count,
        "rejected_count": score.rejected_count,
        "coverage": score.coverage,
        "r_squared": statistics.r_squared if statistics else None,
        "rmse_m": statistics.rmse if statistics else None,
        "mae_m": statistics.mae if statistics else None,
        "median_abs_error_m": statistics.median_abs_error if statistics else None,
        "p95_abs_error_m": statistics.p95_abs_error if statistics else None,
        "max_abs_error_m": statistics.max_abs_error if statistics else None,
        "bias_m": statistics.bias if statistics else None,
        "truth_std_m": statistics.truth_std if statistics else None,
        "pearson_r": statistics.pearson_r if statistics else None,
        "frame_count": score.frame_count,
        "unpaired_count": score.unpaired_count,
        "rmse_low_m": rmse.low if rmse else None,
        "rmse_high_m": rmse.high if rmse else None,
        "r_squared_low": r2.low if r2 else None,
        "r_squared_high": r2.high if r2 else None,
        "fitted_on": score.fitted_on,
        "rejected": " ".join(f"{reason}={count}" for reason, count in score.rejected.items()),
        "lag_s": lag.lag_s if lag else None,
        "lag_confidence": lag.confidence if lag else None,
        "r_squared_uncorrected": uncorrected.r_squared if uncorrected else None,
        "rmse_uncorrected_m": uncorrected.rmse if uncorrected else None,
        "interval_coverage": score.pairs.interval_coverage,
        **_distance_figures("spatial", score.spatial),
        **_distance_figures("clearance", score.clearance),
        **_alarm_figures(score.alarms),
        "instrument": score.instrument or None,
    }


def _distance_figures(name: str, score: DistanceScore | None) -> dict[str, Cell]:
    statistics = score.statistics if score else None
    return {
        f"{name}_rmse_m": statistics.rmse if statistics else None,
        f"{name}_p95_abs_error_m": statistics.p95_abs_error if statistics else None,
        f"{name}_bias_m": statistics.bias if statistics else None,
        f"{name}_interval_coverage": score.interval_coverage if score else None,
    }


def _alarm_figures(alarms: AlarmStatistics | None) -> dict[str, Cell]:
    return {
        "alarm_frame_count": alarms.frame_count if alarms else None,
        "alarm_unsafe_count": alarms.unsafe_count if alarms else None,
        "alarm_unjudged_count": alarms.unjudged_count if alarms else None,
        "alarm_precision": alarms.precision if alarms else None,
        "alarm_recall": alarms.recall if alarms else None,
        "false_alarm_fraction": alarms.false_alarm_fraction if alarms else None,
        "false_alarms_per_minute": alarms.false_alarms_per_minute if alarms else None,
        "alarm_event_count": alarms.event_count if alarms else None,
        "alarm_missed_event_count": alarms.missed_event_count if alarms else None,
        "alarm_lead_median_s": alarms.median_lead_s if alarms else None,
        "alarm_lead_min_s": alarms.min_lead_s if alarms else None,
    }


def validation_document(validation: Validation) -> dict[str, Any]:
    """The JSON document: `overall` is the score against the strongest reference, `overall_by_reference` all."""
    primary = validation.primary
    return {
        "schema": SCHEMA,
        "recordings": [_json_score(score) for score in validation.scores],
        "overall": _json_score(primary) if primary else None,
        "overall_by_reference": {
            str(score.reference): _json_score(score)
            for score in validation.overall
            if primary is None or score.instrument == primary.instrument
        },
        "overall_by_instrument": {
            score.instrument: _json_score(score)
            for score in validation.overall
            if primary is None or score.reference is primary.reference
        },
        "paper": {"r_squared": PAPER_R_SQUARED, "note": PAPER_NOTE},
        "notes": list(validation.notes),
    }


def _json_score(score: Score) -> dict[str, Any]:
    return {key: json_value(value) for key, value in score_row(score).items()} | {
        "rejected": dict(score.rejected)
    }
