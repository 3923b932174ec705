"""docs/real-data.md: what each method measures on public images of real instruments, fetched beforehand to a folder.

`uv run python -m benchmarks.real_images FOLDER [--out DIR] [--write] [--methods shaft,stereo,fused]` runs on whatever
of the sets is in FOLDER: thrust (fdheenmo/thrust), Surgical_Tool_Tracking (ambareeshsrja16/Surgical_Tool_Tracking,
SuPer Deep) and ReCoDE-HandEyeCalibration (ImperialCollegeLondon/ReCoDE-HandEyeCalibration). Logs are made by its own
import, profiles by its `profile new`, the camera-to-base transform by its `hand-eye`. DIR gets logs, profiles and
overlays; `--write` writes the page.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

from benchmarks.real_sets import recode, super_deep, thrust
from benchmarks.real_sets.figures import SetFigures

PAGE = Path(__file__).resolve().parent.parent / "docs" / "real-data.md"
BEGIN, END = "<!-- real-bench:begin -->", "<!-- real-bench:end -->"
SETS = (thrust, super_deep, recode)
METHODS = ("shaft", "stereo", "fused")


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure the sets that are there, print their tables, and write the page where that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else None)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("real-bench"))
    parser.add_argument("--methods", default=",".join(METHODS))
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args(arguments)
    methods = given.methods.split(",")
    parts: list[str] = []
    for bench in SETS:
        if not bench.is_in(given.folder):
            print(
                f"{bench.NAME}: not in {given.folder}; it is the public repository {bench.REPOSITORY}",
                file=sys.stderr,
            )
            continue
        figures: SetFigures = bench.measure(given.folder, given.out / bench.KEY, methods)
        parts.append("\n".join(figures.lines()))
        print(parts[-1], end="\n\n")
    if not parts:
        return 1
    if given.write:
        text = PAGE.read_text("utf-8")
        head, _, rest = text.partition(BEGIN)
        tail = rest.partition(END)[2]
        PAGE.write_text(f"{head}{BEGIN}\n" + "\n\n".join(parts) + f"\n{END}{tail}", "utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
