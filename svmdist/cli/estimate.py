"""`svmdist estimate`: one row a frame."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from itertools import chain
from typing import TYPE_CHECKING

import typer

from svmdist.cli.alarms import AlarmBelowOption, AlarmConfidenceOption, alarm_rules
from svmdist.cli.console import report_health, require_output_folder, say, write_lines
from svmdist.cli.options import (
    CalibrationOption,
    EquationsChoice,
    EquationsOption,
    Files,
    Method,
    MethodOption,
    OutputOption,
    ProfileOption,
    RowFormat,
    RowFormatOption,
    TopicOption,
    topics_of,
)

if TYPE_CHECKING:
    from svmdist.estimation.alarms import AlarmRules
    from svmdist.recording.reader import Recording
    from svmdist.report.table import Row
    from svmdist.workflows.setup import Setup


def estimate_command(
    files: Files,
    method: MethodOption = Method.OVERLAY,
    equations: EquationsOption = EquationsChoice.CORRECTED,
    calibration: CalibrationOption = None,
    profile: ProfileOption = "psm13",
    topic: TopicOption = None,
    form: RowFormatOption = RowFormat.TABLE,
    output: OutputOption = None,
    alarm_below: AlarmBelowOption = None,
    alarm_confidence: AlarmConfidenceOption = None,
) -> None:
    """Estimate the distance in every frame."""
    from svmdist.recording.reader import open_recording
    from svmdist.workflows.setup import prepare

    require_output_folder(output)
    rules = alarm_rules(alarm_below, alarm_confidence, method.value)
    setup = prepare(profile, method.value, equations.value, calibration)
    recordings = [open_recording(path, setup.profile, topics=topics_of(topic)) for path in files]
    tally: Counter[str] = Counter()
    write_lines(_lines(form, _started(_rows(recordings, setup, tally, rules)), rules is not None), output)
    _summarise(tally)
    raise typer.Exit(report_health(recordings))


def _rows(
    recordings: list[Recording], setup: Setup, tally: Counter[str], rules: AlarmRules | None
) -> Iterator[Row]:
    from svmdist.estimation.alarms import AlarmWatch
    from svmdist.report.estimates import estimate_row
    from svmdist.workflows.estimate import estimate

    for recording in recordings:
        for warning in setup.degeneracies(recording.camera):
            say(f"svmdist: warning: {warning}")
        start_ns: int | None = None
        watch = AlarmWatch(rules) if rules else None
        for row in estimate(recording, setup.estimator_for(recording)):
            start_ns = row.stamp_ns if start_ns is None else start_ns
            tally[str(row.status)] += 1
            alarm = watch.watch(row) if watch else None
            yield estimate_row(recording.name, row, setup.method, setup.equations, start_ns, alarm)


def _started(rows: Iterator[Row]) -> Iterator[Row]:
    """Measure the first row at once, so that a log that cannot be read leaves no header behind."""
    first = next(rows, None)
    return iter(()) if first is None else chain([first], rows)


def _lines(form: RowFormat, rows: Iterator[Row], with_alarms: bool) -> Iterator[str]:
    from svmdist.report.estimates import ALARM_COLUMNS, ESTIMATE_COLUMNS, ESTIMATE_KEYS
    from svmdist.report.table import csv_lines, json_array_lines, json_lines, text_lines

    match form:
        case RowFormat.TABLE:
            return text_lines(ESTIMATE_COLUMNS + (ALARM_COLUMNS if with_alarms else ()), rows)
        case RowFormat.CSV:
            return csv_lines(ESTIMATE_KEYS, rows)
        case RowFormat.JSON:
            return json_array_lines(ESTIMATE_KEYS, rows)
        case RowFormat.JSONL:
            return json_lines(ESTIMATE_KEYS, rows)


def _summarise(tally: Counter[str]) -> None:
    total = sum(tally.values())
    if total == 0:
        say("svmdist: no frame to measure")
        return
    lost = ", ".join(f"{count} {reason}" for reason, count in sorted(tally.items()) if reason != "ok")
    say(
        f"svmdist: {tally['ok']} of {total} frames measured ({tally['ok'] / total:.1%})"
        + (f"; {lost}" if lost else "")
    )
