"""The tables of README.md and docs/results.md, made from what the commands write.

Run `uv run python -m benchmarks.golden_tables` after a change that moves figures, with names of parts for some of them.
The part `worlds` measures the logs that README.md records into `worlds/`, and takes real images from docs/real-data.md.
"""

from __future__ import annotations

import json
import shlex
import subprocess
import sys
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

import svmdist
from benchmarks.generated_pages import DOCS, ROOT, named, table, table_in, write_table

RESULTS = DOCS / "results.md"
Record = dict[str, Any]
METHODS = {
    "fiducial": ("an AprilTag plate, and the wrist's joints", "outline on the profile's plane"),
    "shaft": ("one camera: the silhouette of a shaft of known radius", "outline on the profile's plane"),
    "stereo": ("both cameras", "both cameras, by matching and alignment"),
    "kinematic": ("nominal kinematics", "outline on the profile's plane"),
    "fused": ("kinematics, corrected by everything visible", "outline over time; height by both views"),
}
"""Methods in 3D, and where each takes tool and tissue from."""
OPTIONS = "".join(f" --method {name}" for name in METHODS)
ALARMS = "--method fused --alarm-below 5mm --truth ground_truth"
FIGURES = "n/frames", "spatial RMSE [mm]", "in 95%", "clearance RMSE [mm]", "in 95%"
ALARM_FIGURES = "unsafe", "recall", "precision", "safe alarmed", "least lead [s]"
PLANAR = "n/frames", "R²", "RMSE [mm]", "RMSE 95% [mm]", "p95 [mm]", "bias [mm]", "σ [mm]"
REAL = (
    ("thrust", "shaft", "red joint"),
    ("thrust", "stereo", "red joint"),
    ("thrust", "fused", "red joint"),
    ("d-lfd", "stereo", "robot, fitted"),
    ("SuPer Deep", "shaft", "wrist"),
    ("in vivo", "shaft", "tip"),
    ("EndoVis 2015", "shaft", "masks; width"),
    ("liver", "surface", "CT"),
)
"""Which rows of real images README.md shows."""
BLUR = "kernel [px]", "features", "paper", "area [px²]", "paper", "RMSE [mm]"


def measured(command: str) -> Any:
    """What a command of svmdist writes as JSON; bash resolves its patterns."""
    line = f"{shlex.quote(sys.executable)} -m svmdist {command} -q -f json"
    done = subprocess.run(["bash", "-c", line], cwd=ROOT, stdout=subprocess.PIPE, check=True)
    return json.loads(done.stdout)


def millimetres(value_m: float | None, digits: int = 2) -> str:
    """A length, or a dash."""
    return "–" if value_m is None else f"{1e3 * value_m:z.{digits}f}"


def percent(share: float | None, digits: int = 0) -> str:
    """A share, or a dash."""
    return "–" if share is None else f"{100 * share:.{digits}f}%"


def pooled(records: Sequence[Record]) -> Record:
    """The figures of several instruments together."""
    counts = np.array([record["measured_count"] for record in records], float)
    together = {key: sum(record[key] for record in records) for key in ("measured_count", "frame_count")}
    total = together["measured_count"]
    for name in ("spatial", "clearance"):
        for key, power in ((f"{name}_rmse_m", 2), (f"{name}_interval_coverage", 1)):
            values = np.array([record[key] or 0.0 for record in records])
            together[key] = float((counts @ values**power / total) ** (1 / power)) if total else None
    return together


def cells_in_3d(record: Record) -> list[str]:
    """Frames, and the figures of both distances in 3D."""
    count = record.get("measured_count", record.get("sample_count"))
    cells = [f"{count}/{record['frame_count']}"]
    for name in ("spatial", "clearance"):
        cells += [millimetres(record[f"{name}_rmse_m"]), percent(record[f"{name}_interval_coverage"])]
    return cells


def all_methods(logs: str) -> dict[str, list[str]]:
    """The figures of each method in 3D on logs, over all instruments."""
    records = [one for one in measured(f"compare {logs}{OPTIONS}") if one["group"].split()[0] == "all"]
    return {name: cells_in_3d(pooled([one for one in records if one["method"] == name])) for name in METHODS}


def methods() -> None:
    """All methods in worlds that differ from the profile, and in one that agrees with it."""
    found = all_methods("recordings/real/*.mcap")
    rows = [[f"`{name}`", *METHODS[name], *cells] for name, cells in found.items()]
    headings = ("`--method`", "tool from", "tissue from", *FIGURES)
    write_table(RESULTS, "golden-real", table(headings, rows))
    rows = [[f"`{name}`", *cells] for name, cells in all_methods("recordings/3d/*.mcap").items()]
    write_table(RESULTS, "golden-3d", table(("method", *FIGURES), rows))


def worlds() -> None:
    """Real images first, by their own page; then simulated worlds that differ from the profile."""
    page = table_in((DOCS / "real-data.md").read_text("utf-8"), "real-images")
    found = {tuple(cells[:3]): cells for line in page.splitlines() if (cells := line.strip("|").split("|"))}
    rows = []
    for name, method, against in REAL:
        *_, frames, error, inside = found[name, f"`{method}`", against][:6]
        rows.append([f"{name}, real: {against}", f"`{method}`", frames, error, inside, "–", "–"])
    count = len(list((ROOT / "worlds").glob("*.mcap")))
    for method, (frames, error, *others) in all_methods("worlds/*.mcap").items():
        rows.append([f"{count} simulated worlds", f"`{method}`", frames, f"{error} mm", *others])
    headings = ("data", "`--method`", "n/frames", "tool", "in 95%", "clearance [mm]", "in 95%")
    write_table(ROOT / "README.md", "worlds", table(headings, rows))


def fused() -> None:
    """`fused` and its alarms, log by log."""
    rows = []
    for folder in ("3d", "real"):
        for score in measured(f"validate recordings/{folder}/*.mcap {ALARMS}")["recordings"]:
            lead_s = score["alarm_lead_min_s"]
            alarms = (
                str(score["alarm_unsafe_count"]),
                percent(score["alarm_recall"]),
                percent(score["alarm_precision"]),
                percent(score["false_alarm_fraction"], 1),
                "–" if lead_s is None else f"{lead_s:.2f}",
            )
            rows.append([f"{folder}/{score['recording']}", *cells_in_3d(score), *alarms])
        if folder == "3d":
            rows.append(["3d/duo PSM1–PSM2", *between_instruments(), *["–"] * len(ALARM_FIGURES)])
    write_table(RESULTS, "golden-fused", table(("log", *FIGURES, *ALARM_FIGURES), rows))


def between_instruments() -> list[str]:
    """The clearance between both instruments of `3d/duo`."""
    path, topic = ROOT / "recordings" / "3d" / "duo.mcap", "/ground_truth/PSM1/PSM2/distance"
    every = svmdist.estimate(svmdist.open_recording(path), "fused")
    rows = [row for row in every if row.instrument == "PSM1"]
    found = [(row.stamp_ns, row.distances.to_instrument) for row in rows if row.distances.to_instrument]
    track = svmdist.open_recording(path, topics={"ground_truth_distance": topic}).distance_track()
    true_m = track.at(np.array([stamp_ns for stamp_ns, _ in found], np.int64)).values[:, 2]
    error_m = np.array([distance.value_m for _, distance in found]) - true_m
    inside = np.abs(error_m) <= 1.96 * np.array([distance.std_m for _, distance in found], float)
    rmse_m = float(np.sqrt(np.mean(error_m**2)))
    return [f"{len(found)}/{len(rows)}", "–", "–", millimetres(rmse_m), percent(float(inside.mean()))]


def planar() -> None:
    """`overlay` log by log, and the overall rows of other conditions."""
    document = measured("validate --method overlay")
    scores = [score for score in document["recordings"] if score["reference"] == "ground_truth"]
    overall = document["overall_by_reference"]
    logs = {score["recording"] + " (fitted on)" * score["fitted_on"]: score for score in scores}
    logs["**overall**"] = overall["ground_truth"]
    others = {
        "`overlay` against DH kinematics, as in the paper": overall["kinematics"],
        "`--method centroid`, without the marker": measured("validate --method centroid")["overall"],
        "`--equations printed`": measured("validate --method overlay --equations printed")["overall"],
    }
    for name, first, records in (("golden-planar", "log", logs), ("golden-overall", "condition", others)):
        rows = [[label, *cells_in_plane(score)] for label, score in records.items()]
        write_table(RESULTS, name, table((first, *PLANAR), rows))


def cells_in_plane(score: Record) -> list[str]:
    """Frames, and the figures of the planar distance."""
    return [
        f"{score['sample_count']}/{score['frame_count']}",
        f"{score['r_squared']:.4f}",
        millimetres(score["rmse_m"]),
        f"{millimetres(score['rmse_low_m'])}–{millimetres(score['rmse_high_m'])}",
        millimetres(score["p95_abs_error_m"]),
        millimetres(score["bias_m"]),
        millimetres(score["truth_std_m"], 1),
    ]


def blur() -> None:
    """Table I of the paper beside ours."""
    logs = "recordings/{sweep,approach,contact,occlusion,random}.mcap"
    rows = [
        [
            record["blur"],
            str(record["kernel_px"]),
            f"{record['keypoint_count']:.1f}",
            str(record["paper_keypoint_count"] or "–"),
            f"{record['contour_area_px']:.0f}",
            str(record["paper_contour_area_px"] or "–"),
            millimetres(record["rmse_m"]),
        ]
        for record in measured(f"blur-bench {logs}")
    ]
    write_table(RESULTS, "golden-blur", table(("blur", *BLUR), rows))


PARTS: dict[str, Callable[[], None]] = {make.__name__: make for make in (methods, fused, planar, blur, worlds)}


if __name__ == "__main__":
    for part in named("part", sys.argv[1:], PARTS):
        PARTS[part]()
