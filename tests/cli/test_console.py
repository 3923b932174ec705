"""Where output goes: data to stdout or a whole file, words to stderr, and nothing before it can be written."""

from __future__ import annotations

import csv
import io
import json
import os
import subprocess
import sys
from dataclasses import dataclass, field
from pathlib import Path

import pytest
from svmdist.cli.console import (
    ExitCode,
    report_health,
    require_output,
    say,
    terminal_width,
    write_lines,
    write_results,
)
from svmdist.cli.recordings import logs_or_golden

from svmdist.errors import OutputError, UsageError
from svmdist.metrics import RATIO, TEXT
from svmdist.recording.source import Health, Loss, LossKind
from svmdist.report.tables import Column, Table
from svmdist.report.writers import Holds, Results, choose_writer

Captured = pytest.CaptureFixture[str]


COLUMNS = (Column("name", TEXT, "name"), Column("value", RATIO, "value"))
ROWS = [{"name": "é", "value": 0.5}, {"name": "=b", "value": None}]
NOTE = "word " * 100


def results() -> Results:
    """Two rows and a long note."""
    return Results(COLUMNS, ROWS, tables=[Table.of("", COLUMNS, ROWS)], notes=[NOTE])


def test_words_go_to_stderr_without_control_characters(capsys: Captured) -> None:
    """A name of a log must not drive a terminal: one line for each call."""
    say("a\x1b[31m\nb")
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == "a\N{REPLACEMENT CHARACTER}[31m\N{REPLACEMENT CHARACTER}b\n"


def test_lines_go_to_stdout_or_to_a_whole_file(tmp_path: Path, capsys: Captured) -> None:
    """Line ends stay as they are."""
    lines = ["a\r\n", "é\n"]
    write_lines(iter(lines), None)
    assert capsys.readouterr().out == "".join(lines)
    write_lines(iter(lines), tmp_path / "a.csv")
    assert (tmp_path / "a.csv").read_bytes() == "".join(lines).encode()
    assert capsys.readouterr().out == ""


def test_a_file_keeps_what_it_had_where_writing_fails(tmp_path: Path) -> None:
    path = tmp_path / "a.csv"
    path.write_text("kept")

    def lines() -> object:
        yield "new\n"
        raise RuntimeError("no more")

    with pytest.raises(RuntimeError, match="no more"):
        write_lines(lines(), path)  # type: ignore[arg-type]
    assert path.read_text() == "kept"
    assert list(tmp_path.iterdir()) == [path]


def test_a_reader_that_has_enough_is_no_error() -> None:
    """As with `| head`: a million lines to a pipe that is closed, exit code 0, not a word."""
    code = "from svmdist.cli.console import write_lines; write_lines((f'{n}\\n' for n in range(10**6)), None)"
    with subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE
    ) as process:
        assert process.stdout is not None
        assert process.stderr is not None
        assert process.stdout.readline() == b"0\n"
        process.stdout.close()
        assert process.stderr.read() == b""
    assert process.returncode == ExitCode.CLEAN


def test_a_summary_holds_the_same_in_every_form(capsys: Captured) -> None:
    """JSON has every value, CSV a row for each with no formula for a spreadsheet, a table its notes."""
    write_results(results(), choose_writer("json", None, Holds.TABLES), None)
    assert json.loads(capsys.readouterr().out) == ROWS
    write_results(results(), choose_writer("csv", None, Holds.TABLES), None)
    rows = list(csv.DictReader(io.StringIO(capsys.readouterr().out)))
    assert [row["name"] for row in rows] == ["é", "'=b"]
    assert [row["value"] for row in rows] == ["0.5", ""]


def test_tables_in_a_file_have_neither_colour_nor_width(tmp_path: Path) -> None:
    """A note is one line, however long."""
    write_results(results(), choose_writer(None, None, Holds.TABLES), tmp_path / "a.txt")
    text = (tmp_path / "a.txt").read_text()
    assert "\x1b" not in text
    assert "0.5" in text
    assert text.splitlines()[-1] == NOTE


def test_a_pipe_has_no_width(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nor has a file, though stdout is a terminal."""
    assert terminal_width(None) is None
    monkeypatch.setattr(sys.stdout, "isatty", lambda: True)
    monkeypatch.setattr(os, "get_terminal_size", lambda: os.terminal_size((77, 20)))
    assert terminal_width(None) == 77
    assert terminal_width(tmp_path / "a.txt") is None


def test_an_output_is_checked_before_the_work(tmp_path: Path) -> None:
    """The recording itself, by a link too; a folder; a folder that is not there. A new file is none of them."""
    log = tmp_path / "log.mcap"
    log.write_bytes(b"")
    link = tmp_path / "link.mcap"
    link.symlink_to(log)
    for output in (log, link):
        with pytest.raises(UsageError, match="is the recording to read"):
            require_output(output, [log])
    with pytest.raises(OutputError, match="it is a folder"):
        require_output(tmp_path, [log])
    with pytest.raises(OutputError, match="there is no folder"):
        require_output(tmp_path / "no" / "a.csv", [log])
    require_output(tmp_path / "a.csv", [log, tmp_path / "gone.mcap"])
    require_output(None, [log])
    assert not (tmp_path / "a.csv").exists()


def test_an_output_without_permission_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Permission is simulated, for root has every one."""
    monkeypatch.setattr(os, "access", lambda *_: False)
    with pytest.raises(OutputError, match="permission denied"):
        require_output(tmp_path / "a.csv")


def test_without_a_file_the_golden_logs_are_taken(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those of the folder recordings here, sorted; with none, the error names it."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(UsageError, match=r"no FILE given, and there is no \.mcap in .*recordings"):
        logs_or_golden(None)
    (tmp_path / "recordings").mkdir()
    for name in ("b.mcap", "a.mcap", "c.txt"):
        (tmp_path / "recordings" / name).touch()
    assert [str(log.path) for log in logs_or_golden([])] == ["recordings/a.mcap", "recordings/b.mcap"]
    assert [log.path for log in logs_or_golden(["mine"])] == [Path("mine")]


@dataclass
class Log:
    """What was read of a file."""

    path: Path
    health: Health = field(default_factory=Health)


def test_losses_are_told_and_give_an_exit_code(capsys: Captured) -> None:
    """One line for each, with the recording that it is of; clean ones are not mentioned."""
    clean, broken = Log(Path("a.mcap")), Log(Path("b.mcap"))
    assert report_health([clean]) is ExitCode.CLEAN
    assert capsys.readouterr().err == ""
    broken.health.add(Loss(LossKind.CHUNK, "its CRC is wrong", 7))
    assert report_health([broken, clean]) is ExitCode.LOSS
    assert capsys.readouterr().err == "svmdist: loss: b.mcap: chunk at byte 7: its CRC is wrong\n"


def test_exit_codes_differ() -> None:
    assert ExitCode.CLEAN == 0
    assert len({int(code) for code in ExitCode}) == len(ExitCode)
    assert all(0 <= code < 256 for code in ExitCode)
