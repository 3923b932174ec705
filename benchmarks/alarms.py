"""The table of docs/results.md on alarms: recall and false alarms by method, threshold and probability.

`uv run python -m benchmarks.alarms LOG.mcap [LOG.mcap ...] [--write]` measures logs with ground truth. Frames without
a clearance raise no alarm; unsafe ones are counted by themselves, and are in no recall.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence

import numpy as np

import svmdist
from benchmarks.generated_pages import DOCS, table, write_table
from benchmarks.golden_tables import METHODS
from svmdist.estimation.alarms import WHEN, AlarmRules, AlarmWatch
from svmdist.recording.log import Recording
from svmdist.results import FrameResult

BELOW_M = 1e-3, 5e-3
Measured = tuple[Sequence[FrameResult], np.ndarray]


def measured(log: Recording, method: str) -> Measured:
    """The rows of a log, and their true clearances in m, shape (n,)."""
    rows = list(svmdist.estimate(log, method))
    truth = log.distance_track().at(np.array([row.stamp_ns for row in rows], np.int64))
    return rows, np.where(truth.valid, truth.values[:, 2], np.nan)


def cells(logs: Sequence[Measured], below_m: float) -> Iterator[str]:
    """Unsafe frames without a clearance, of all; then percentages of unsafe and of safe frames that are alarmed."""
    true_m = np.concatenate([clearance_m for _, clearance_m in logs])
    for at, when in enumerate(WHEN):
        states = []
        for rows, _ in logs:
            watch = AlarmWatch(AlarmRules(below_m, when))
            states += [watch.watch(row).is_raised for row in rows]
        measured, alarms = np.array([state is not None for state in states]), np.array(states) == True  # noqa: E712
        unsafe, safe = true_m < below_m, true_m >= below_m
        if at == 0:
            yield f"{(unsafe & ~measured).sum()}/{unsafe.sum()}"
        yield "/".join(f"{100 * alarms[measured & of].mean():.1f}" for of in (unsafe, safe))


if __name__ == "__main__":
    if not (paths := [argument for argument in sys.argv[1:] if argument != "--write"]):
        sys.exit(__doc__)
    found = []
    for method in METHODS:
        logs = [measured(svmdist.open_recording(path), method) for path in paths]
        found.append([f"`{method}`", *(cell for below_m in BELOW_M for cell in cells(logs, below_m))])
    headings = (name for below_m in BELOW_M for name in (f"below {1e3 * below_m:g} mm: not measured", *WHEN))
    text = table(("method", *headings), found)
    if "--write" in sys.argv:
        write_table(DOCS / "results.md", "alarms", text)
    print(text)
