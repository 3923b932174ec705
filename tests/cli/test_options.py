"""Options and remarks: what every command does with them, and what is refused before the work in one line."""

from __future__ import annotations

import csv
import inspect
import io
import logging
from pathlib import Path

import pytest

from svmdist.cli import output
from svmdist.cli.logs import named_logs
from svmdist.cli.options import MeasureOptions, function_of
from tests.cli.conftest import Cli, Outcome
from tests.synthetic import write_log


def rows_of(outcome: Outcome) -> list[dict[str, str]]:
    assert outcome.code == 0, outcome.err
    return list(csv.DictReader(io.StringIO(outcome.out)))


def test_quiet_and_verbose_are_options_and_not_values(cli: Cli, synthetic_log: Path, tmp_path: Path) -> None:
    """Before and behind the command's name; where they are the value of an option, they are that."""
    command = ("estimate", synthetic_log, "--method", "kinematic", "-f", "csv")
    assert "frames measured" in cli(*command).err
    assert cli(*command, "-q").err == ""
    assert cli("-q", *command).err == ""
    assert "joints /" in cli(*command, "-v").err
    named = write_log(tmp_path / "-q", frame_count=1)
    as_value = cli(*command, "--instrument", "-q")
    assert (as_value.code, as_value.err.count("\n")) == (2, 1)
    assert "--instrument -q: profile" in as_value.err
    assert "1 of 1 frames" in cli("estimate", "--method", "kinematic", "-f", "csv", "--", named).err


def test_frames_keep_their_number_in_the_log(cli: Cli, golden: Path, tmp_path: Path) -> None:
    """The worst frame of a window is the one that `show` draws by its number, and times are those of the log."""
    pytest.importorskip("plotly", reason="the extra report is not installed")
    pytest.importorskip("jinja2", reason="the extra report is not installed")
    log, report = golden / "sweep.mcap", tmp_path / "a.html"
    options = ("--start", "7", "--every", "4", "--report", report)
    assert cli("validate", log, "--truth", "ground_truth", *options).code == 0
    page = report.read_text("utf-8")
    assert "frame 74 at 7.40 s" in page
    assert "frame 1 at" not in page
    table = cli("estimate", log, "--start", "7", "--every", "4").out.splitlines()
    assert [line.split()[1] for line in table[2:]] == ["7.000", "7.400", "7.800"]


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("estimate", "LOG", "--lag", "soon"), "expected auto or seconds"),
        (("estimate", "LOG", "--lag", "1e9"), "within ±3600"),
        (("estimate", "LOG", "--topic", "image"), "expected ROLE=TOPIC"),
        (("estimate", "LOG", "--instrument", "PSM9"), "no such instrument"),
        (("estimate", "LOG", "--start", "3", "--end", "2"), "is before --start"),
        (("estimate", "LOG", "--group", "world"), "--summary FILE"),
        (("estimate", "LOG", "-o", "a.html", "--report", "b.html"), "leave out one"),
        (("estimate", "LOG", "-o", "a.mp4", "--report", "b.html"), "by itself"),
        (("estimate", "LOG", "-o", "a.mcap", "--resume", "x"), "by itself"),
        (("estimate", "LOG", "-f", "parquet"), "is no text"),
        (("estimate", "LOG", "-o", "a.avi"), "no format has the ending .avi"),
        (("validate", "LOG", "--plot", "time"), "--save-plot FILE"),
        (("validate", "LOG", "--group", "a,,b"), "expected names of metadata"),
        (("compare", "LOG", "--degrade", "smoke"), "expected NAME=SEVERITY"),
        (("compare", "LOG", "--degrade", "smok=3"), "did you mean smoke"),
        (("compare", "LOG", "--perturb", "focl=1"), "did you mean focal"),
        (("compare", "LOG", "--jobs", "2", "--scheduler", "tcp://x:1"), "leave out one"),
        (("blur-bench", "LOG", "--kernel", "gausian=5"), "did you mean gaussian"),
        (("blur-bench", "LOG", "--kernel", "gaussian=4"), "an odd size"),
        (("record", "--skip-existing"), "goes with --episodes"),
        (("record", "--renderer", "egl"), "leave the option out"),
        (("fk", "LOG", "LOG2", "-f", "tum"), "one trajectory"),
        (("estimate", "LOG", "LOG2", "-o", "a.mcap"), "holds one recording"),
        (("estimate", "LOG", "-f", "csv", "-o", "a.mcap"), "leave out one of them"),
        (("estimate", "LOG", "--summary", "s.csv", "-o", "a.mp4"), "write a.mp4 by itself"),
        (("estimate", "LOG", "--method", "overlay", "--alarm-below", "5mm"), "fused"),
        (("validate", "LOG", "--method", "centroid", "--alarm-below", "5mm"), "fused"),
        (("validate", "LOG", "--alarm-confidence", "0.5"), "--alarm-below"),
        (("record", "--degrade", "smok=3"), "did you mean smoke? The choices are: defocus, jpeg, low_light"),
        (("record", "--degrade", "smoke=6"), "a whole number from 1 to 5, found 6"),
        (("record", "--degrade", "smoke=3=4"), "expected NAME=SEVERITY, as in smoke=3"),
        (("show", "LOG", "--masks", "--frame", "99"), "has 40 images, 0 to 39"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, tuple) else "",
)
def test_wrong_requests_are_one_line(
    cli: Cli,
    synthetic_log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: tuple[str, ...],
    said: str,
) -> None:
    """With exit code 2, and no file is left."""
    other = write_log(tmp_path / "other.mcap", frame_count=1)
    named = {"LOG": synthetic_log, "LOG2": other}
    monkeypatch.chdir(tmp_path)
    outcome = cli(*(named.get(argument, argument) for argument in arguments))
    assert outcome.code == 2, outcome.err
    assert said in outcome.err
    assert len(outcome.err.splitlines()) == 1
    assert list(tmp_path.iterdir()) == [other]


@pytest.mark.slow
def test_degrade_all_is_every_degradation_at_every_severity(cli: Cli, synthetic_log: Path) -> None:
    found = cli("compare", synthetic_log, "--method", "kinematic", "--degrade", "all", "-f", "csv")
    degraded = {row["degradation"] for row in rows_of(found)} - {"", "all"}
    assert len(degraded) == 7 * 5


def test_every_measuring_command_takes_what_the_guide_says(cli: Cli) -> None:
    """A transform of hand-eye, and a lag and instruments where a method measures."""
    for command in ("estimate", "validate", "compare", "blur-bench", "show", "info", "fk", "calibrate"):
        assert "--hand-eye" in cli(command, "--help").out
    for command in ("estimate", "validate", "compare", "show", "hand-eye"):
        assert "--lag" in cli(command, "--help").out


def test_an_option_is_declared_in_one_place() -> None:
    """The parameters of a command are the fields of its class: groups first, its own last."""

    class Given(MeasureOptions):
        own: int = 3

    names = list(inspect.signature(function_of(Given)).parameters)
    assert names[-3:] == ["own", "quiet", "verbose"]
    assert {"method", "profile", "lag", "every", "alarm_below"} <= set(names)


def test_progress_is_a_line_every_ten_seconds(caplog: pytest.LogCaptureFixture) -> None:
    times = iter([0.0, 1.0, 10.0, 15.0, 20.5])
    advance = output._lines("measuring", "rows", lambda: next(times))
    with caplog.at_level(logging.INFO, "svmdist"):
        for done, total in ((1, 40), (10, 40), (15, None), (20, None)):
            advance(done, total)
    assert caplog.messages == [
        "measuring: 10 of 40 rows, 1.0 rows/s",
        "measuring: 20 rows, 1.0 rows/s",
    ]


def test_logs_are_named_by_files_folders_and_globs(tmp_path: Path) -> None:
    """Each once, under a name of its own."""
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        write_log(tmp_path / folder / "x.mcap", frame_count=1)
    logs = named_logs([tmp_path / "a", tmp_path / "*" / "*.mcap"])
    assert [log.name for log in logs] == ["a/x", "b/x"]
