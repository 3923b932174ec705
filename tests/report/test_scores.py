"""Scores as rows, documents and tables, from small synthetic results."""

import csv
import io
import json
from dataclasses import replace

import numpy as np
import pytest

from svmdist.report.scores import (
    compare_results,
    remarks,
    validation_document,
    validation_results,
    validation_tables,
)
from svmdist.report.tables import csv_lines, keys_of, render
from svmdist.workflows.compare import Group, MethodScore
from svmdist.workflows.scoring.references import Reference
from svmdist.workflows.scoring.scores import Figures, Pairs, Score
from svmdist.workflows.validate import Validation

START_NS = 1_700_000_000_000_000_000


def score(
    name: str = "sweep",
    count: int = 60,
    reference: Reference = Reference.GROUND_TRUTH,
    fitted_on: bool = False,
    constant: bool = False,
) -> Score:
    """A score over a smooth distance with half a millimetre of noise, and a gap of ten frames in the middle."""
    rng = np.random.default_rng(1)
    truth_m = 0.03 + (0.0 if constant else 0.01) * np.sin(np.arange(count) / 9)
    estimate_m = truth_m + rng.normal(scale=5e-4, size=count)
    frames = np.arange(count) + 10 * (np.arange(count) >= count // 2)
    stamps_ns = START_NS + frames.astype(np.int64) * 100_000_000
    pairs = Pairs(stamps_ns, estimate_m, truth_m, np.full(count, np.nan))
    rejected = {"no_instrument": 9, "no_tissue": 1}
    return Score(
        *(count + 12, count + 2),
        planar=pairs or None,
        recording=name,
        method="overlay",
        equations="corrected",
        reference=reference,
        rejected=rejected,
        fitted_on=fitted_on,
    )


def validation(*names: str, **changes: object) -> Validation:
    """A validation with a score per name and an overall score."""
    scores = tuple(score(name, **changes) for name in names)
    return Validation(scores, (replace(scores[0], recording="overall"),), ("a note",))


def strict(document: object) -> dict[str, object]:
    """A document as JSON holds it; NaN and Infinity, which Python's json would accept, are refused."""
    return dict(json.loads(json.dumps(document, allow_nan=False)))


@pytest.mark.parametrize("changes", [{"constant": True}, {"count": 3}, {"count": 0}])
def test_undefined_metrics_are_null(changes):
    """A still truth, few pairs and no pairs leave R², intervals or all metrics out, alike in CSV and JSON."""
    made = validation("a", **changes)
    (row, *_) = strict(validation_document(made))["recordings"]
    results = validation_results(made)
    cells = next(csv.DictReader(io.StringIO("".join(csv_lines(results)))))
    assert None in row.values()
    empty = {key for key, cell in cells.items() if not cell}
    assert empty == {key for key, value in row.items() if value is None}
    assert "nan" not in render(results.tables[0])


def test_the_overall_score_is_against_the_strongest_reference():
    """With both references `overall` is against the simulator's truth, and both are listed by reference."""
    both = tuple(score(reference=reference) for reference in (Reference.KINEMATICS, Reference.GROUND_TRUTH))
    document = validation_document(Validation(both, both, ("a note",)))
    assert (document["overall"]["reference"], document["notes"]) == (str(Reference.GROUND_TRUTH), ["a note"])
    assert list(document["overall_by_reference"]) == ["kinematics", "ground_truth"]
    assert validation_document(Validation(both, (), ()))["overall"] is None


def test_the_table_shows_r_squared_with_rmse_sigma_and_n():
    """R² never stands alone; names cannot drive a terminal. Remarks say what the table has no room for.

    Of a method in 3D nothing is said about the paper's plane.
    """
    made = validation("[/no]\x1b", fitted_on=True)
    statistics = made.scores[0].statistics
    shown = render(validation_tables(made)[0])
    assert all(part in shown for part in ("in mm", "R²", "RMSE", "σ (of the truth)", "cov. %", "bias", " n "))
    row = next(line for line in shown.splitlines() if "[/no]\N{REPLACEMENT CHARACTER}" in line)
    lengths = [f"{value * 1e3:.2f}" for value in (statistics.rmse, statistics.truth_std)]
    assert all(value in row for value in (f"{statistics.r_squared:.4f}", *lengths))
    remark, note = remarks(made)
    assert "fitted on this log" in remark
    assert "not measured: 9 no_instrument, 1 no_tissue of 72 frames" in remark
    assert "The paper reports R² = 78%" in note
    in_3d = replace(made, scores=(replace(score(), method="fused"),))
    assert render(validation_tables(in_3d)[0]).startswith("fused, planar distance; ")
    assert not any("paper" in remark for remark in remarks(in_3d))


def test_distances_in_3d_have_a_table_of_their_own():
    """A row for each distance, with its own figures in mm and the share of truths in its intervals."""
    planar = score().planar
    spatial = replace(planar, estimate_m=planar.truth_m + 2e-3, std_m=np.full(len(planar), 1e-3))
    made = validation("sweep")
    made = replace(made, scores=(replace(made.scores[0], spatial=spatial, clearance=planar),), overall=())
    _, below = validation_tables(made)
    rows = {row[2]: row for row in below.rows}
    assert list(rows) == ["planar", "spatial", "clearance"]
    assert "2.00" in rows["spatial"]
    assert "0.0" in rows["spatial"]
    assert rows["planar"][3:] == rows["clearance"][3:] != rows["spatial"][3:]


def test_a_comparison_names_each_distance_once():
    """In SI in rows and in mm in tables; the distance over its first column, the method's time last, – for nothing."""
    truth_m = np.linspace(0.01, 0.02, 10)
    half_mm = Pairs(np.arange(10), truth_m + 5e-4, truth_m, np.full(10, np.nan))
    figures = Figures(20, 10, 0.068, half_mm, None, half_mm)
    results = compare_results([MethodScore(Group("sweep"), "fused", figures)])
    (row,), (table,) = results.rows, results.tables
    assert (row["rmse_m"], row["coverage"], row["spatial_rmse_m"]) == (pytest.approx(5e-4), 0.5, None)
    stored = keys_of(results.columns)
    at = stored.index("scenario")
    assert stored[at : at + 4] == ("scenario", "degradation", "instrument", "against")
    headings = [tuple(heading.split("\n")) for heading in table.headings[1:]]
    assert (headings[0], headings[-1]) == (("cov.", "%"), ("ms",))
    assert [upper for upper, _ in headings[1:-1] if upper] == ["planar", "spatial", "clear."]
    assert [lower for _, lower in headings[1:5]] == ["R²", "RMSE", "p95", "∈95 %"]
    assert [table.rows[0][at] for at in (1, 3, 7, -1)] == ["50.0", "0.50", "–", "3"]


def test_summaries_are_written_in_markup(golden, cli, tmp_path):
    """LaTeX and Markdown have the numbers of the JSON, in mm."""
    command = ("validate", golden / "sweep.mcap", "--every", 8)
    found = cli(*command, "-f", "json").json["recordings"][0]
    text = cli(*command, "-f", "latex").out
    assert f"{found['rmse_m'] * 1e3:.2f}" in text
    assert text.count(r"\begin{table}") == text.count(r"\end{table}") >= 1
    cli(*command, "-o", tmp_path / "a.md")
    assert (tmp_path / "a.md").read_text().count("|---") >= 1
