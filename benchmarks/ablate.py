"""docs/ablation.md: what every factor and special case of `fused` earns, by leaving out one at a time.

`uv run python -m benchmarks.ablate [LOG.mcap ...] [--write]` measures golden logs, one in worlds that differ from the
profile, two as they are and with what `profile new` writes of them, and the logs that are given: of these clearances,
too.
"""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any
from unittest.mock import patch

import numpy as np

from benchmarks.generated_pages import DOCS, ROOT, table, write_table
from benchmarks.real.common import run
from benchmarks.robustness import cell
from svmdist.estimation import fused
from svmdist.estimation.instrument import consistency
from svmdist.estimation.instrument.factors import of_images
from svmdist.perturbations import parse_perturbations
from svmdist.recording.log import open_recording
from svmdist.workflows.compare import measure_runs
from svmdist.workflows.request import CLEAN, Condition, Setup, prepare

WORLDS = ("focal=1", "knuckle_radius=5", "backlash=0.5")
PERTURBED = "golden, perturbed"
ALL = {"is_tracked": False}  # what one view or pair takes and a tracked tool does not
FIRST, GIVEN = "first profile", "given logs"
SETS = {
    PERTURBED: ["3d/contact"],
    "other world": ["real/contact", "real/random"],
    FIRST: ["real/contact", "real/random"],
}


def without(part: str) -> Callable[..., Any]:
    """All factors but those whose name has a part."""
    return lambda *a, **k: [one for one in of_images(*a, **k) if part not in one.name]


CASES: dict[str, tuple[object, str, Any]] = {
    "nothing": (fused, "of_images", of_images),
    "edges": (fused, "of_images", without("edge")),
    "distal marker": (fused, "of_images", without("distal marker")),
    "disparity (size in its place)": (fused, "pair_markers", lambda *_: None),
    "tag": (fused, "tag", lambda *_: ()),
    "(end, size, right sides: used)": (fused, "of_images", lambda *a, **k: of_images(*a, **k | ALL)),
    "start by images": (fused.FusedEstimator, "_start", lambda *_: None),
    "variance of images after a start": (fused, "YOUNG_S", 1e-9),
    "tissue's height by stereo": (fused, "measure_height", lambda *_: None),
    "widening by innovations": (consistency.Consistency, "ratio", 1.0),
    "widening by constants": (consistency, "usual_furthest", lambda _: np.inf),
}


def first_setup(log: str) -> Setup:
    """What `profile new` writes of a log, with nothing measured or named."""
    with TemporaryDirectory() as folder:
        path = Path(folder, "first.toml")
        run("profile", "new", log, "-o", path)
        return prepare(path, "fused")


if __name__ == "__main__":
    setup = prepare(method="fused")
    worlds = [Condition(world=parse_perturbations(world)) for world in WORLDS]
    sets = {name: [str(ROOT / "recordings" / f"{log}.mcap") for log in logs] for name, logs in SETS.items()}
    if given := [path for path in sys.argv[1:] if path != "--write"]:
        sets[GIVEN] = given
    firsts = {log: first_setup(log) for log in sets[FIRST]}
    rows = []
    for name, (place, attribute, by) in CASES.items():
        row = [name]
        for label, paths in sets.items():
            conditions = worlds if label == PERTURBED else [CLEAN]
            with patch.object(place, attribute, by):
                scores = []
                for path in paths:
                    own = firsts[path] if label == FIRST else setup
                    scores += measure_runs(open_recording(path, own.profile), [own], conditions, jobs=1)
            row.append(cell(scores))
            if label == GIVEN:
                row.append(cell(scores, "clearance").partition(" [")[0])
        rows.append(row)
        print(*row, sep=" | ", flush=True)
    if "--write" in sys.argv:
        heads = [f"{GIVEN}, spatial" if label == GIVEN else label for label in sets]
        heads += [f"{GIVEN}, clearance"] if given else []
        write_table(DOCS / "ablation.md", "ablation", table(("without", *heads), rows))
