"""docs/robustness.md: what worlds that are not as log and profile say do to each method, made from logs of one's own.

`uv run python -m benchmarks.robustness LOG.mcap [LOG.mcap ...]` measures each log as it is and in every world of
WORLDS, at replay. Logs of `record --world real` are measured as they are, in a row of their own.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from svmdist.perturbations.chosen import parse_perturbations
from svmdist.recording.log import Recording, open_recording
from svmdist.workflows.compare import Run, measure_runs
from svmdist.workflows.conditions import CLEAN, LogCondition, PerturbedCondition
from svmdist.workflows.request import Setup, prepare
from svmdist.workflows.scoring.score import Pairs, pooled

PAGE = Path(__file__).resolve().parent.parent / "docs" / "robustness.md"
METHODS = ("fiducial", "shaft", "stereo", "fused")
WORLDS = (
    *("focal=1", "principal_point=5", "focal=0.3,principal_point=1.5"),
    *("baseline=0.2", "right_yaw=0.3", "right_yaw=0.03", "right_pitch=0.3", "right_roll=0.3"),
    *("shaft_radius=5", "knuckle_radius=5", "tag_size=2", "tag_mount=0.5", "wrist_length=1"),
    *("backlash=0.5", "lag=30", "lag=80", "lag_drift=5", "joint_noise=0.05", "quantisation=0.1"),
    *("joint_drift=0.15", "joint_drift=0.5", "plane=1", "plane_tilt=2", "zoom=1.1"),
)
FAR_STDS = 5.0
"""So many stated deviations off is not bad luck: one frame in two million, were the deviations honest."""
HEAD = """# Robustness

What each method makes of a world that is not as log and profile say. One thing is changed at a time, at replay
([names and units](simulation.md#worlds-that-are-not-the-profile)). A cell has four figures: the spatial RMSE in mm, the
share of truths in the stated 95 % interval, that of frames which the method itself calls `inconsistent`, and that of
measured frames which are off by more than five stated deviations; shares in %. A dash: no frame was measured. What the
methods made of such worlds before November 2026 is kept [beside this page](robustness-before.md); [the limits of
`fused`](method/fused.md#limits) are what no log can show.

This page is made by `benchmarks/robustness.py` from logs of {frames} frames:

{logs}
"""


def measure(recordings: Sequence[Recording], methods: Sequence[str] = METHODS) -> list[LogRun]:
    """All methods on all logs in all worlds; a log of a real world stays as it is."""
    setups: list[Setup] = [prepare(method=method) for method in methods]
    everywhere: list[LogCondition] = [
        CLEAN,
        *(PerturbedCondition(parse_perturbations(text)) for text in WORLDS),
    ]
    runs: list[LogRun] = []
    for recording in recordings:
        is_perturbed = "perturb" in recording.metadata
        found = measure_runs(recording, setups, [CLEAN] if is_perturbed else everywhere)
        runs += [(recording, run) for run in found]
    return runs


def robustness_page(runs: Sequence[LogRun]) -> str:
    """The whole page."""
    recordings = dict.fromkeys(one for one, _ in runs)
    frames = sum(next(run.figures.frame_count for of, run in runs if of is one) for one in recordings)
    logs = "\n".join(f"- {_described(recording)}" for recording in recordings)
    return HEAD.format(frames=frames, logs=logs) + "\n" + robustness_table([run for _, run in runs])


def robustness_table(runs: Sequence[Run]) -> str:
    """One row a world, one column a method."""
    methods = list(dict.fromkeys(run.method for run in runs))
    lines = [f"| what differs | {' | '.join(methods)} |", "|---" * (1 + len(methods)) + "|"]
    for world in dict.fromkeys(_world(run) for run in runs):
        members = [run for run in runs if _world(run) == world]
        cells = [_cell([run for run in members if run.method == method]) for method in methods]
        lines.append(f"| {world or 'nothing'} | {' | '.join(cells)} |")
    return "\n".join(lines) + "\n"


LogRun = tuple[Recording, Run]


def far_share(pairs: Pairs, stds: float = FAR_STDS) -> float | None:
    """The share of pairs that are off by more than so many stated deviations; None where none is stated."""
    stated = np.isfinite(pairs.std_m)
    if not stated.any():
        return None
    error_m = np.abs(pairs.estimate_m - pairs.truth_m)
    return float(np.mean(error_m[stated] > stds * pairs.std_m[stated]))


def _world(run: Run) -> str:
    return run.group.degradation


def _cell(runs: Sequence[Run]) -> str:
    frames = sum(run.figures.frame_count for run in runs)
    inconsistent = sum(run.statuses.get("inconsistent", 0) for run in runs) / max(frames, 1)
    scored = [run.figures.spatial.pairs for run in runs if run.figures.spatial is not None]
    if not scored:
        return f"– / – / {100.0 * inconsistent:.0f} / –"
    pairs = pooled(scored)
    rmse_mm = 1e3 * float(np.sqrt(np.mean((pairs.estimate_m - pairs.truth_m) ** 2)))
    shares = (pairs.interval_coverage, inconsistent, far_share(pairs))
    return " / ".join([f"{rmse_mm:.2f}", *("–" if one is None else f"{100.0 * one:.0f}" for one in shares)])


def _described(recording: Recording) -> str:
    """The command that makes a log, by its metadata."""
    told = recording.metadata
    options = [f"--scenario {told.get('scenario', '?')} --seed {told.get('seed', '?')}"]
    options += [f"--{name}" for name in ("stereo", "tag") if name in told]
    named = {
        "duration": "duration_s",
        "rate": "rate_hz",
        "kinematic-error": "kinematic_error",
        "noise": "noise",
        "jpeg": "jpeg_quality",
    }
    options += [f"--{option} {told[key]}" for option, key in named.items() if key in told]
    if told.get("world") == "real":
        options.append("--world real")
    elif "perturb" in told:
        options.append(f"--perturb {told['perturb']}")
    return f"`svmdist record {' '.join(options)}`"


def main(paths: Sequence[str]) -> None:
    """Measure and write the page."""
    if not paths:
        sys.exit("usage: python -m benchmarks.robustness LOG.mcap [LOG.mcap ...]")
    profile = prepare(method=METHODS[0]).profile
    PAGE.write_text(robustness_page(measure([open_recording(path, profile) for path in paths])), "utf-8")


if __name__ == "__main__":
    main(sys.argv[1:])
