"""EndoVis 2015 (Warlord437/Surgical-Image-Segmentation): 71 images of six operations with masks drawn by people.

No row may lie beside an instrument. No calibration comes with it: f = 512 px, 0.8 of the width, is assumed.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from benchmarks import masks
from benchmarks.real import common, peer
from svmdist.profile import load_profile

SET = Path("Surgical-Image-Segmentation")
K = common.K_of(512.0, 512.0, 319.5, 239.5)


def measure(folder: Path, out: Path) -> Iterator[common.Line]:
    """Rows of `shaft`, one an image at most, and how many of them lie on an instrument."""
    pictures, seen = zip(*masks.SETS["EndoVis 2015"][2](folder / SET), strict=True)
    images = common.copied(sorted((folder / SET).glob(masks.ENDOVIS_2015)), out / "images")
    numbers = ("--rate", 0.1, "--camera", "512,512,319.5,239.5")
    log, path = common.make_log(out / "endovis-2015.mcap", images, *numbers, instrument="laparoscopic-5mm")
    instrument = load_profile(path).instrument
    assert instrument is not None
    rows, total = common.rows_of(log, path, "shaft")
    radius_m = instrument.shaft_radius_m
    on = common.on_instruments(rows, K, pictures, seen, radius_m)
    other = peer.figures(peer.found(pictures, K, radius_m), seen)
    yield common.Line("EndoVis 2015", "`shaft`", "masks", common.Figures(f"{len(rows)}/{total}", on=on), other)
