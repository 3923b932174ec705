"""The Python interface: open a recording, estimate, validate and compare, with methods of svmdist's or one's own."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from html import escape
from numbers import Integral, Real
from pathlib import Path
from typing import TYPE_CHECKING, Any

from svmdist.errors import SvmdistError, UsageError
from svmdist.estimation.alarms import AlarmRules
from svmdist.metrics import TEXT
from svmdist.profile import DEFAULT_PROFILE, Profile, load_profile, taking_hand_eye
from svmdist.recording.log import Recording
from svmdist.recording.log import open_recording as _open
from svmdist.recording.observations import Window
from svmdist.remote import RemoteFile
from svmdist.report.rows import ESTIMATE_COLUMNS, ESTIMATE_KEYS, estimate_row, shown_columns
from svmdist.report.tables import Row, text_lines
from svmdist.results import FrameResult
from svmdist.samples import bgr_image  # noqa: F401  (part of the interface)
from svmdist.workflows.capabilities import best_method, require_clearance
from svmdist.workflows.check import TissueSurface
from svmdist.workflows.check import tissue_surface as _surface
from svmdist.workflows.compare import MethodScore
from svmdist.workflows.compare import compare as _compare
from svmdist.workflows.estimate import Ending, alarms_in_words, with_lag
from svmdist.workflows.estimate import estimate as _estimate
from svmdist.workflows.request import Lag, OwnMethod, Request, Setup, prepare, prepare_methods
from svmdist.workflows.scoring.given import given_estimates
from svmdist.workflows.scoring.references import TruthRules
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
    alarms: AlarmRules | None = None

    def __repr__(self) -> str:
        ending = Ending.of(self.results)
        counts = ", ".join(f"{count} {status}" for status, count in ending.statuses.items())
        lines = [f"{self.recording.name}: {len(self)} rows by {self.setup.method}", counts or "no image"]
        if ending.least is not None:
            lines.append(ending.least_in_words)
        if self.alarms is not None:
            lines.append(alarms_in_words({self.recording.name: ending}, self.alarms))
        return "\n".join(lines)

    def _repr_html_(self) -> str:
        # The same, and the first rows as a table, for notebooks.
        columns = shown_columns(100, planar=self.setup.is_planar, several=len(self.recording.instruments) > 1)
        text = "".join(text_lines(columns, map(self._row, self.results[:10])))
        return f"<pre>{escape(repr(self))}\n\n{escape(text)}</pre>"

    def _row(self, result: FrameResult) -> Row:
        return estimate_row(self.recording.name, result, self.setup.method, self.setup.equations)

    def __getitem__(self, index: Any) -> Any:
        return self.results[index]

    def __len__(self) -> int:
        return len(self.results)

    def rows(self) -> Iterator[Row]:
        """The rows of `svmdist estimate -f csv`, in SI; None for what does not exist."""
        for row in map(self._row, self.results):
            yield {key: row.get(key) for key in ESTIMATE_KEYS}

    def to_dataframe(self) -> DataFrame:
        """A pandas DataFrame with the columns of the CSV; raises SvmdistError where pandas is not installed."""
        try:
            import pandas as pd
        except ImportError:
            raise SvmdistError("to_dataframe needs pandas, which is not installed: pip install pandas") from None
        table = pd.DataFrame.from_records(list(self.rows()), columns=ESTIMATE_KEYS)
        for column in ESTIMATE_COLUMNS:
            if column.stored and column.unit != TEXT and table[column.key].isna().any():
                table[column.key] = table[column.key].astype(float)
        return table


def open_recording(
    path: Path | str, profile: str | Path | Profile = DEFAULT_PROFILE, *, topics: dict[str, str] | None = None
) -> Recording:
    """Open the log at `path`, a file, folder or URL, with a profile: a shipped one by its name, a file, or a `Profile`.

    Args:
        path: The log.
        profile: What the log shows.
        topics: Topics of roles, as `{"image": "/left/image_raw"}`, instead of the profile's.

    Raises ProfileError, RecordingError for a file that is no recording, or UsageError for what is no path.
    """
    if not isinstance(path, str | Path | RemoteFile):
        raise UsageError(f"expected the path or URL of a log, found {type(path).__name__}")
    return _open(path, profile if isinstance(profile, Profile) else load_profile(profile), topics=topics)


def estimate(
    recording: Recording,
    method: Method = "auto",
    *,
    calibration: Path | None = None,
    hand_eye: Path | None = None,
    lag: Lag | None = None,
    instruments: Sequence[str] | None = None,
    alarms: AlarmRules | None = None,
    start_s: float = 0.0,
    end_s: float = math.inf,
    every: int = 1,
    jobs: int | None = None,
) -> Estimates:
    """Measure the images of a recording; the method `"auto"` is the best that it can serve.

    Args:
        recording: A log, as `open_recording` gives it.
        method: A method's name, or an object with `estimate(frame)`.
        calibration: The file of planar methods, in place of the profile's.
        hand_eye: The file of camera-to-base transforms, in place of the profile's.
        lag: Taken off the images' stamps first, in s, or `"auto"`.
        instruments: Names of those to measure, by default all.
        alarms: Fills the columns of alarms, as `AlarmRules(below_m=0.005)`.
        start_s: Where to begin, in seconds after the first image.
        end_s: Where to end.
        every: Every so-many-th image is measured.
        jobs: Processes; results do not depend on them.
    """
    _opened([recording])
    for name, value, kind, expected in (
        ("start_s", start_s, Real, "a number"),
        ("end_s", end_s, Real, "a number"),
        ("lag", 0 if lag in (None, "auto") else lag, Real, "a number"),
        ("every", every, Integral, "a whole number"),
        ("alarms", alarms, AlarmRules | None, "AlarmRules"),
    ):
        if not isinstance(value, kind):
            raise UsageError(f"{name}: expected {expected}, found {value!r}")
    if isinstance(instruments, str) or (instruments is not None and not instruments):
        raise UsageError(f"instruments: expected a sequence of names, found {instruments!r}")
    if hand_eye is not None:
        origin = recording.origin
        origin = origin._replace(profile=taking_hand_eye(origin.profile, hand_eye))
        recording = replace(recording, origin=origin, bases=origin.open().bases)
    if (start_s, end_s, every) != (0.0, math.inf, 1):
        recording = replace(recording, window=Window(start_s, end_s, every))
    setup = _setup(recording, method, calibration, lag)
    if alarms is not None:
        require_clearance(setup)
    names = None if instruments is None else tuple(instruments)
    read, _ = with_lag(replace(recording, wanted=names), Request(setup, lag=lag), jobs)
    return Estimates(recording, setup, tuple(_estimate(read, setup, jobs, alarms=alarms)), alarms)


def validate(
    recordings: Recording | Sequence[Recording],
    method: Method = "auto",
    *,
    estimates: str | None = None,
    calibration: Path | None = None,
    rules: TruthRules | None = None,
    lag: Lag | None = None,
    alarms: AlarmRules | None = None,
    jobs: int | None = None,
) -> Validation:
    """Score a method on recordings of one profile against each reference that they have.

    Args:
        recordings: One log or several.
        method: As in `estimate`.
        estimates: Those of others in place of a method's: a file's or, with `topic:` before it, a topic's.
        calibration: The file of planar methods, in place of the profile's.
        rules: Choose the references.
        lag: Taken off the images' stamps first, in s, or `"auto"`.
        alarms: Scored against the true clearance.
        jobs: Processes; results do not depend on them.

    Raises RecordingError where a recording has no reference.
    """
    several = _opened(recordings)
    setup = _setup(several[0], given_estimates(estimates) if estimates else method, calibration, lag)
    return _validate(several, Request(setup, lag=lag, alarms=alarms, rules=rules or TruthRules()), jobs)


def compare(
    recordings: Recording | Sequence[Recording],
    methods: Method | Sequence[Method] | None = None,
    *,
    estimates: Sequence[str] = (),
    jobs: int | None = None,
) -> list[MethodScore]:
    """Measure recordings of one profile with methods side by side, all that they can serve where none is named.

    Args:
        recordings: One log or several.
        methods: One or several, as in `estimate`.
        estimates: As in `validate`.
        jobs: Processes; results do not depend on them.
    """
    first, *others = _opened(recordings)
    given = [_setup(first, given_estimates(text)) for text in estimates]
    named = prepare_methods(first.origin.profile) if methods is None else [_setup(first, one) for one in _each(methods)]
    return _compare([first, *others], [*named, *given], jobs=jobs)


def surface(recording: Recording, frame: int = 0) -> TissueSurface:
    """The tissue's surface that both views of a recording's image number `frame`, from 0, show.

    It has points, normals and deviations, in the left camera's frame.
    Raises RecordingError where the log has no right view, or the image shows no surface; UsageError without the image.
    """
    _opened([recording])
    return _surface(recording, frame)


def _each(one_or_several: Any) -> list[Any]:
    is_several = isinstance(one_or_several, Iterable) and not isinstance(one_or_several, str)
    return list(one_or_several) if is_several else [one_or_several]


def _opened(recordings: Recording | Sequence[Recording]) -> list[Recording]:
    several = _each(recordings)
    if not several:
        raise UsageError("expected a recording or several, found none")
    for one in several:
        if not isinstance(one, Recording):
            raise UsageError(f"expected what svmdist.open_recording gives, found {type(one).__name__}")
    return several


def _setup(recording: Recording, method: Method, calibration: Path | None = None, lag: Lag | None = None) -> Setup:
    profile, has_lag = recording.origin.profile, (lag or recording.lag) is not None
    if method == "auto" and calibration is not None:
        method = "overlay"
    elif method == "auto":
        method, _ = best_method([recording.path], profile, recording.origin.topics, has_lag=has_lag)
    return prepare(profile, method, "corrected", calibration)
