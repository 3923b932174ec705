"""The calibrations that a log publishes of one camera over time: which one holds for an image, and what changes."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable
from functools import cache
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from svmdist.camera import Camera, stereo_transform
from svmdist.perturbations import Perturbations
from svmdist.perturbations.calibration import nominal_camera
from svmdist.transforms import Array

ROUNDING = 1e-6  # relative, and in px: calibrations that differ by no more are one
SMALL_PX = 1.0  # K that differs by less is within what any calibration is uncertain by: either may hold
MAX_RUNS = 10_000  # what a camera may change in a log: others are not kept


class Run(NamedTuple):
    """A calibration, and the stamps of the first and the last message in a row that say so."""

    camera: Camera
    first_ns: int
    last_ns: int


class Cameras(NamedTuple):
    """The cameras of an image and of the right one, if any; `ambiguity` says why it is not known which hold."""

    left: Camera
    right: tuple[Camera, Array] | None = None  # with `T_left_right`, shape (4, 4)
    ambiguity: str = ""


class CameraChange(NamedTuple):
    """Two calibrations that follow each other on a topic; `start_ns` is the stamp of the topic's first message."""

    topic: str
    before: Run
    after: Run
    start_ns: int

    def __str__(self) -> str:
        from_s, to_s = ((ns - self.start_ns) * 1e-9 for ns in (self.before.last_ns, self.after.first_ns))
        what = changed(self.before.camera, self.after.camera)
        return f"{what} between {from_s:.2f} and {to_s:.2f} s ({self.topic})"


class CameraTrack:
    """The calibrations of one topic, in runs of equal ones; a message that comes behind later ones does not count."""

    def __init__(self) -> None:
        self.runs: list[Run] = []

    def add(self, stamp_ns: int, camera: Camera) -> None:
        """Take up a message; the same one may come again, in another pass over the log."""
        last = self.runs[-1] if self.runs else Run(camera, -1, -1)
        if stamp_ns > last.last_ns and self.runs and _is_same(last.camera, camera):
            self.runs[-1] = last._replace(last_ns=stamp_ns)
        elif stamp_ns > last.last_ns and len(self.runs) < MAX_RUNS:
            self.runs.append(Run(camera, stamp_ns, stamp_ns))

    def at(self, stamp_ns: int) -> tuple[int, str]:
        """Which run holds at a stamp, the first before all and the last behind; and the ambiguity between two."""
        place = max(0, bisect_right(self.runs, stamp_ns, key=lambda run: run.first_ns) - 1)
        run = self.runs[place]
        if stamp_ns <= run.last_ns or place + 1 == len(self.runs):
            return place, ""
        following = self.runs[place + 1].camera
        is_small = run.camera.same_optics(following, SMALL_PX)
        return place, "" if is_small else f"the camera changes about here: {changed(run.camera, following)}"

    def changes(self, topic: str) -> list[CameraChange]:
        """What changes from each run to the next."""
        return [CameraChange(topic, *pair, self.runs[0].first_ns) for pair in pairwise(self.runs)]


def cameras_at(left: CameraTrack, right: CameraTrack | None, perturbations: Perturbations) -> Callable[[int], Cameras]:
    """The cameras that hold at a stamp, so far as their tracks are known, perturbed."""

    @cache
    def held(left_run: int, right_run: int) -> Cameras:
        camera = nominal_camera(left.runs[left_run].camera, perturbations)
        if right is None:
            return Cameras(camera)
        other = nominal_camera(right.runs[right_run].camera, perturbations, right=True)
        T_left_right = stereo_transform(camera, other)
        return Cameras(camera, None if T_left_right is None else (other, T_left_right))

    def at(stamp_ns: int) -> Cameras:
        left_run, ambiguity = left.at(stamp_ns)
        right_run, of_right = (0, "") if right is None else right.at(stamp_ns)
        return held(left_run, right_run)._replace(ambiguity=ambiguity or of_right)

    return at


def changed(before: Camera, after: Camera) -> str:
    """What differs between two calibrations, in words."""
    both = before, after
    baselines_m = (0.0 if one.P is None else abs(one.P[0, 3]) / one.K[0, 0] for one in both)
    named = {
        "size": (f"{one.width_px}x{one.height_px} px" for one in both),
        "focal length": (f"{one.K[0, 0]:.1f} px" for one in both),
        "principal point": (f"{one.K[0, 2]:.1f}, {one.K[1, 2]:.1f} px" for one in both),
        "baseline": (f"{baseline_m * 1e3:.2f} mm" for baseline_m in baselines_m),
    }
    said = ((name, *values) for name, values in named.items())
    found = [f"{name} {one} -> {other}" for name, one, other in said if one != other]
    return ", ".join(found) or "distortion or rectification"


def _is_same(one: Camera, other: Camera) -> bool:
    for a, b in ((one.R_rectified_camera, other.R_rectified_camera), (one.P, other.P)):
        if a is not b and (a is None or b is None or not np.allclose(a, b, ROUNDING, ROUNDING)):
            return False
    return one.same_optics(other, ROUNDING * max(one.K[0, 0], 1.0))
