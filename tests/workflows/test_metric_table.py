"""The columns that users rely on, metrics that are declared once, and the baseline's file."""

import json
from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from pydantic import ValidationError

from benchmarks.generated_pages import DOCS, metrics_page
from svmdist.errors import RecordingError
from svmdist.estimation.alarms import AlarmRules
from svmdist.metrics import alarm_statistics
from svmdist.report import scores
from svmdist.report.tables import csv_lines, keys_of, render
from svmdist.workflows.compare import Group, MethodScore
from svmdist.workflows.scoring import metric_table
from svmdist.workflows.scoring.metric_table import EVERYWHERE, IN_3D, LENGTH, Metric, Tolerance
from svmdist.workflows.scoring.references import Reference
from svmdist.workflows.scoring.scores import Figures, Pairs, Score
from svmdist.workflows.validate import StoredScore, Validation, load_baseline, save_baseline

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
rotation_p95_rad
"""
FIGURE_COLUMNS = """
frame_count measured_count coverage ms_per_frame r_squared rmse_m p95_abs_error_m interval_coverage
spatial_r_squared spatial_rmse_m spatial_p95_abs_error_m spatial_interval_coverage
clearance_r_squared clearance_rmse_m clearance_p95_abs_error_m clearance_interval_coverage
"""


def pairs(error_m: float = 1e-3) -> Pairs:
    """Twenty pairs; the k-th of them is off by k times an error."""
    truth_m = np.linspace(0.01, 0.03, 20)
    stamps_ns = np.arange(20, dtype=np.int64) * 100_000_000
    return Pairs(stamps_ns, truth_m + error_m * np.arange(20), truth_m, np.full(20, 5e-3))


def validation(error_m: float = 1e-3) -> Validation:
    """A validation with a score in 3D and alarms."""
    distance, rules = pairs(error_m), AlarmRules(0.02)
    alarms = alarm_statistics(distance.stamps_ns / 1e9, distance.estimate_m < 0.02, distance.truth_m, 0.02)
    score = Score(
        *(20, 20),
        recording="a",
        method="fused",
        equations="corrected",
        reference=Reference.GROUND_TRUTH,
        rejected={},
        planar=distance,
        spatial=distance,
        clearance=distance,
        alarms=alarms,
    )
    return Validation((score,), (replace(score, recording="overall"),), (), rules)


def test_columns_stay():
    """The columns of version 0.1, in their order: a column is neither renamed nor moved nor removed."""
    assert list(keys_of(scores.score_columns())) == SCORE_COLUMNS.split()
    figure_columns = FIGURE_COLUMNS.split()
    late = SCORE_COLUMNS.partition("instrument")[2].split()
    compared = ["group", "method", *figure_columns, "scenario", "degradation", "instrument", "against", *late]
    assert list(keys_of(scores.compare_columns())) == compared


@pytest.fixture
def added(monkeypatch: pytest.MonkeyPatch) -> Iterator[str]:
    """The key of a metric that is declared in one place, and nowhere else: the 99th percentile of the error."""
    metric = Metric(
        "p99_abs_error_m",
        LENGTH,
        "p99",
        lambda d: float(np.percentile(np.abs(d.estimate_m - d.truth_m), 99)),
        outputs=EVERYWHERE,
        tolerance=Tolerance(absolute=1e-5),
        outputs_in_3d=IN_3D,
        tolerance_in_3d=Tolerance(absolute=1e-5),
        is_late=True,
    )
    monkeypatch.setattr(metric_table, "ERRORS", (*metric_table.ERRORS, metric))
    return metric.key


def test_a_new_metric_is_declared_once(added):
    """It stands in all tables, CSV, JSON, baselines and the documentation; its columns come late."""
    keys = [added, f"spatial_{added}", f"clearance_{added}"]
    expected = np.percentile(1e-3 * np.arange(20), 99)
    made = validation()
    every = list(keys_of(scores.score_columns()))
    assert set(keys) < set(every[every.index("instrument") :])
    results = scores.validation_results(made)
    row = next(iter(results.rows))
    assert [row[key] for key in keys] == pytest.approx([expected] * 3)
    header, cells = (line.split(",") for line in csv_lines(replace(results, rows=[row])))
    assert float(cells[header.index(keys[-1])]) == pytest.approx(expected)
    document = json.loads(json.dumps(scores.validation_document(made)))
    assert document["overall"][added] == pytest.approx(expected)
    planar, in_3d, _ = (render(table) for table in scores.validation_tables(made))
    for shown in (planar, in_3d):
        assert "p99" in shown
        assert f"{expected * 1e3:.2f}" in shown
    assert f"|`{keys[0]}`, `{keys[1]}`, `{keys[2]}`|1e-05 m|" in metrics_page(
        (DOCS / "metrics.md").read_text("utf-8")
    )
    distance = pairs()
    figures = Figures(20, 20, 3.0, distance, distance, distance)
    compared = scores.compare_results([MethodScore(Group("sweep"), "fused", figures)])
    stored = keys_of(compared.columns)
    assert set(keys) < set(stored[stored.index("instrument") :])
    assert [{*row} for row in compared.rows] == [{*stored}]
    assert render(compared.tables[0]).count("p99") == 3


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
    "text",
    ["", "{}", '{"schema": "svmdist.baseline/2"}', '{"schema": "svmdist.baseline/1", "scores": [{}]}'],
    ids=["empty", "no schema", "another schema", "no figures"],
)
def test_what_is_no_baseline_is_one_line(tmp_path, text):
    path = tmp_path / "b.json"
    path.write_text(text)
    with pytest.raises(RecordingError, match=r"b\.json: not a baseline of schema svmdist\.baseline/1"):
        load_baseline(path)
