"""The columns that users rely on, and the baseline's file."""

import json

import pytest
from pydantic import ValidationError

from svmdist.errors import RecordingError
from svmdist.report import scores
from svmdist.report.tables import keys_of
from svmdist.workflows.validate import StoredScore, load_baseline, save_baseline

SCORE_COLUMNS = """
recording method equations reference sample_count rejected_count coverage r_squared rmse_m mae_m median_abs_error_m
p95_abs_error_m max_abs_error_m bias_m truth_std_m pearson_r frame_count unpaired_count rmse_low_m rmse_high_m
r_squared_low r_squared_high fitted_on rejected lag_s lag_confidence r_squared_uncorrected rmse_uncorrected_m
interval_coverage spatial_rmse_m spatial_p95_abs_error_m spatial_bias_m spatial_interval_coverage clearance_rmse_m
clearance_p95_abs_error_m clearance_bias_m clearance_interval_coverage alarm_frame_count alarm_unsafe_count
alarm_unjudged_count alarm_unsafe_unjudged_count alarm_precision alarm_recall false_alarm_fraction
false_alarms_per_minute alarm_event_count alarm_missed_event_count alarm_lead_median_s alarm_lead_min_s instrument
normalized_rmse spatial_normalized_rmse clearance_normalized_rmse
tool_sample_count tool_rmse_m tool_median_abs_error_m tool_p95_abs_error_m tool_interval_coverage rotation_median_rad
rotation_p95_rad spatial_r_squared spatial_truth_std_m clearance_r_squared clearance_truth_std_m
"""
FIGURE_COLUMNS = """
frame_count measured_count coverage ms_per_frame r_squared rmse_m p95_abs_error_m interval_coverage
spatial_r_squared spatial_rmse_m spatial_p95_abs_error_m spatial_interval_coverage
clearance_r_squared clearance_rmse_m clearance_p95_abs_error_m clearance_interval_coverage
"""


def test_columns_stay():
    """The columns of version 0.1, in their order: a column is neither renamed nor moved nor removed."""
    assert list(keys_of(scores.score_columns())) == SCORE_COLUMNS.split()
    figure_columns = FIGURE_COLUMNS.split()
    late = SCORE_COLUMNS.partition("instrument")[2].partition("spatial_r_squared")[0].split()
    compared = ["group", "method", *figure_columns, "scenario", "degradation", "instrument", "against", *late]
    assert list(keys_of(scores.compare_columns())) == compared


LABELS = {"recording": "a", "method": "overlay", "equations": "corrected", "reference": "ground_truth"}
OLD = {"r_squared": 0.99, "rmse_m": 1e-3, "p95_abs_error_m": None, "coverage": 1.0}


def test_shipped_baselines_survive_the_round_trip(golden, tmp_path):
    """What is written again is the file that was read, to the byte: also one from before there were alarms."""
    for path in (golden / "baseline.json", golden / "3d" / "baseline.json"):
        save_baseline(load_baseline(path), tmp_path / "again.json")
        again, before = (json.loads(file.read_text()) for file in (tmp_path / "again.json", path))
        assert again["scores"] == before["scores"]
        assert again["tolerances"] == before["tolerances"]


def test_an_older_score_has_fewer_figures():
    """Metrics that came later may be missing; the first four may not, and a figure that nobody knows is refused."""
    assert StoredScore.model_validate(LABELS | OLD).figures == OLD
    for key in OLD:
        with pytest.raises(ValidationError, match=f"there is no {key}"):
            StoredScore.model_validate(LABELS | {name: value for name, value in OLD.items() if name != key})
    with pytest.raises(ValidationError, match="there is no metric speed"):
        StoredScore.model_validate(LABELS | OLD | {"speed": 1.0})


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "Invalid JSON"),
        ("{}", "missing key schema; missing key tolerances; missing key scores$"),
        ('{"schema": "svmdist.baseline/2"}', "schema: .* 'svmdist.baseline/1' .*'svmdist.baseline/2'"),
        ('{"schema": "svmdist.baseline/1", "scores": [{}]}', "missing key tolerances; .*recording"),
    ],
    ids=["empty", "no schema", "another schema", "no figures"],
)
def test_what_is_no_baseline_is_one_line(tmp_path, text, said):
    path = tmp_path / "b.json"
    path.write_text(text)
    with pytest.raises(
        RecordingError, match=r"b\.json: not a baseline of schema svmdist\.baseline/1: " + said
    ) as caught:
        load_baseline(path)
    assert "\n" not in str(caught.value)
