"""Remake what the documentation shows of the golden logs: the README's tables, docs/results.md and the pictures.

Run `uv run python -m benchmarks.golden_tables` after a change that moves figures, with
`planar`, `3d`, `real` or `pictures` for a part; tests hold the README's tables against what is measured.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from benchmarks.docs_3d import (
    REAL_LOGS,
    make_results_3d,
    make_results_real,
    measure_logs,
    score_alarms,
    score_between,
    table_of_all,
)
from benchmarks.pictures import IMAGES, PICTURES, make_picture
from svmdist.recording.log import open_recording
from svmdist.workflows.blur_bench import blur_bench
from svmdist.workflows.request import Request, Setup, prepare
from svmdist.workflows.scoring.score import Score
from svmdist.workflows.scoring.truth import Reference
from svmdist.workflows.validate import Validation, validate

ROOT = Path(__file__).resolve().parent.parent
LOGS = ("calibration", "sweep", "approach", "contact", "occlusion", "random")
README, RESULTS = ROOT / "README.md", ROOT / "docs" / "results.md"
BEGIN, END = "<!-- results:begin -->", "<!-- results:end -->"
MARKS_3D = ("<!-- results-3d:begin -->", "<!-- results-3d:end -->")
MARKS_REAL = ("<!-- results-real:begin -->", "<!-- results-real:end -->")


def results_table(validation: Validation, reference: Reference = Reference.GROUND_TRUTH) -> str:
    """The README's table: a row a log, then the overall row."""
    lines = [
        "| log | n / frames | R² | RMSE [mm] | RMSE 95 % [mm] | p95 [mm] | bias [mm] | σ [mm] |",
        "|---|---|---|---|---|---|---|---|",
    ]
    scores = [score for score in validation.scores if score.reference is reference]
    overall = [score for score in validation.overall if score.reference is reference]
    lines += [_markdown_row(score) for score in (*scores, *overall)]
    return "\n".join(lines) + "\n"


def _markdown_row(score: Score) -> str:
    s, interval = score.statistics, score.rmse_interval_m
    assert s is not None
    assert interval is not None
    name = f"{score.recording} (fitted on)" if score.fitted_on else score.recording
    cells = (
        f"**{name}**" if score.recording == "overall" else name,
        f"{score.sample_count} / {score.frame_count}",
        "–" if s.r_squared is None else f"{s.r_squared:.4f}",
        f"{s.rmse * 1e3:.2f}",
        f"{interval.low * 1e3:.2f}–{interval.high * 1e3:.2f}",
        f"{s.p95_abs_error * 1e3:.2f}",
        f"{s.bias * 1e3:.2f}",
        f"{s.truth_std * 1e3:.1f}",
    )
    return f"| {' | '.join(cells)} |"


def score_logs(setup: Setup, names: Sequence[str] = LOGS) -> Validation:
    """Score the golden logs."""
    recordings = [open_recording(ROOT / "recordings" / f"{name}.mcap", setup.profile) for name in names]
    return validate(recordings, Request(setup))


def with_table(text: str, table: str, marks: tuple[str, str] = (BEGIN, END)) -> str:
    """A document with what stands between the marks replaced."""
    begin, end = marks
    head, _, rest = text.partition(begin)
    _, _, tail = rest.partition(end)
    return f"{head}{begin}\n{table}{end}{tail}"


def blur_table(setup: Setup) -> str:
    """Table I of the paper beside ours, over all golden logs but the calibration log."""
    recordings = [open_recording(ROOT / "recordings" / f"{name}.mcap", setup.profile) for name in LOGS[1:]]
    lines = [
        "| blur | kernel [px] | features | paper | area [px²] | paper | features, marker | matches | inliers"
        " | coverage | RMSE [mm] |",
        "|---|---|---|---|---|---|---|---|---|---|---|",
    ]
    for row in blur_bench(recordings, setup):
        printed = row.printed
        lines.append(
            f"| {row.blur} | {row.kernel_px} | {row.keypoint_count:.1f} | {printed.keypoint_count if printed else '–'}"
            f" | {row.contour_area_px:.0f} | {printed.contour_area_px if printed else '–'}"
            f" | {row.marker_keypoint_count:.0f} | {row.match_count:.0f} | {row.inlier_count:.0f}"
            f" | {row.coverage:.1%} | {(row.rmse_m or 0.0) * 1e3:.2f} |"
        )
    return "\n".join(lines) + "\n"


def make_results(overlay: Validation, setup: Setup) -> str:
    """The generated part of docs/results.md."""
    centroid = score_logs(replace(setup, method="centroid"))
    printed = score_logs(prepare(equations="printed"))
    return "\n".join(
        [
            "### `overlay`, corrected, against the simulator's truth\n",
            results_table(overlay),
            "### `overlay`, corrected, against DH kinematics of the measured joints, as in the paper\n",
            results_table(overlay, Reference.KINEMATICS),
            "### `centroid`, the ablation without marker, against the simulator's truth\n",
            results_table(centroid),
            "### `overlay`, printed equations, against the simulator's truth\n",
            results_table(printed),
            "### Table I under blur\n",
            blur_table(setup),
        ]
    )


def make_planar() -> None:
    """Remake the tables of the planar logs."""
    setup = prepare()
    validation = score_logs(setup)
    _rewrite(README, results_table(validation))
    _rewrite(RESULTS, make_results(validation, setup))


def make_3d() -> None:
    """Remake the tables of the logs in 3D."""
    runs = measure_logs()
    _rewrite(README, table_of_all(runs), MARKS_3D)
    _rewrite(RESULTS, make_results_3d(runs, score_alarms(), score_between()), MARKS_3D)


def make_real() -> None:
    """Remake the tables of the logs of worlds that are not the profile."""
    runs = measure_logs(REAL_LOGS)
    _rewrite(README, table_of_all(runs), MARKS_REAL)
    _rewrite(RESULTS, make_results_real(runs, score_alarms(REAL_LOGS)), MARKS_REAL)


def make_pictures() -> None:
    """Remake the pictures, each by the command that its page shows."""
    for name in PICTURES:
        make_picture(name, IMAGES)


def _rewrite(document: Path, table: str, marks: tuple[str, str] = (BEGIN, END)) -> None:
    document.write_text(with_table(document.read_text("utf-8"), table, marks), "utf-8")


def main() -> None:
    """Remake everything, or the parts that are named."""
    parts = {"planar": make_planar, "3d": make_3d, "real": make_real, "pictures": make_pictures}
    for name in sys.argv[1:] or parts:
        if name not in parts:
            raise SystemExit(f"no part {name}: the choices are {', '.join(parts)}")
        parts[name]()
    print(f"remade {IMAGES}, {README} and {RESULTS}", file=sys.stderr)


if __name__ == "__main__":
    main()
