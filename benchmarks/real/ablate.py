"""docs/ablation.md: what each special case of `auto` adds to network and estimator, set by set, on real images.

`uv run python -m benchmarks.real.ablate FOLDER [--out DIR] [--jobs N] [--only PART ...] [--write]` leaves out one part
at a time and measures the sets in FOLDER as `benchmarks.real` does.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any
from unittest.mock import patch

import cv2
import numpy as np

from benchmarks.generated_pages import DOCS, table, write_table
from benchmarks.real import common
from benchmarks.real.__main__ import SETS
from svmdist.estimation.instrument.shaft import ShaftDetection, ShaftSizes
from svmdist.vision import edge_lines, silhouette
from svmdist.vision.instruments import outline_search

OF_INSTRUMENTS = (
    *("thrust", "d_lfd", "super_deep", "recode"),
    *("in_vivo", "laparoscopy", "operations", "endovis_2015"),
)
"""The sets that are measured."""
COLUMNS = {
    "thrust": ("thrust", "`shaft`", "red joint"),
    "thrust, pairs": ("thrust", "`stereo`", "red joint"),
    "d-lfd": ("d-lfd", "`shaft`", "robot, fitted"),
    "d-lfd, pairs": ("d-lfd", "`stereo`", "robot, fitted"),
    "SuPer Deep": ("SuPer Deep", "`shaft`", "wrist"),
    "ReCoDE": ("ReCoDE", "`shaft`", "hinge"),
    "in vivo": ("in vivo", "`shaft`", "tip"),
    "laparoscopy, end": ("laparoscopy", "`shaft`", "shaft's end"),
    "operations": ("operations", "`shaft`", "outlines"),
    "EndoVis 2015": ("EndoVis 2015", "`shaft`", "masks; width"),
}
"""Of the table, each a line of the page of real images: its set, method and reference."""


def own_end(sizes: ShaftSizes, shaft: ShaftDetection, default_std_m: float) -> tuple[float, float]:
    """A shaft's end as if it were surely what it seems, of the dark part or of the outline."""
    assert shaft.rim is not None
    if shaft.rim.is_outline:
        return sizes.outline_end_m, sizes.outline_end_std_m
    return -sizes.end_m, sizes.end_std_m(default_std_m)


def nothing_unlike(_: Any, flanks: Any, __: Any) -> Any:
    """No pixel beside a wrist looks unlike what is there."""
    return np.zeros_like(flanks)


CASES: dict[str, tuple[object, str, Any]] = {
    "nothing": (edge_lines, "edge_within", edge_lines.edge_within),
    "material's change": (outline_search, "_material", lambda _, middle, *__: np.zeros(len(middle))),
    "colours beyond sides": (outline_search, "_of_beyond", lambda *_: 0.0),
    "likelier end": (ShaftSizes, "with_likelier_end", lambda _, seen, __: seen),
    "other end": (ShaftSizes, "rim_ahead", own_end),
    "wrist's colours": (silhouette, "_unlike_flanks", nothing_unlike),
    "evidence": (silhouette, "_agrees", lambda *_: True),
    "shadows": (silhouette, "edge_within", lambda *_: None),
}
"""What replaces a part that is left out. What lies beyond a side, whose colours most inside of it must not have; the
likelier of a shaft's two ends, as its sizes have it, and the other one; what of a wrist is beside its mask, by its
colours; the evidence that a sharp edge must be near to; a shadow's colour.
"""


def cells(part: str, folder: Path, out: Path) -> list[str]:
    """A row of the table."""
    cv2.setNumThreads(1)
    place, attribute, by = CASES[part]
    lines: dict[tuple[str, str, str], common.Line] = {}
    with patch.object(place, attribute, by):
        for name, module in SETS.items():
            if name in OF_INSTRUMENTS and (folder / module.SET).is_dir():
                for line in module.measure(folder, out / part.replace(" ", "-") / name):
                    lines[line.of, line.method, line.against] = line
                    if all(key in lines for key in COLUMNS.values() if key[0] == line.of):
                        break  # what follows is not shown
    return [part, *(cell(lines[key].own) if key in lines else "–" for key in COLUMNS.values())]


def cell(figures: common.Figures) -> str:
    """The median error over the number of rows, as 1.88/50, or these alone; in brackets how many are beside it."""
    text = figures.rows.partition("/")[0]
    if len(figures.errors):
        text = f"{common.number(figures.errors)}/{text}"
    beside = int(np.count_nonzero(np.array(figures.on) < common.ON_INSTRUMENT))
    return f"{text}[{beside}]" if beside else text


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("real-images"))
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--only", nargs="+", choices=CASES, default=list(CASES))
    parser.add_argument("--write", action="store_true")
    given = parser.parse_args(arguments)
    rows: list[list[str]] = []
    with ProcessPoolExecutor(given.jobs, get_context("spawn")) as pool:
        for row in pool.map(partial(cells, folder=given.folder, out=given.out / "ablate"), given.only):
            print(*row, sep="|", flush=True)  # of an hour's work nothing is lost
            rows.append(row)
    text = table(("without", *COLUMNS), rows)
    print(text)
    if given.write:
        write_table(DOCS / "ablation.md", "auto", text)


if __name__ == "__main__":
    main()
