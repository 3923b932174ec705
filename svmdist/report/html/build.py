"""Building a report: of a validation with its truth, or of estimates alone."""

from __future__ import annotations

import hashlib
import platform
from collections import Counter, defaultdict
from collections.abc import Sequence
from importlib.metadata import PackageNotFoundError, version

import numpy as np
from rich.table import Table

from svmdist.estimation.alarms import AlarmRules
from svmdist.recording.reader import Recording
from svmdist.report.frame_picture import draw_on
from svmdist.report.html.page import Report, ReportFrame, ReportTable
from svmdist.report.validation_tables import remarks, validation_tables
from svmdist.workflows.annotate import drawn_frames
from svmdist.workflows.parallel import Progress, Steps
from svmdist.workflows.scoring.truth import TruthRules
from svmdist.workflows.series import Series, WorstFrame, make_series, worst_frames
from svmdist.workflows.setup import Setup
from svmdist.workflows.validate import Measured, Validation

WORST_COUNT = 10
PACKAGES = ("svmdist", "numpy", "opencv-python-headless", "mcap", "protobuf", "plotly")


def validation_report(
    validation: Validation,
    measured: Sequence[Measured],
    setup: Setup,
    rules: TruthRules,
    command: str,
    jobs: int | None = None,
    logs: Table | None = None,
    on_progress: Progress | None = None,
) -> Report:
    """The report of a validation. The worst frames are measured once more, to draw them.

    `logs` is a table of all logs, of which `measured` are some.
    """
    primary = validation.primary
    reference = primary.reference if primary else validation.scores[0].reference
    series = [
        (one, made)
        for one in measured
        for made in make_series(one.rows, one.recording, setup, rules, reference, one.lag)
    ]
    tables = [_of_rich(table) for table in validation_tables(validation)]
    lags = _lag_table(validation)
    below_m = validation.alarm_rules.below_m if validation.alarm_rules else None
    return Report(
        title=f"svmdist validate: {setup.method}",
        series=[made for _, made in series],
        tables=[*([_of_rich(logs)] if logs else []), *tables, *([lags] if lags else [])],
        frames=_worst(
            [(one.read, made) for one, made in series], setup, validation.alarm_rules, jobs, on_progress
        ),
        facts=facts(setup, [one.recording for one in measured], command),
        notes=[*validation.notes, *remarks(validation), f"Errors are against {reference}."],
        alarm_below_m=below_m,
    )


def estimate_report(
    measured: Sequence[Measured],
    setup: Setup,
    command: str,
    alarms: AlarmRules | None = None,
    jobs: int | None = None,
    logs: Table | None = None,
    on_progress: Progress | None = None,
) -> Report:
    """The report of estimates, for logs with or without a truth; where there is ground truth, it is shown.

    `logs` is a table of all logs, of which `measured` are some.
    """
    series = [
        (one, made) for one in measured for made in make_series(one.rows, one.recording, setup, lag=one.lag)
    ]
    return Report(
        title=f"svmdist estimate: {setup.method}",
        series=[made for _, made in series],
        tables=[*([_of_rich(logs)] if logs else []), _counts(series)],
        frames=_worst([(one.read, made) for one, made in series], setup, alarms, jobs, on_progress),
        facts=facts(setup, [one.recording for one in measured], command),
        alarm_below_m=alarms.below_m if alarms else None,
    )


def facts(setup: Setup, recordings: Sequence[Recording], command: str) -> list[tuple[str, str]]:
    """Where figures come from: command, versions, method, profile, calibration, and hashes of the recordings."""
    profile = setup.profile.model_dump_json(by_alias=True)
    found = [
        ("command", command),
        ("method", f"{setup.method}, {setup.equations} equations"),
        (
            "profile",
            f"{setup.profile.name}, SHA-256 of its values {hashlib.sha256(profile.encode()).hexdigest()}",
        ),
    ]
    if setup.calibration is not None:
        sources = ", ".join(f"{source.name} ({source.sha256})" for source in setup.calibration.sources)
        found.append(("calibration", f"by {setup.calibration.created_by}, fitted on {sources}"))
    found += [
        (str(one.path), f"SHA-256 {one.sha256()}, {one.size_bytes() / 1e6:.2f} MB") for one in recordings
    ]
    found.append(("Python", f"{platform.python_version()} on {platform.system()} {platform.machine()}"))
    return found + [(name, _version(name)) for name in PACKAGES]


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "not installed"


def _worst(
    series: Sequence[tuple[Recording, Series]],
    setup: Setup,
    alarms: AlarmRules | None,
    jobs: int | None,
    on_progress: Progress | None,
) -> list[ReportFrame]:
    """The worst frames of all logs, drawn, the worst first."""
    found: list[tuple[Recording, WorstFrame]] = []
    logs: dict[int, tuple[Recording, list[Series]]] = {}
    for recording, one in series:
        logs.setdefault(id(recording), (recording, []))[1].append(one)
    for recording, own in logs.values():
        found += [(recording, frame) for frame in worst_frames(own, WORST_COUNT)]
    found.sort(key=lambda pair: -pair[1].badness_m)
    chosen = found[:WORST_COUNT]
    wanted = defaultdict[int, set[int]](set)
    for recording, frame in chosen:
        wanted[id(recording)].add(frame.number)
    pictures = {}
    steps = Steps(on_progress, sum(max(numbers) + 1 for numbers in wanted.values()))
    for key, numbers in wanted.items():
        for drawn in drawn_frames(
            logs[key][0], setup, alarms, jobs=jobs, numbers=numbers, on_image=steps.advance
        ):
            image = drawn.replayed.image_bgr
            if image is not None:
                pictures[key, drawn.number] = draw_on(image, drawn.drawing)
    return [
        ReportFrame(f"{recording.name}, {frame.in_words}", pictures[id(recording), frame.number])
        for recording, frame in chosen
        if (id(recording), frame.number) in pictures
    ]


def _counts(series: Sequence[tuple[Measured, Series]]) -> ReportTable:
    rows = []
    for _, one in series:
        lost = Counter(status for status, seen in zip(one.status, one.measured, strict=True) if not seen)
        reasons = ", ".join(f"{count} {status}" for status, count in lost.most_common()) or "–"
        known_m = one.estimate_m[one.measured]
        span = f"{known_m.min() * 1e3:.2f} to {known_m.max() * 1e3:.2f}" if len(known_m) else "–"
        halves_m = one.half_m[np.isfinite(one.half_m)]
        half = f"{np.median(halves_m) * 1e3:.2f}" if len(halves_m) else "–"
        share = f"{one.measured.mean():.1%}" if len(one) else "–"
        rows.append((one.recording, one.instrument, str(len(one)), share, reasons, one.distance, span, half))
    headings = (
        *("recording", "instrument", "frames", "measured", "not measured", "distance"),
        *("range [mm]", "median half interval [mm]"),
    )
    return ReportTable("Frames", headings, rows)


def _lag_table(validation: Validation) -> ReportTable | None:
    """Errors before and after the lag was taken off, where one was."""
    rows = []
    for score in validation.scores:
        if (
            score.lag is None
            or score.lag.lag_s == 0.0
            or score.uncorrected is None
            or score.statistics is None
        ):
            continue
        rows.append(
            (
                score.recording,
                str(score.reference),
                f"{score.lag.lag_s * 1e3:+.1f}",
                f"{score.lag.confidence:.2f}",
                f"{score.uncorrected.rmse * 1e3:.2f}",
                f"{score.statistics.rmse * 1e3:.2f}",
            )
        )
    if not rows:
        return None
    headings = ("recording", "against", "lag [ms]", "confidence", "RMSE before [mm]", "RMSE after [mm]")
    return ReportTable("Lag before and after: planar distance", headings, rows)


def _of_rich(table: object) -> ReportTable:
    """A table for the terminal as one for the page."""
    assert isinstance(table, Table)
    cells = [[str(cell) for cell in column.cells] for column in table.columns]
    headings = [str(column.header).strip() for column in table.columns]
    return ReportTable(str(table.title or ""), headings, list(zip(*cells, strict=True)))
