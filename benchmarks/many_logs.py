"""Measure what many logs take: `uv run python -m benchmarks.many_logs FOLDER`, figures of docs/scale.md.

The folder's logs are linked a number of times, and estimated with one process and with several. Beside the time by the
clock, which a busy machine makes longer, stands the processor time of each process: the busiest one bounds how fast a
machine with a free core for each could be.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass, field
from pathlib import Path

LOOK_S = 0.2
TICKS_PER_S = os.sysconf("SC_CLK_TCK") if hasattr(os, "sysconf") else 100


@dataclass
class Taken:
    """What one run took: time by the clock, processor time and memory of each process over time."""

    wall_s: float = 0.0
    cpu_s: dict[int, float] = field(default_factory=dict)
    memory_mib: dict[int, list[float]] = field(default_factory=dict)


def main() -> None:
    """Run, and print a table in Markdown."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--count", type=int, default=1000)
    parser.add_argument("--jobs", type=int, nargs="+", default=[1, 2])
    parser.add_argument("--method", default="overlay")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=options.folder.parent) as made:
        logs = _linked(options.folder, Path(made) / "logs", options.count)
        print(
            "| jobs | wall [s] | logs/s | processor [s] | busiest process [s] | bound [logs/s] | memory [MiB] |"
        )
        print("|---|---|---|---|---|---|---|")
        outputs = set()
        for jobs in options.jobs:
            output = Path(made) / f"rows-{jobs}.csv"
            command = [
                "estimate",
                str(logs),
                "--method",
                options.method,
                "--jobs",
                str(jobs),
                "-o",
                str(output),
            ]
            print(_row(jobs, options.count, _run(command)), flush=True)
            outputs.add(output.read_bytes())
        print("\nThe rows are the same." if len(outputs) == 1 else "\nTHE ROWS DIFFER.")


def _linked(source: Path, folder: Path, count: int) -> Path:
    """A folder with so many logs: those of another one, again and again."""
    folder.mkdir()
    logs = sorted(source.glob("*.mcap"))
    for number in range(count):
        os.link(logs[number % len(logs)], folder / f"log-{number:05d}.mcap")
    return folder


def _run(command: list[str]) -> Taken:
    taken = Taken()
    begin_s = time.perf_counter()
    process = subprocess.Popen([sys.executable, "-m", "svmdist", *command], stderr=subprocess.DEVNULL)
    while process.poll() is None:
        for pid in _family(process.pid):
            _look(pid, taken)
        time.sleep(LOOK_S)
    taken.wall_s = time.perf_counter() - begin_s
    if process.returncode != 0:
        raise SystemExit(f"svmdist {' '.join(command)} ended with {process.returncode}")
    return taken


def _family(pid: int) -> list[int]:
    """A process and those that it began, on Linux."""
    try:
        children = Path(f"/proc/{pid}/task/{pid}/children").read_text().split()
    except OSError:
        return [pid]
    return [pid, *(one for child in children for one in _family(int(child)))]


def _look(pid: int, taken: Taken) -> None:
    try:
        fields = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()
        status = Path(f"/proc/{pid}/status").read_text()
    except OSError:
        return
    taken.cpu_s[pid] = (int(fields[11]) + int(fields[12])) / TICKS_PER_S
    for line in status.splitlines():
        if line.startswith("RssAnon:"):
            taken.memory_mib.setdefault(pid, []).append(int(line.split()[1]) / 1024)


def _row(jobs: int, count: int, taken: Taken) -> str:
    busiest_s = max(taken.cpu_s.values())
    memory = []
    for values in taken.memory_mib.values():
        if len(values) > 20:  # not of what only looked something up
            tenth = len(values) // 10
            memory.append(f"{max(values[: 2 * tenth]):.0f} → {max(values[-2 * tenth :]):.0f}")
    cells = (
        jobs,
        f"{taken.wall_s:.1f}",
        f"{count / taken.wall_s:.1f}",
        f"{sum(taken.cpu_s.values()):.1f}",
        f"{busiest_s:.1f}",
        f"{count / busiest_s:.1f}",
        ", ".join(memory),
    )
    return "| " + " | ".join(map(str, cells)) + " |"


if __name__ == "__main__":
    main()
