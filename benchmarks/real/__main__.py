"""The page of real images: `uv run python -m benchmarks.real FOLDER [--out DIR] [--only NAME] [--write]`.

Runs on whatever of the sets is in FOLDER, fetched beforehand (`git clone` of the repositories that docs/real-data.md
names). Logs and profiles in DIR are made by the program's own commands. With --only, other sets' rows are those of
the last run.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from pathlib import Path

import cv2

from benchmarks.generated_pages import DOCS, table, write_table
from benchmarks.real import (
    bop,
    d_lfd,
    endovis_2015,
    in_vivo,
    laparoscopy,
    open_cas,
    operations,
    recode,
    super_deep,
    thrust,
    ucl,
)
from benchmarks.real.common import COLUMNS

SETS = {
    module.__name__.rpartition(".")[2]: module
    for module in (
        *(thrust, super_deep, d_lfd, recode, bop),
        *(in_vivo, laparoscopy, operations, endovis_2015, ucl, open_cas),
    )
}

if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("real-images"))
    parser.add_argument("--only", choices=SETS)
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args()
    cv2.setNumThreads(1)
    rows: list[list[str]] = []
    for name, module in SETS.items():
        stored = given.out / f"{name}.json"
        if given.only in (None, name):
            if not (given.folder / module.SET).is_dir():
                print(f"{given.folder / module.SET}: not there", file=sys.stderr)
                continue
            try:
                cells = [line.cells for line in module.measure(given.folder, given.out / name)]
            except subprocess.CalledProcessError as problem:
                print(f"{name}: {problem}", file=sys.stderr)  # its rows are those of the last run
            else:
                stored.write_text(json.dumps(cells), "utf-8")
        if stored.exists():
            rows += json.loads(stored.read_text("utf-8"))
    text = table(COLUMNS, rows)
    print(text)
    if given.write:
        write_table(DOCS / "real-data.md", "real-images", text)
