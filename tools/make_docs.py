"""Remake what the documentation shows of the golden logs: the README's table and pictures, docs/results.md.

Run `uv run python -m tools.make_docs` after a change that moves figures, with `planar`, `3d` or `real` for a part;
tests hold the README's tables against what is measured.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np

from svmdist.estimation.frame import Frame
from svmdist.estimation.planar.marker_detection import draw_outline
from svmdist.recording.reader import open_recording
from svmdist.report.plot import save_plot
from svmdist.results import FrameResult
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.marker.homography import square_corners
from svmdist.vision.marker.pattern import marker_pattern
from svmdist.workflows.blur_bench import blur_bench
from svmdist.workflows.replay import replay
from svmdist.workflows.scoring.score import Score
from svmdist.workflows.scoring.truth import Reference
from svmdist.workflows.setup import Setup, prepare
from svmdist.workflows.validate import Validation, validate
from tools.docs_3d import (
    REAL_LOGS,
    make_results_3d,
    make_results_real,
    measure_logs,
    score_alarms,
    score_between,
    table_of_all,
)
from tools.scene_picture import save_scene_picture

ROOT = Path(__file__).resolve().parent.parent
IMAGES = ROOT / "docs" / "images"
LOGS = ("calibration", "sweep", "approach", "contact", "occlusion", "random")
README, RESULTS = ROOT / "README.md", ROOT / "docs" / "results.md"
BEGIN, END = "<!-- results:begin -->", "<!-- results:end -->"
MARKS_3D = ("<!-- results-3d:begin -->", "<!-- results-3d:end -->")
MARKS_REAL = ("<!-- results-real:begin -->", "<!-- results-real:end -->")
SCENE_FRAME = 60
"""A frame of the log of two instruments that shows both, one of them 5 mm over the organ."""


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


def annotate(frame: Frame, result: FrameResult, setup: Setup) -> Image:
    """Draw what the estimator saw: tissue and instrument, the marker's outline, the line that is measured."""
    picture = frame.left.context.bgr_as_recorded.copy()
    _, instrument = frame.tool.regions_as_recorded
    assert instrument is not None
    tool_px = np.array(result.image.tool_px, np.float64)
    tissue_px = np.array(result.image.tissue_px, np.float64)
    size_px = setup.profile.marker.size_px
    corners_px = square_corners(size_px) - (size_px - 1) / 2.0 + tool_px
    _blend_marker(picture, corners_px, setup)
    cv2.drawContours(picture, [instrument.hull], -1, (255, 255, 255), 1, cv2.LINE_AA)
    draw_outline(picture, corners_px, setup.profile.marker)
    start, end = np.round(tissue_px).astype(int).tolist(), np.round(tool_px).astype(int).tolist()
    cv2.line(picture, start, end, (255, 255, 255), 2, cv2.LINE_AA)
    cv2.drawMarker(picture, start, (255, 255, 255), cv2.MARKER_CROSS, 14, 2, cv2.LINE_AA)
    planar = result.distances.planar
    assert planar is not None
    text = f"{planar.value_m * 1e3:.1f} mm"
    middle = ((np.array(start) + end) // 2 + [10, -10]).tolist()
    for colour, width in (((30, 30, 30), 5), ((255, 255, 255), 2)):
        cv2.putText(picture, text, middle, cv2.FONT_HERSHEY_SIMPLEX, 0.7, colour, width, cv2.LINE_AA)
    return picture


def _blend_marker(picture: Image, corners_px: Array, setup: Setup) -> None:
    """Lay the marker over the picture, half transparent: the estimator pastes it opaque and sees nothing below."""
    size_px = setup.profile.marker.size_px
    x, y = np.round(corners_px[0]).astype(int)
    window = picture[y : y + size_px, x : x + size_px]
    pattern = cv2.cvtColor(marker_pattern(size_px), cv2.COLOR_GRAY2BGR)
    window[:] = cv2.addWeighted(window, 0.55, pattern, 0.45, 0.0)


def make_frame_picture(setup: Setup, path: Path, index: int = 30) -> None:
    """Save one annotated frame of the sweep log."""
    recording = open_recording(ROOT / "recordings" / "sweep.mcap", setup.profile)
    for number, (replayed,) in enumerate(replay(recording, [setup])):
        if number == index and replayed.frames:
            cv2.imwrite(str(path), annotate(replayed.frames[0], replayed.results[0], setup))
            return
    raise SystemExit(f"the sweep log has no frame {index}")


def score_logs(setup: Setup, names: Sequence[str] = LOGS) -> Validation:
    """Score the golden logs."""
    recordings = [open_recording(ROOT / "recordings" / f"{name}.mcap", setup.profile) for name in names]
    return validate(recordings, setup)


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
    """Remake the tables and pictures of the planar logs."""
    setup = prepare()
    make_frame_picture(setup, IMAGES / "frame.png")
    validation = score_logs(setup)
    save_plot(validation, IMAGES / "validation.png")
    _rewrite(README, results_table(validation))
    _rewrite(RESULTS, make_results(validation, setup))


def make_3d() -> None:
    """Remake the tables and the pictures of the logs in 3D."""
    setup = prepare(method="fused")
    duo = open_recording(ROOT / "recordings" / "3d" / "duo.mcap", setup.profile)
    save_scene_picture(duo, setup, SCENE_FRAME, IMAGES / "scene.jpg")
    runs = measure_logs()
    _rewrite(README, table_of_all(runs), MARKS_3D)
    alarms = score_alarms()
    save_plot(alarms, IMAGES / "clearance.png")
    _rewrite(RESULTS, make_results_3d(runs, alarms, score_between()), MARKS_3D)


def make_real() -> None:
    """Remake the tables of the logs of worlds that are not the profile."""
    runs = measure_logs(REAL_LOGS)
    _rewrite(README, table_of_all(runs), MARKS_REAL)
    _rewrite(RESULTS, make_results_real(runs, score_alarms(REAL_LOGS)), MARKS_REAL)


def _rewrite(document: Path, table: str, marks: tuple[str, str] = (BEGIN, END)) -> None:
    document.write_text(with_table(document.read_text("utf-8"), table, marks), "utf-8")


def main() -> None:
    """Remake everything, or the parts that are named."""
    IMAGES.mkdir(parents=True, exist_ok=True)
    parts = {"planar": make_planar, "3d": make_3d, "real": make_real}
    for name in sys.argv[1:] or parts:
        if name not in parts:
            raise SystemExit(f"no part {name}: the choices are {', '.join(parts)}")
        parts[name]()
    print(f"remade {IMAGES}, {README} and {RESULTS}", file=sys.stderr)


if __name__ == "__main__":
    main()
