"""What people get wrong, one mistake at a time: whether `svmdist estimate` refuses it, warns of it, or covers it.

`uv run python -m benchmarks.mistakes LOG.mcap ... [--only NAME ...] [--methods ...] [--profile P] [--every N]`
changes the profile or the log as MISTAKES says, runs the command as users do, with two views and with one, and holds
its rows against the true clearance of the untouched log.

A run is *refused* where the command fails or no row is ok; *warned* where it ends with exit code 3 and a line on stderr
that says what contradicts; *covered* where at least 90 % of the true clearances are in the 95 % intervals of the ok
rows, and no ok row below 5 mm is without an alarm; all else is a FAIL. `far` counts rows that are ok, in a run that was
not warned of, and off by more than 5 deviations. Nothing is wrong in CONTROLS: there, what contradicts is a FAIL.
"""

from __future__ import annotations

import argparse
import io
import json
import sys
import tempfile
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from contextlib import redirect_stderr, redirect_stdout, suppress
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np

from benchmarks.log_changes import (
    Case,
    Change,
    Turn,
    about_y,
    base,
    baseline,
    both,
    exchanged_joints,
    exchanged_views,
    focal,
    half_size,
    hand_eye,
    images,
    in_degrees,
    infos,
    joints,
    late,
    mesh,
    opened,
    optics,
    other_chain,
    put,
    stuck,
    times,
    turned,
    zoomed,
)
from svmdist.cli.main import run
from svmdist.cli.output import ExitCode
from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from svmdist.recording.topics import Role
from svmdist.results import Z_95
from svmdist.tracks import DistanceTrack
from svmdist.transforms import quaternion_xyzw_from_rotation, rotation_from_quaternion_xyzw

VIEWS = {
    "two": ("kinematic", "fiducial", "shaft", "stereo", "fused"),
    "one": ("kinematic", "fiducial", "shaft", "fused"),
}
CRASHED = 70
UNSAFE_M, COVERED_SHARE = 0.005, 0.9
FAR_STDS = 5.0  # is not bad luck: one row in two million, if the deviations are right
LENS = (-0.3, 0.1, 0.0, 0.0, 0.0)  # k1, k2, p1, p2, k3 of an endoscope


# fmt: off
TURNS: dict[str, Turn] = {
    "in mm": lambda R, t: (R, 1e3 * t),
    "transposed": lambda R, t: (R.T, t),
    "inverted": lambda R, t: (R.T, -R.T @ t),
    "quaternion wxyz": lambda R, t: (
        rotation_from_quaternion_xyzw(np.roll(quaternion_xyzw_from_rotation(R), 1)), t),
    "OpenGL axes": lambda R, t: (np.diag([1.0, -1.0, -1.0]) @ R, t * [1.0, -1.0, -1.0]),
    "5° off": turned(5.0),
    "15° off": turned(15.0),
}
MISTAKES: dict[str, Change] = {
    "tissue: no dome": both(put("tissue.dome", None), put("tissue.surface_std_m", None)),  # the dome's own
    "tissue: plane 10 mm too far": put("tissue.plane_distance_m", lambda right: right + 0.01),
    "tissue: plane 10 mm too near": put("tissue.plane_distance_m", lambda right: right - 0.01),
    "tissue: plane tilted 10° about y": put("tissue.plane_normal", [0.173648, 0.0, -0.984808]),
    "tissue: plane tilted 10° about x": put("tissue.plane_normal", [0.0, 0.173648, -0.984808]),
    "tissue: dome 16 mm": put("tissue.dome.height_m", 0.016),
    "tissue: dome 4 mm": put("tissue.dome.height_m", 0.004),
    "tissue: mesh under its plane": partial(mesh, raised_m=-0.008),
    "tissue: mesh y up": partial(mesh, y_up=True),
    "tissue: mesh of half the size": partial(mesh, factor=0.5),
    "shaft: radius is a diameter": times("instrument.shaft_radius_m", 2.0),
    "shaft: radius is halved": times("instrument.shaft_radius_m", 0.5),
    "marker: radius 1.5x": times("instrument.knuckle_radius_m", 1.5),
    "marker: radius 0.5x": times("instrument.knuckle_radius_m", 0.5),
    "outline's end left out": put("instrument.outline_end_m", None),
    "jaw 16 mm": put("instrument.jaw_length_m", 0.016),
    "jaw 4 mm": put("instrument.jaw_length_m", 0.004),
    "tag +20 %": times("fiducial.size_m", 1.2),
    "tag -20 %": times("fiducial.size_m", 0.8),
    "tag on insertion": put("fiducial.link", "insertion"),
    "tag on wrist_pitch": put("fiducial.link", "wrist_pitch"),
    "tag turned 90°": put("fiducial.rotation", [[0.0, -1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, 1.0]]),
    "tag y mirrored": put("fiducial.rotation", [[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]]),
    "tag position's y mirrored": put("fiducial.position_m", lambda right: [right[0], -right[1], right[2]]),
    "wrist: length in mm": times("robot.joints.wrist_pitch.a_m", 1e3),
    "wrist: length in cm": times("robot.joints.wrist_pitch.a_m", 100.0),
    "wrist: length 3x": times("robot.joints.wrist_pitch.a_m", 3.0),
    "wrist: length 0": put("robot.joints.wrist_pitch.a_m", 0.0),
    "chain of another robot": other_chain,
    "chain: DH modified for standard": put("robot.convention", "modified"),
    "chain: yaw, pitch exchanged": exchanged_joints("yaw", "pitch"),
    "chain: wrist's joints exchanged": exchanged_joints("wrist_pitch", "wrist_yaw"),
    "camera: focal +10 %": focal(1.1),
    "camera: focal -10 %": focal(0.9),
    "camera: zoom 1.25 midway": images(zoomed, 0.5),
    "camera: zoom and info midway": both(images(zoomed, 0.5), focal(1.25, 0.5)),
    "camera: info changes midway": focal(1.25, 0.5),
    "camera: principal point 40 px": optics(lambda K: K + np.eye(3, k=2) * 40.0),
    "camera: right principal point 40 px": optics(lambda K: K + np.eye(3, k=2) * 40.0, "right_camera_info"),
    "camera: lens stated twice": infos(lambda message: message.D.__setitem__(slice(None), LENS)),
    "camera: right lens stated twice": infos(
        lambda message: message.D.__setitem__(slice(None), LENS), "right_camera_info"),
    "camera: right focal +3 %": optics(lambda K: K * [[1.03, 1, 1], [1, 1.03, 1], [1, 1, 1]], "right_camera_info"),
    "camera: info of half the size": half_size,
    "camera: f for c": optics(lambda K: np.array([[K[0, 2], 0, K[0, 0]], [0, K[1, 2], K[1, 1]], [0, 0, 1]])),
    "camera: images mirrored": images(lambda image: image[:, ::-1]),
    "camera: images upside down": images(lambda image: image[::-1, ::-1]),
    "camera: RGB for BGR": images(lambda image: image[..., ::-1]),
    "stereo: views exchanged": exchanged_views,
    "stereo: left image twice": partial(exchanged_views, twice=True),
    "stereo: baseline of wrong sign": baseline(-1.0),
    "stereo: baseline in mm": baseline(1e3),
    "stereo: baseline half": baseline(0.5),
    "stereo: baseline 1.2x": baseline(1.2),
    "stereo: right camera turned 2°": infos(lambda message: message.R.__setitem__(
        slice(None), (about_y(2.0) @ np.reshape(message.R, (3, 3))).ravel().tolist()), "right_camera_info"),
    "stereo: right stamps +50 ms": late("right_image", 0.05),
    "stereo: right stamps one frame late": late("right_image", 0.1),
    "joints: yaw's sign": joints(lambda q: {"yaw": -q["yaw"]}),
    "joints: wrist_yaw's sign": joints(lambda q: {"wrist_yaw": -q["wrist_yaw"]}),
    "joints: yaw, pitch exchanged": joints(lambda q: {"yaw": q["pitch"], "pitch": q["yaw"]}),
    "joints: in degrees": joints(in_degrees),
    "joints: insertion in mm": joints(lambda q: {"insertion": 1e3 * q["insertion"]}),
    "joints: insertion stuck": stuck("insertion"),
    "joints: yaw stuck": stuck("yaw"),
    "joints: all stuck": stuck(),
    "joints: 0.4 s late": late("joints", 0.4),
    "joints: 0.4 s early": late("joints", -0.4),
    **{f"base: {name}": base(turn) for name, turn in TURNS.items()},
    **{f"hand-eye: {name}": hand_eye(turn) for name, turn in TURNS.items()},
}
CONTROLS: dict[str, Change] = {
    "nothing": lambda case: case.at("name"),
    "right mesh": mesh,
    "right hand-eye": hand_eye(lambda R, t: (R, t)),
}
# fmt: on


class Verdict(NamedTuple):
    """How a run ended: its verdict, numbers of rows, and the line of stderr that tells most about it."""

    mistake: str
    method: str
    views: str
    verdict: str
    ok: int
    rows: int
    worst_stds: float
    share_in_interval: float
    missed: int
    unsafe: int
    far: int
    said: str

    def __str__(self) -> str:
        """One line."""
        text = "{:36} {:9} {:4} {:8} {:3}/{:<3} {:7.1f} {:5.0%} {:3}/{:<3} {:4}  {:.130}"
        return text.format(*self)


Ran = tuple[int, str, list[dict[str, Any]]]
"""Exit code, stderr and rows of the command."""


def estimate(case: Case, log: Path, method: str, every: int) -> Ran:
    """Run the command, in this process."""
    rows, err, code = case.folder / f"{method}.json", io.StringIO(), 0
    command = ["svmdist", "estimate", log, "--profile", case.folder / "profile.toml", "--method", method]
    command += [*case.options, "-f", "json", "-o", rows, "--alarm-below", "5mm", "-j", 1, "--every", every]
    with patch.object(sys, "argv", list(map(str, command))), redirect_stderr(err), redirect_stdout(err):
        try:
            run()
        except SystemExit as end:
            code = int(end.code or 0)
        except Exception as fault:  # a fault of the command's own
            return CRASHED, f"{type(fault).__name__}: {fault}", []
    return (
        code,
        err.getvalue().replace(f"{case.folder}/", ""),
        json.loads(rows.read_text()) if rows.exists() else [],
    )


def outcome(ran: Ran, truth: DistanceTrack | None, is_control: bool) -> tuple[Any, ...]:
    """The fields of a Verdict from its verdict on."""
    code, err, rows = ran
    ok = [row for row in rows if row["status"] == "ok" and row["clearance_m"] is not None]
    stamps_ns = np.array([row["stamp_ns"] for row in ok], np.int64)
    true_m = truth.at(stamps_ns).values[:, 2] if truth else np.full(len(ok), np.nan)
    off_m = np.abs(np.array([row["clearance_m"] for row in ok]) - true_m)
    stds = off_m / np.maximum([row["clearance_std_m"] or 0.0 for row in ok], 1e-12)
    share = float(np.mean(stds <= Z_95)) if ok else 1.0
    unsafe = [row for row, m in zip(ok, true_m, strict=True) if m < UNSAFE_M]
    missed = sum(not row["alarm"] for row in unsafe)
    lines = [line.removeprefix("svmdist: ") for line in err.strip().splitlines()] or [""]
    contradictions = [line for line in lines if "warning" in line and "contradict" in line]
    is_warned = code == ExitCode.LOSS and bool(contradictions)
    is_covered = bool(ok) and share >= COVERED_SHARE and not missed
    if is_control:
        verdict = "FAIL" if contradictions or code == CRASHED else "covered" if is_covered else "quiet"
    elif is_warned:
        verdict = "warned"
    elif not ok and code != CRASHED:
        verdict = "refused"
    else:
        verdict = "covered" if is_covered else "FAIL"
    far = 0 if is_warned else int(np.count_nonzero(stds > FAR_STDS))
    said = [*contradictions, *(line for line in lines if "warning" in line or "measured" in line), lines[-1]][0]
    return verdict, len(ok), len(rows), float(stds.max(initial=0.0)), share, missed, len(unsafe), far, said


def verdicts(path: str, mistake: str, profile: str, methods: tuple[str, ...], every: int) -> list[Verdict]:
    """Those of a mistake in a log, by all methods and views that it touches; without truth none is covered."""
    log, found = open_recording(path, load_profile(profile)), []
    truth = log.distance_track() if log.topic_of(Role.GROUND_TRUTH_DISTANCE) else None
    for views, possible in VIEWS.items():
        with tempfile.TemporaryDirectory() as name:
            case = opened(path, profile, views, Path(name))
            has_tag = case.metadata.get("tag") == "yes" or "scenario" not in case.metadata
            if mistake.startswith("tag"):
                methods = tuple(method for method in methods if has_tag and method in ("fiducial", "fused"))
            with suppress(KeyError, StopIteration):  # the profile or the log has no such thing
                (CONTROLS | MISTAKES)[mistake](case)
            if not case.is_changed:
                continue
            case.write(changed := case.folder / Path(path).name)
            for method in possible:
                if method in methods and (has_tag or method != "fiducial"):
                    figures = outcome(estimate(case, changed, method, every), truth, mistake in CONTROLS)
                    found.append(Verdict(mistake, method, views, *figures))
    return found


def main() -> None:
    """Run the command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("logs", nargs="+", metavar="LOG.mcap")
    parser.add_argument("--only", nargs="+", default=[""], metavar="NAME", help="with one of these in the name")
    parser.add_argument("--methods", nargs="+", choices=VIEWS["two"], default=VIEWS["two"])
    parser.add_argument("--profile", default="psm13")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="take every N-th image only")
    parser.add_argument("--jobs", type=int, default=2)
    given = parser.parse_args()
    names = [name for name in CONTROLS | MISTAKES if any(part in name for part in given.only)]
    of_one = partial(verdicts, profile=given.profile, methods=tuple(given.methods), every=given.every)
    found: list[Verdict] = []
    with ProcessPoolExecutor(given.jobs, get_context("spawn")) as pool:
        for path in given.logs:
            print(f"{path}\n{'mistake, method, views, verdict':60} ok/rows   worst    in 95  missed  far")
            for some in pool.map(of_one, [path] * len(names), names):
                print(*some, sep="\n", flush=True)
                found += some
    counts = Counter(one.verdict for one in found)
    print(", ".join(f"{count} {verdict}" for verdict, count in counts.most_common()))
    failed, far = (
        [one for one in found if one.verdict == "FAIL"],
        [one for one in found if one.far and one.mistake in MISTAKES],
    )
    for what, some in (("fail", failed), ("have rows that are ok, unwarned and far off", far)):
        names = list(dict.fromkeys(one.mistake for one in some))
        print(f"{len(names)} mistakes {what}, in {len(some)} runs: {'; '.join(names)}")
    sys.exit(bool(failed or far))


if __name__ == "__main__":
    main()
