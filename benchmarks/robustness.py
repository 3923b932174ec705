"""The table of docs/results.md on what worlds that differ from the profile do to each method.

`uv run python -m benchmarks.robustness LOG.mcap [LOG.mcap ...] [--write]` measures each log as it is and in every world
of WORLDS, at replay. Logs that were recorded in another world are measured as they are.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

from benchmarks.generated_pages import DOCS, table, write_table
from svmdist.perturbations import parse_perturbations
from svmdist.recording.log import open_recording
from svmdist.workflows.compare import MethodScore, measure_runs
from svmdist.workflows.request import CLEAN, Condition, prepare
from svmdist.workflows.scoring.scores import pooled_pairs

METHODS = ("fiducial", "shaft", "stereo", "fused")
WORLDS = (
    *("focal=1", "principal_point=5", "baseline=0.2", "right_yaw=0.3", "right_roll=0.3"),
    *("shaft_radius=5", "knuckle_radius=5", "tag_size=2", "wrist_length=1"),
    *("backlash=0.5", "lag=80", "plane=1", "zoom=1.1"),
)
FAR_STDS = 5.0  # is not bad luck: one frame in two million, if the deviations are right


def robustness_table(runs: Sequence[MethodScore]) -> str:
    """One row per world, one column per method."""
    members: dict[str, dict[str, list[MethodScore]]] = {}
    for run in runs:
        members.setdefault(run.group.degradation, {}).setdefault(run.method, []).append(run)
    rows = (
        [f"`{world}`" if world else "nothing", *(cell(by_method[method]) for method in METHODS)]
        for world, by_method in members.items()
    )
    return table(("what differs", *(f"`{method}`" for method in METHODS)), rows)


def cell(runs: Sequence[MethodScore], distance: str = "spatial") -> str:
    """RMSE in mm, the share of truths inside the 95 % interval, and the frames that are far off or not measured."""
    count = sum(run.figures.frame_count for run in runs)
    missing = 1.0 - sum(run.figures.measured_count for run in runs) / count
    text = "–"
    pairs = pooled_pairs([getattr(run.figures, distance) for run in runs])
    if pairs is not None and pairs.statistics is not None:
        text = f"{1e3 * pairs.statistics.rmse:.2f} ({100 * (pairs.interval_coverage or 0.0):.0f})"
        off_m = np.abs(pairs.estimate_m - pairs.truth_m)
        known = np.isfinite(pairs.std_m)
        far = 100 * np.mean(off_m[known] > FAR_STDS * pairs.std_m[known]) if known.any() else 0.0
        text += f", {far:.0f}% far off" if far >= 0.5 else ""
    return text + (f" [{100 * missing:.0f}%]" if missing >= 0.015 else "")


if __name__ == "__main__":
    if not (paths := [argument for argument in sys.argv[1:] if argument != "--write"]):
        sys.exit(__doc__)
    setups = [prepare(method=method) for method in METHODS]
    worlds = [Condition(world=parse_perturbations(text)) for text in WORLDS]
    runs: list[MethodScore] = []
    for path in paths:
        recording = open_recording(path, setups[0].profile)
        runs += measure_runs(recording, setups, [CLEAN, *([] if "perturb" in recording.metadata else worlds)])
    made = robustness_table(runs)
    print(made)
    if "--write" in sys.argv:
        write_table(DOCS / "results.md", "robustness", made)
