"""Validation results for machines: flat rows, and the JSON document `svmdist.validation/1`."""

from __future__ import annotations

from typing import Any

from svmdist.report.table import Cell, json_value
from svmdist.workflows.scoring.metric_table import Output, cells, row_keys, score_metrics, within
from svmdist.workflows.scoring.score import Score
from svmdist.workflows.validate import PAPER_R_SQUARED, Validation

SCHEMA = "svmdist.validation/1"

PAPER_NOTE = (
    f"The paper reports R² = {PAPER_R_SQUARED:.0%} for its own scene and trajectory, without RMSE or n; the scenes"
    " differ, so that figure and ours stand side by side and are not compared."
)


def score_keys() -> tuple[str, ...]:
    """The columns of a row, in order. Some may be added at the end, none is renamed or removed."""
    labels = ("recording", "method", "equations", "reference")
    return row_keys(labels, within(score_metrics(), Output.SCORES), ("instrument",))


def score_row(score: Score) -> dict[str, Cell]:
    """One score in SI, flat, with the keys of `score_keys()`."""
    values: dict[str, Cell] = {
        "recording": score.recording,
        "method": score.method,
        "equations": score.equations,
        "reference": str(score.reference),
        "instrument": score.instrument or None,
        **cells(within(score_metrics(), Output.SCORES), score),
    }
    return {key: values[key] for key in score_keys()}


def validation_document(validation: Validation) -> dict[str, Any]:
    """The JSON document: `overall` is the score against the strongest reference, `overall_by_reference` has all."""
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
        **({"groups": [_json_score(score) for score in validation.groups]} if validation.groups else {}),
        "paper": {"r_squared": PAPER_R_SQUARED, "note": PAPER_NOTE},
        "notes": list(validation.notes),
    }


def _json_score(score: Score) -> dict[str, Any]:
    """A row whose `rejected` is an object of counts by reason."""
    row = {key: json_value(value) for key, value in score_row(score).items()}
    return row | {"rejected": dict(score.rejected)}
