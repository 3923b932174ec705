"""The documentation's tables of the golden logs in 3D: methods side by side, and the alarms of `fused`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from svmdist.estimation.alarms import AlarmRules
from svmdist.estimation.methods import SPATIAL_METHODS
from svmdist.recording.log import Recording, open_recording
from svmdist.workflows.compare import Figures, Run, measure_runs, pooled_figures
from svmdist.workflows.estimate import estimate
from svmdist.workflows.request import Request, prepare
from svmdist.workflows.scoring.score import Distance, DistanceScore, Readings, Score, score_pairs
from svmdist.workflows.scoring.truth import Reference, TruthRules
from svmdist.workflows.validate import Validation, validate

RECORDINGS = Path(__file__).resolve().parent.parent / "recordings"
LOGS = ("3d/contact", "3d/duo")
REAL_LOGS = ("real/random", "real/contact")
ALARMS = AlarmRules(5e-3)
HEADER = (
    "| method | n / frames | spatial RMSE [mm] | p95 [mm] | in 95 % | clearance RMSE [mm] | p95 [mm] | in 95 % | ms |\n"
    "|---|---|---|---|---|---|---|---|---|\n"
)
BETWEEN = ("PSM1", "PSM2")
CLEARANCE_BETWEEN = Distance(
    "clearance between instruments",
    lambda found: found.to_instrument,
    lambda truth: truth.clearance_m,
)
LogRun = tuple[Recording, Run]
ALL = "### All methods in 3D, both logs and all instruments\n"


def measure_logs(names: Sequence[str] = LOGS) -> list[LogRun]:
    """Every method in 3D on golden logs, one run a method, log and instrument, timed by one core's work."""
    setups = [prepare(method=method) for method in SPATIAL_METHODS]
    recordings = [open_recording(RECORDINGS / f"{name}.mcap", setups[0].profile) for name in names]
    return [(one, run) for one in recordings for run in measure_runs(one, setups, jobs=1)]


def score_alarms(names: Sequence[str] = LOGS) -> Validation:
    """`fused` on golden logs, with its alarms."""
    setup = prepare(method="fused")
    recordings = [open_recording(RECORDINGS / f"{name}.mcap", setup.profile) for name in names]
    return validate(recordings, Request(setup, alarms=ALARMS, rules=TruthRules((Reference.GROUND_TRUTH,))))


def table_of_all(runs: Sequence[LogRun]) -> str:
    """The table over both logs and all instruments, as the README shows it too."""
    return _table(runs)


def score_between() -> DistanceScore:
    """`fused` on the log of two instruments: the clearance between them, against the simulator's."""
    setup = prepare(method="fused")
    path = RECORDINGS / "3d" / "duo.mcap"
    rows = [
        row
        for row in estimate(open_recording(path, setup.profile), setup)
        if row.instrument == BETWEEN[0] and row.measured
    ]
    stamps_ns = np.array([row.stamp_ns for row in rows], np.int64)
    topics = {"ground_truth_distance": f"/ground_truth/{'/'.join(BETWEEN)}/distance"}
    truth = open_recording(path, setup.profile, topics=topics).distance_track().at(stamps_ns)
    score = score_pairs(Readings(rows, (CLEARANCE_BETWEEN,)).pairs(CLEARANCE_BETWEEN, truth))
    assert score is not None
    return score


def make_results_3d(runs: Sequence[LogRun], alarms: Validation, between: DistanceScore) -> str:
    """The generated part of docs/results.md about the logs in 3D."""
    parts = [ALL, _table(runs)]
    for recording, instrument in dict.fromkeys((one, run.instrument) for one, run in runs):
        members = [(one, run) for one, run in runs if (one, run.instrument) == (recording, instrument)]
        parts += [f"### {_label(recording, instrument)}\n", _table(members)]
    parts += [f"### Between {' and '.join(BETWEEN)} in `duo`, `fused`\n", _between_table(between)]
    parts += [f"### Alarms of `fused`, clearance below {ALARMS.below_m * 1e3:g} mm\n", _alarm_table(alarms)]
    return "\n".join(parts)


def make_results_real(runs: Sequence[LogRun], alarms: Validation) -> str:
    """The generated part of docs/results.md about logs of worlds that are not the profile."""
    parts = ["### All methods in 3D, both logs\n", _table(runs)]
    for recording in dict.fromkeys(one for one, _ in runs):
        parts += [f"### {recording.name}\n", _table([pair for pair in runs if pair[0] == recording])]
    parts += [f"### Alarms of `fused`, clearance below {ALARMS.below_m * 1e3:g} mm\n", _alarm_table(alarms)]
    return "\n".join(parts)


def _label(recording: Recording, instrument: str) -> str:
    """What `validate` calls the scores of this instrument."""
    return recording.name if instrument == recording.instruments[0] else f"{recording.name} {instrument}"


def _table(runs: Sequence[LogRun]) -> str:
    figures: dict[str, list[Figures]] = {}
    for _, run in runs:
        figures.setdefault(run.method, []).append(run.figures)
    rows = (_row(method, pooled_figures(of)) for method, of in figures.items())
    return HEADER + "".join(rows)


def _row(method: str, figures: Figures) -> str:
    cells = (
        f"`{method}`",
        f"{figures.measured_count} / {figures.frame_count}",
        *_distance_cells(figures.spatial),
        *_distance_cells(figures.clearance),
        f"{figures.ms_per_frame:.0f}",
    )
    return f"| {' | '.join(cells)} |\n"


def _distance_cells(score: DistanceScore | None) -> tuple[str, str, str]:
    if score is None:
        return "–", "–", "–"
    assert score.interval_coverage is not None
    rmse_m, p95_m = score.statistics.rmse, score.statistics.p95_abs_error
    return f"{rmse_m * 1e3:.2f}", f"{p95_m * 1e3:.2f}", f"{score.interval_coverage * 100:.0f} %"


def _between_table(score: DistanceScore) -> str:
    cells = (str(len(score.pairs)), *_distance_cells(score), f"{score.statistics.bias * 1e3:.2f}")
    return (
        "| n | clearance RMSE [mm] | p95 [mm] | in 95 % | bias [mm] |\n"
        f"|---|---|---|---|---|\n| {' | '.join(cells)} |\n"
    )


def _alarm_table(validation: Validation) -> str:
    lines = [
        "| log | unsafe / frames | recall | precision | safe alarmed | false alarms / min | least lead [s] |",
        "|---|---|---|---|---|---|---|",
        *(_alarm_row(score) for score in (*validation.scores, *validation.overall)),
    ]
    return "\n".join(lines) + "\n"


def _alarm_row(score: Score) -> str:
    alarms = score.alarms
    assert alarms is not None
    least_s = alarms.min_lead_s
    cells = (
        score.recording,
        f"{alarms.unsafe_count} / {alarms.frame_count}",
        _share(alarms.recall),
        _share(alarms.precision),
        _share(alarms.false_alarm_fraction),
        "–" if alarms.false_alarms_per_minute is None else f"{alarms.false_alarms_per_minute:.1f}",
        "–" if least_s is None else f"{least_s:.2f}",
    )
    return f"| {' | '.join(cells)} |"


def _share(value: float | None) -> str:
    return "–" if value is None else f"{value * 100:.1f} %"
