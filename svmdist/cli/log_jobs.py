"""What commands do with each of many logs: jobs that travel between processes, and what they give back."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import TYPE_CHECKING

from svmdist.cli.many import group_name, heard_notes, measurement
from svmdist.cli.recordings import open_log
from svmdist.workflows.blur_bench import BlurTally, blur_tallies
from svmdist.workflows.calibrate import CalibrationPart, collect_part
from svmdist.workflows.compare import GroupedRun, grouped_runs
from svmdist.workflows.conditions import LogCondition
from svmdist.workflows.validate import Scored, score_recording

if TYPE_CHECKING:
    from svmdist.estimation.alarms import AlarmRules
    from svmdist.profile import Profile
    from svmdist.recording.observations import Window
    from svmdist.workflows.lag import Lag
    from svmdist.workflows.request import Setup
    from svmdist.workflows.scoring.truth import TruthRules

from svmdist.vision.degradations import Blur
from svmdist.workflows.batch.task import LogFile, Measurement, RowWriter


@dataclass(frozen=True)
class ValidateJob:
    """Scores a log against each reference that it has."""

    setup: Setup
    topics: dict[str, str]
    window: Window | None
    rules: TruthRules
    lag: Lag | None
    alarms: AlarmRules | None
    wanted: tuple[str, ...] | None
    grouped: bool

    @property
    def result_type(self) -> type[Scored]:
        """The type of a result."""
        return Scored

    def measure(self, log: LogFile, threads: int, _: RowWriter) -> Measurement[Scored]:
        """Score a log."""
        with heard_notes() as notes:
            recording = open_log(log, self.setup.profile, self.topics, self.window)
            scored = score_recording(
                recording, self.setup, self.rules, self.lag, self.alarms, self.wanted, threads
            )
        return measurement(recording, scored, notes, grouped=self.grouped)


@dataclass(frozen=True)
class Runs:
    """The runs of one log."""

    runs: tuple[GroupedRun, ...]


@dataclass(frozen=True)
class CompareJob:
    """Measures a log with several methods under several conditions."""

    setups: tuple[Setup, ...]
    conditions: tuple[LogCondition, ...]
    topics: dict[str, str]
    window: Window | None
    lag: Lag | None
    keys: tuple[str, ...]

    @property
    def result_type(self) -> type[Runs]:
        """The type of a result."""
        return Runs

    def measure(self, log: LogFile, threads: int, _: RowWriter) -> Measurement[Runs]:
        """Measure a log."""
        from svmdist.cli.lag import told_lag

        with heard_notes() as notes:
            opened = open_log(log, self.setups[0].profile, self.topics, self.window)
            recording = told_lag(opened, self.setups[0], self.lag, None, threads)
            by = partial(_named_group, keys=self.keys) if self.keys else None
            runs = grouped_runs([recording], self.setups, self.conditions, jobs=threads, by=by)
        return measurement(opened, Runs(tuple(runs)), notes, grouped=False)


def _named_group(metadata: Mapping[str, str], keys: tuple[str, ...]) -> str:
    return group_name(metadata, keys)


@dataclass(frozen=True)
class BlurTallies:
    """What was counted of one log under every blur."""

    tallies: dict[Blur, BlurTally]


@dataclass(frozen=True)
class BlurJob:
    """Measures a log under every blur of Table I."""

    setup: Setup
    kernels_px: dict[Blur, int]
    topics: dict[str, str]
    window: Window | None

    @property
    def result_type(self) -> type[BlurTallies]:
        """The type of a result."""
        return BlurTallies

    def measure(self, log: LogFile, threads: int, _: RowWriter) -> Measurement[BlurTallies]:
        """Measure a log."""
        with heard_notes() as notes:
            recording = open_log(log, self.setup.profile, self.topics, self.window)
            tallies = blur_tallies(recording, self.setup, self.kernels_px, threads)
        return measurement(recording, BlurTallies(tallies), notes, grouped=False)


@dataclass(frozen=True)
class CalibrateJob:
    """Collects what a log gives to a calibration."""

    profile: Profile
    method: str
    topics: dict[str, str]
    window: Window | None = None

    @property
    def result_type(self) -> type[CalibrationPart]:
        """The type of a result."""
        return CalibrationPart

    def measure(self, log: LogFile, threads: int, _: RowWriter) -> Measurement[CalibrationPart]:
        """Measure a log."""
        with heard_notes() as notes:
            recording = open_log(log, self.profile, self.topics, self.window)
            part = collect_part(recording, self.profile, self.method, threads)
        return measurement(recording, part, notes, grouped=False)
