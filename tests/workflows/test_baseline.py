"""The baseline's file: what is written is read again, older files load, and a damaged one is refused."""

import json

import pytest
from pydantic import ValidationError

from svmdist.errors import RecordingError
from svmdist.workflows.validate import (
    StoredScore,
    load_baseline,
    save_baseline,
)

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
