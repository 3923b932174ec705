"""egoodman92/laparoscopic-dataset: frames of operations with blood, smoke, overlays and blue screens, in no order.

There is no truth but where instruments are: `outlines.json` has those of the fixed frames, drawn by hand for this. No
row may lie beside an instrument. No calibration comes with it: f = 900 px is assumed.
"""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

from benchmarks.masks import filled
from benchmarks.real import common, peer
from svmdist.profile import load_profile

SET = Path("laparoscopic-dataset", "images")
K = common.K_of(900.0, 900.0, 639.5, 359.5)
RADIUS_M = 0.0025
OUTLINES = Path(__file__).with_name("operations.json")


def frames(folder: Path) -> list[Path]:
    """The fixed frames, by operation and number."""
    given = common.FRAMES["operations"]
    found = []
    for operation in given["operations"]:
        images = sorted((folder / SET).glob(f"{operation}-*.jpg"), key=lambda path: int(path.stem.rpartition("-")[2]))
        found += images[:: given["every"]]
    return found


def measure(folder: Path, out: Path) -> Iterator[common.Line]:
    """Rows of `shaft`, and how many of them lie on an outlined instrument."""
    paths, outlines = frames(folder), json.loads(OUTLINES.read_text("utf-8"))
    views = (common.copied(paths, out / "images"), "--rate", 0.1, "--camera", "900,900,639.5,359.5")
    log, profile = common.make_log(out / "operations.mcap", *views, instrument="laparoscopic-5mm")
    instrument = load_profile(profile).instrument
    assert instrument is not None
    pictures = [common.read(path) for path in paths]
    seen = [filled(outlines.get(path.stem, []), bgr.shape[:2]) for path, bgr in zip(paths, pictures, strict=True)]
    rows, _ = common.rows_of(log, profile, "shaft")
    on = common.on_instruments(rows, K, pictures, seen, instrument.shaft_radius_m)
    other = peer.figures(peer.found(pictures, K, RADIUS_M, 2), seen)
    count = f"{len(rows)}/{sum(len(outlines.get(path.stem, [])) for path in paths)}"
    yield common.Line("operations", "`shaft`", "outlines", common.Figures(count, on=on), other)
