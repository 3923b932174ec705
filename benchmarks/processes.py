"""Whole commands against each other, in turn, as ratios of one run: what docs/performance.md shows.

`python -m benchmarks.processes FOLDER [NAME ...]` makes the logs that it needs in a folder, runs each comparison
A B A B … and prints the medians of the wall time and their ratio, pair by pair. Machines are noisy: look at the ratio.
"""

from __future__ import annotations

import statistics
import subprocess
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
SVMDIST = (sys.executable, "-m", "svmdist")
PLAIN = (sys.executable, str(HERE / "plain_loop.py"))
PAIRS = 5


@dataclass(frozen=True)
class Comparison:
    """Two commands, and what their ratio should be."""

    name: str
    first: Sequence[str]
    second: Sequence[str]
    target: str


def make_logs(folder: Path) -> tuple[Path, Path, Path]:
    """600 PNG frames; 200 stereo pairs as JPEG with a tag and kinematic error; one frame."""
    recipes = {
        "mono.mcap": "--scenario random --seed 5 --rate 30 --duration 20",
        "stereo.mcap": "--scenario random --seed 6 --rate 20 --duration 10 --stereo --tag --kinematic-error 1"
        " --noise 2 --jpeg 92",
        "one.mcap": "--scenario sweep --seed 3 --rate 5 --duration 0.2",
    }
    for name, options in recipes.items():
        if not (folder / name).exists():
            subprocess.run([*SVMDIST, "record", *options.split(), "-o", str(folder / name)], check=True)
    mono, stereo, one = (folder / name for name in recipes)
    return mono, stereo, one


def comparisons(folder: Path) -> list[Comparison]:
    """All of them."""
    mono, stereo, one = map(str, make_logs(folder))
    estimate = (*SVMDIST, "estimate")
    overlay, centroid = (
        (*estimate, mono, "--method", method, "-f", "csv", "-o", str(folder / "rows.csv"))
        for method in ("overlay", "centroid")
    )
    decode = (*PLAIN, mono, "decode")
    fused = (*estimate, stereo, "--method", "fused", "-f", "csv", "-o", str(folder / "rows.csv"))
    grid = (
        *SVMDIST,
        "blur-bench",
        str(stereo),
        "--grid",
        "--method",
        "fused",
        "--degradations",
        "noise,smoke",
    )
    grid = (*grid, "--severities", "2,3", "-f", "csv", "-o", str(folder / "grid.csv"))
    record = (*SVMDIST, "record", "--scenario", "random", "--duration", "15", "--force")
    record = (*record, "-o", str(folder / "record.mcap"))
    return [
        Comparison("overlay : reading and decoding alone", overlay, decode, "<= 1.5"),
        Comparison("overlay : the plain loop", overlay, (*PLAIN, mono), "<= 0.5"),
        Comparison("centroid : reading and decoding alone", centroid, decode, "<= 1.25"),
        Comparison(
            "compare, seven methods : fused alone",
            (*SVMDIST, "compare", stereo, "-f", "csv", "-o", str(folder / "compare.csv")),
            fused,
            "<= 1.3",
        ),
        Comparison("blur-bench --grid, one core : two", (*grid, "-j", "1"), (*grid, "-j", "2"), ">= 1.8"),
        Comparison("record, one core : two", (*record, "-j", "1"), (*record, "-j", "2"), ">= 1.8"),
        Comparison(
            "--help : import typer",
            (*SVMDIST, "--help"),
            (sys.executable, "-c", "import typer"),
            "<= 1.5",
        ),
        Comparison(
            "estimate of one frame : import cv2, numpy",
            (*estimate, one, "-f", "csv", "-o", str(folder / "rows.csv")),
            (sys.executable, "-c", "import cv2, numpy"),
            "0.45 s",
        ),
        Comparison(
            "fused, 200 stereo pairs : decoding them", fused, (*PLAIN, stereo, "decode"), "33 ms a frame"
        ),
    ]


def seconds(command: Sequence[str]) -> float:
    """Wall time of a command that must succeed."""
    start_s = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    return time.perf_counter() - start_s


def main(folder: Path, names: Sequence[str]) -> None:
    """Run the comparisons whose names contain one of the given ones; all without any."""
    folder.mkdir(parents=True, exist_ok=True)
    for each in comparisons(folder):
        if names and not any(name in each.name for name in names):
            continue
        seconds(each.first), seconds(each.second)  # what is compiled and cached on first use
        pairs = [(seconds(each.first), seconds(each.second)) for _ in range(PAIRS)]
        first_s, second_s = (statistics.median(times) for times in zip(*pairs, strict=True))
        ratio = statistics.median(a / b for a, b in pairs)
        print(
            f"{each.name}: {first_s:.2f} s, {second_s:.2f} s, ratio {ratio:.2f} (target {each.target})",
            flush=True,
        )


if __name__ == "__main__":
    main(Path(sys.argv[1]), sys.argv[2:])
