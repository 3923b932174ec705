"""Rows of methods on golden logs: each pair of a log and a method is measured once in a test run."""

from __future__ import annotations

import pickle
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice
from pathlib import Path

import numpy as np
from filelock import FileLock

import svmdist
from svmdist.profile import Profile
from svmdist.results import FrameResult
from svmdist.samples import Observation
from svmdist.transforms import Array
from svmdist.workflows.scoring.scores import DISTANCES
from tests.reading import read_observations
from tests.shipped import PROFILE

RECORDINGS = Path(__file__).resolve().parent.parent / "recordings"
PLANAR = ("calibration", "sweep", "approach", "contact", "occlusion", "random")
IN_3D = ("3d/contact", "3d/duo")
REAL = ("real/random", "real/contact")


def golden_frames(log: str, numbers: range, profile: Profile = PROFILE) -> list[Observation]:
    """What an estimator may see of some frames of a golden log, by their numbers."""
    every = read_observations(svmdist.open_recording(RECORDINGS / f"{log}.mcap", profile))
    return list(islice(every, numbers.start, numbers.stop, numbers.step))


def true_distances_m(log: str, seen: Sequence[Observation]) -> Array:
    """The true planar and spatial distances and clearances at observations of a golden log, shape (n, 3)."""
    track = svmdist.open_recording(RECORDINGS / f"{log}.mcap").distance_track()
    return track.at(np.array([one.stamp_ns for one in seen], np.int64)).values


@dataclass(frozen=True)
class GoldenRows:
    """The rows of one method on one golden log, in the order of the log."""

    log: str
    rows: tuple[FrameResult, ...]

    @property
    def instruments(self) -> tuple[str, ...]:
        """The instruments that have rows."""
        return tuple(dict.fromkeys(row.instrument for row in self.rows))

    def of(self, instrument: str) -> GoldenRows:
        """The rows of one instrument."""
        return GoldenRows(self.log, tuple(row for row in self.rows if row.instrument == instrument))

    def after(self, seconds: float) -> GoldenRows:
        """The rows from this time after the first one."""
        start_ns = self.rows[0].stamp_ns + round(seconds * 1e9)
        return GoldenRows(self.log, tuple(row for row in self.rows if row.stamp_ns >= start_ns))

    def errors(self, distance: str) -> Errors:
        """The errors of the measured rows of one instrument; `distance` is planar, spatial or clearance."""
        (instrument,) = self.instruments
        recording = svmdist.open_recording(RECORDINGS / f"{self.log}.mcap").for_instrument(instrument)
        measured = [row for row in self.rows if row.measured]
        truth = recording.distance_track().at(np.array([row.stamp_ns for row in measured], np.int64))
        assert truth.valid.all()
        found = [getattr(row.distances, distance) for row in measured]
        true_m = truth.values[:, DISTANCES.index(distance)]
        return Errors(
            np.array([one.value_m for one in found]) - true_m,
            np.array([np.nan if one.std_m is None else one.std_m for one in found]),
            true_m,
        )


@dataclass(frozen=True)
class Errors:
    """Errors of a distance, its standard deviations and the true distance, shape (n,) each, in m."""

    error_m: Array
    std_m: Array
    true_m: Array

    @property
    def rmse_m(self) -> float:
        """Root of the mean square error."""
        return float(np.sqrt(np.mean(self.error_m**2)))

    def share_within(self, deviations: float) -> float:
        """Share of errors within so many standard deviations."""
        return float(np.mean(np.abs(self.error_m) <= deviations * self.std_m))


class GoldenRuns:
    """Measures golden logs on demand, and keeps the rows in a folder that all test processes share."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._kept: dict[tuple[str, str], GoldenRows] = {}

    def __call__(self, log: str, method: str) -> GoldenRows:
        """The rows of a shipped profile's method on `recordings/<log>.mcap`."""
        if (log, method) not in self._kept:
            path = self._folder / f"golden-{log.replace('/', '-')}-{method}.pickle"
            with FileLock(path.with_suffix(".lock")):
                if not path.exists():
                    recording = svmdist.open_recording(RECORDINGS / f"{log}.mcap")
                    path.write_bytes(pickle.dumps(tuple(svmdist.estimate(recording, method, jobs=1))))
                self._kept[log, method] = GoldenRows(log, pickle.loads(path.read_bytes()))
        return self._kept[log, method]
