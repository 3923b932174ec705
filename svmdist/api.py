"""The Python interface: open a recording, estimate, validate and compare, with methods of svmdist's or one's own."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from svmdist.errors import SvmdistError
from svmdist.estimation.alarms import AlarmRules
from svmdist.profile import DEFAULT_PROFILE, Profile, load_profile
from svmdist.recording.log import Recording
from svmdist.recording.log import open_recording as _open
from svmdist.report.rows import ESTIMATE_KEYS, estimate_row
from svmdist.report.tables import Row
from svmdist.results import FrameResult
from svmdist.samples import bgr_image  # noqa: F401  (part of the interface)
from svmdist.workflows.compare import MethodScore
from svmdist.workflows.compare import compare as _compare
from svmdist.workflows.estimate import estimate as _estimate
from svmdist.workflows.estimate import with_lag
from svmdist.workflows.references import TruthRules
from svmdist.workflows.request import Lag, OwnMethod, Request, Setup, prepare
from svmdist.workflows.validate import Validation
from svmdist.workflows.validate import validate as _validate

if TYPE_CHECKING:
    from pandas import DataFrame

Method = str | OwnMethod
"""The name of a method, or an object with `estimate(frame)`."""


@dataclass(frozen=True)
class Estimates(Sequence[FrameResult]):
    """The results of one recording, a row for each image and instrument, in the order of the log."""

    recording: Recording
    setup: Setup
    results: tuple[FrameResult, ...]

    def __getitem__(self, index: Any) -> Any:
        """One result, or some of them."""
        return self.results[index]

    def __len__(self) -> int:
        """Count the rows."""
        return len(self.results)

    def rows(self) -> Iterator[Row]:
        """The rows of `svmdist estimate -f csv`, in SI; None for what does not exist."""
        for result in self.results:
            row = estimate_row(self.recording.name, result, self.setup.method, self.setup.equations)
            yield {key: row.get(key) for key in ESTIMATE_KEYS}

    def to_dataframe(self) -> DataFrame:
        """A pandas DataFrame with the columns of the CSV; raises SvmdistError where pandas is not installed."""
        try:
            import pandas as pd
        except ImportError:
            raise SvmdistError(
                "to_dataframe needs pandas, which is not installed: pip install pandas"
            ) from None
        return pd.DataFrame.from_records(list(self.rows()), columns=ESTIMATE_KEYS)


def open_recording(
    path: Path | str, profile: str | Path | Profile = DEFAULT_PROFILE, *, topics: dict[str, str] | None = None
) -> Recording:
    """Open a log with a profile: a shipped one by its name, a file, or a `Profile`.

    Raises ProfileError, or RecordingError for a file that is no recording.
    """
    loaded = profile if isinstance(profile, Profile) else load_profile(profile)
    return _open(path, loaded, topics=topics)


def estimate(
    recording: Recording,
    method: Method = "overlay",
    *,
    calibration: Path | None = None,
    lag: Lag | None = None,
    instruments: Sequence[str] | None = None,
    jobs: int | None = None,
) -> Estimates:
    """Measure every image of a recording. `lag` in s, or `"auto"`, is taken off the images' stamps first."""
    setup = _setup(recording, method, calibration)
    names = None if instruments is None else tuple(instruments)
    read, _ = with_lag(recording, Request(setup, instruments=names, lag=lag), jobs)
    return Estimates(recording, setup, tuple(_estimate(read, setup, names, jobs)))


def validate(
    recordings: Recording | Sequence[Recording],
    method: Method = "overlay",
    *,
    calibration: Path | None = None,
    rules: TruthRules | None = None,
    lag: Lag | None = None,
    alarms: AlarmRules | None = None,
    jobs: int | None = None,
) -> Validation:
    """Score a method on recordings of one profile against each reference that they have."""
    several = [recordings] if isinstance(recordings, Recording) else list(recordings)
    setup = _setup(several[0], method, calibration)
    request = Request(setup, lag=lag, alarms=alarms, rules=rules or TruthRules())
    return _validate(several, request, jobs)


def compare(
    recordings: Recording | Sequence[Recording],
    methods: Sequence[Method] = ("overlay", "centroid", "fiducial", "shaft", "stereo", "kinematic", "fused"),
    *,
    jobs: int | None = None,
) -> list[MethodScore]:
    """Measure recordings of one profile with all methods side by side."""
    several = [recordings] if isinstance(recordings, Recording) else list(recordings)
    return _compare(several, [_setup(several[0], method) for method in methods], jobs=jobs)


def _setup(recording: Recording, method: Method, calibration: Path | None = None) -> Setup:
    return prepare(recording.origin.profile, method, "corrected", calibration)
