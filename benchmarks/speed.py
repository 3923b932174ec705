"""Whole commands against each other, in turn, as ratios of one run: what docs/scale.md shows.

`uv run python -m benchmarks.speed FOLDER [NAME ...]` makes the logs that it needs in a folder, runs each comparison
A B A B … and prints a row of a table with the medians. Machines are noisy: look at the ratio.
"""

from __future__ import annotations

import os
import shlex
import shutil
import statistics
import subprocess
import sys
import time
from pathlib import Path

from benchmarks.generated_pages import table_row
from svmdist.report.html import page
from tests.recording.test_bombs import BOMBS
from tests.report.test_html import FLAGS, make_report, make_series

PAIRS = 5
MANY = 1000
# 600 PNG frames; 200 stereo pairs as JPEG with a tag; a log of four frames, to which there are a thousand links.
LOGS = {
    "mono.mcap": "--scenario random --seed 5 --rate 30 --duration 20",
    "stereo.mcap": "--scenario random --seed 6 --rate 20 --duration 10 --stereo --tag --kinematic-error 1"
    " --noise 2 --jpeg 92",
    "short.mcap": "--scenario random --seed 7 --rate 5 --duration 0.8 --jpeg 92",
}
FRAMES = {"few.html": 100, "many.html": 10_000}
FUSED = "svmdist estimate stereo.mcap --method fused -o a.csv"
RECORD = "svmdist record --scenario random --duration 15 --force -o a.mcap"
COMPARISONS = {
    "overlay : plain loop": ("svmdist estimate mono.mcap -o a.csv", "plain mono.mcap"),
    "overlay : reading and decoding": ("svmdist estimate mono.mcap -o a.csv", "plain mono.mcap decode"),
    "fused : decoding both views": (FUSED, "plain stereo.mcap decode"),
    "compare, seven methods : fused alone": ("svmdist compare stereo.mcap -o b.csv", FUSED),
    "record, one process : two": (f"{RECORD} -j 1", f"{RECORD} -j 2"),
    "1,000 logs, one process : two": (
        "svmdist estimate many -o a.csv -j 1",
        "svmdist estimate many -o b.csv -j 2",
    ),
    "--help : import typer": ("svmdist --help", "python -c 'import typer'"),
    "report of 10,000 frames in a browser : of 100": ("chromium many.html", "chromium few.html"),
    **{
        f"bomb {name} refused : a log of four images": (
            f"svmdist info {name.replace(' ', '-')}.mcap.bomb",
            "svmdist info short.mcap",
        )
        for name in BOMBS
    },
}
"""Two commands each, run in the folder of the logs."""
PROGRAMS = {
    "svmdist": [sys.executable, "-m", "svmdist"],
    "plain": [sys.executable, str(Path(__file__).with_name("plain_loop.py"))],
    "python": [sys.executable],
    # It ends once all is drawn: virtual time stands still while there is work.
    "chromium": [
        shutil.which("chromium") or "chromium-browser",
        "--headless",
        *FLAGS,
        "--virtual-time-budget=10000",
        "--dump-dom",
    ],
}


def run(command: str, folder: Path) -> tuple[float, float]:
    """Time by the clock and processor time in s of a command that must succeed, or refuse a bomb."""
    program, *arguments = shlex.split(command)
    before, start_s = os.times(), time.perf_counter()
    done = subprocess.run([*PROGRAMS[program], *arguments], cwd=folder, check=False, capture_output=True)
    if done.returncode not in (range(5) if ".bomb" in command else (0,)):
        sys.exit(f"{command}: {done.stderr.decode(errors='replace')}")
    after = os.times()
    processor_s = after.children_user + after.children_system - before.children_user - before.children_system
    return time.perf_counter() - start_s, processor_s


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    place, names = Path(sys.argv[1]), sys.argv[2:]
    place.mkdir(parents=True, exist_ok=True)
    for log, options in LOGS.items():
        if not (place / log).exists():
            run(f"svmdist record {options} -o {log}", place)
    if not (place / "many").exists():
        (place / "many").mkdir()
        for number in range(MANY):
            os.link(place / "short.mcap", place / "many" / f"log-{number:04d}.mcap")
    for name, frames in FRAMES.items():
        if not (place / name).exists():
            (place / name).write_text(page(make_report(make_series(frames, every=3))), "utf-8")
    for name, write in BOMBS.items():
        write(place / f"{name.replace(' ', '-')}.mcap.bomb")
    print("| comparison | ratio of wall time | of processor time |\n|---|---|---|")
    for name, (first, second) in COMPARISONS.items():
        if names and not any(part in name for part in names):
            continue
        run(first, place), run(second, place)  # what is compiled and cached on first use
        pairs = [(run(first, place), run(second, place)) for _ in range(PAIRS)]
        wall, processor = (statistics.median(a[at] / b[at] for a, b in pairs) for at in (0, 1))
        print(table_row((name, f"{wall:.2f}", f"{processor:.2f}")), end="", flush=True)
