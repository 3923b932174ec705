"""The table of docs/results.md on what worlds that differ from the profile do to each method.

`uv run python -m benchmarks.robustness LOG.mcap [LOG.mcap ...] [--write]` measures each log as it is and in every world
of WORLDS, at replay. Logs that were recorded in another world are measured as they are.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence

import numpy as np

from benchmarks.generated_pages import DOCS, table, write_table
from svmdist.perturbations.chosen import parse_perturbations
from svmdist.recording.log import Recording, open_recording
from svmdist.workflows.compare import MethodScore, measure_runs
from svmdist.workflows.request import CLEAN, LogCondition, PerturbedCondition, prepare
from svmdist.workflows.scores import Pairs, pooled_score

METHODS = ("fiducial", "shaft", "stereo", "fused")
WORLDS = (
    *("focal=1", "principal_point=5", "baseline=0.2", "right_yaw=0.3", "right_roll=0.3"),
    *("shaft_radius=5", "knuckle_radius=5", "tag_size=2", "wrist_length=1"),
    *("backlash=0.5", "lag=80", "plane=1", "zoom=1.1"),
)
FAR_STDS = 5.0
"""So many standard deviations off is not bad luck: one frame in two million, if the deviations are right."""


def measure(recordings: Sequence[Recording], methods: Sequence[str] = METHODS) -> list[MethodScore]:
    """All methods on all logs in all worlds."""
    setups = [prepare(method=method) for method in methods]
    worlds: list[LogCondition] = [PerturbedCondition(parse_perturbations(text)) for text in WORLDS]
    runs: list[MethodScore] = []
    for recording in recordings:
        runs += measure_runs(recording, setups, [CLEAN, *([] if "perturb" in recording.metadata else worlds)])
    return runs


def robustness_table(runs: Sequence[MethodScore]) -> str:
    """One row per world, one column per method."""
    members: dict[str, dict[str, list[MethodScore]]] = {}
    for run in runs:
        members.setdefault(run.group.degradation, {}).setdefault(run.method, []).append(run)
    methods = list(dict.fromkeys(run.method for run in runs))
    rows = [
        [f"`{world}`" if world else "nothing", *(_cell(by_method.get(method, [])) for method in methods)]
        for world, by_method in members.items()
    ]
    return table(("what differs", *(f"`{method}`" for method in methods)), rows)


def far_share(pairs: Pairs) -> float:
    """The share of pairs that are off by more than FAR_STDS standard deviations."""
    known = np.isfinite(pairs.std_m)
    off_m = np.abs(pairs.estimate_m - pairs.truth_m)
    return float(np.mean(off_m[known] > FAR_STDS * pairs.std_m[known])) if known.any() else 0.0


def _cell(runs: Sequence[MethodScore]) -> str:
    """RMSE in mm, the share of truths inside the 95 % interval, and the frames that are far off or not measured."""
    missing = 1.0 - sum(run.figures.measured_count for run in runs) / sum(
        run.figures.frame_count for run in runs
    )
    text = "–"
    if score := pooled_score([run.figures.spatial for run in runs]):
        text = f"{1e3 * score.statistics.rmse:.2f} ({100 * (score.interval_coverage or 0.0):.0f})"
        if (far := 100 * far_share(score.pairs)) >= 0.5:
            text += f", {far:.0f}% far off"
    return text + (f", {100 * missing:.0f}% not measured" if missing >= 0.005 else "")


def main(arguments: Sequence[str]) -> None:
    """Print the table, and write it into the page where that is asked for."""
    paths = [argument for argument in arguments if argument != "--write"]
    if not paths:
        sys.exit(__doc__)
    profile = prepare(method=METHODS[0]).profile
    made = robustness_table(measure([open_recording(path, profile) for path in paths]))
    print(made)
    if "--write" in arguments:
        write_table(DOCS / "results.md", "robustness", made)


if __name__ == "__main__":
    main(sys.argv[1:])
