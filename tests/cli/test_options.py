"""Options that many commands have, remarks and progress, and how logs are named."""

import logging

import pytest

from svmdist.cli import output
from svmdist.cli.logs import named_logs
from tests.synthetic import write_log


def test_quiet_and_verbose_are_options_and_not_values(cli, synthetic_log, tmp_path):
    """Before and behind the command's name; where they are the value of an option, they are that."""
    command = ("estimate", synthetic_log, "--method", "kinematic", "-f", "csv")
    assert "frames measured" in cli(*command).err
    assert cli(*command, "-q").err == cli("-q", *command).err == ""
    assert "joints /" in cli(*command, "-v").err
    named = write_log(tmp_path / "-q", frame_count=1)
    assert "--instrument -q: profile" in cli(*command, "--instrument", "-q", code=2).line
    assert "1 of 1 frames" in cli("estimate", "--method", "kinematic", "-f", "csv", "--", named).err


def test_frames_keep_their_number_in_the_log(cli, golden, tmp_path):
    """The worst frame of a window is the one that `show` draws by its number, and times are those of the log."""
    pytest.importorskip("plotly", reason="the extra report is not installed")
    log, report = golden / "sweep.mcap", tmp_path / "a.html"
    options = ("--start", "7", "--every", "4")
    cli("validate", log, "--truth", "ground_truth", *options, "--report", report)
    page = report.read_text("utf-8")
    assert "frame 74 at 7.40 s" in page
    assert "frame 1 at" not in page
    table = cli("estimate", log, *options).out.splitlines()
    assert [line.split()[1] for line in table[2:]] == ["7.000", "7.400", "7.800"]


@pytest.mark.slow
def test_degrade_all_is_every_degradation_at_every_severity(cli, synthetic_log):
    found = cli("compare", synthetic_log, "--method", "kinematic", "--degrade", "all", "-f", "csv")
    assert len({row["degradation"] for row in found.rows} - {"", "all"}) == 7 * 5


@pytest.mark.parametrize(
    ("option", "commands"),
    [
        ("--hand-eye", "estimate validate compare blur-bench show info fk calibrate"),
        ("--lag", "estimate validate compare show hand-eye"),
    ],
)
def test_every_measuring_command_takes_what_the_guide_says(cli, option, commands):
    assert all(option in cli(command, "--help").out for command in commands.split())


def test_progress_is_a_line_every_ten_seconds(caplog):
    times = iter([0.0, 1.0, 10.0, 15.0, 20.5])
    advance = output._lines("measuring", "rows", lambda: next(times))
    with caplog.at_level(logging.INFO, "svmdist"):
        for done, total in ((1, 40), (10, 40), (15, None), (20, None)):
            advance(done, total)
    assert caplog.messages == ["measuring: 10 of 40 rows, 1.0 rows/s", "measuring: 20 rows, 1.0 rows/s"]


def test_logs_are_named_by_files_folders_and_globs(tmp_path):
    """Each once, under a name of its own."""
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        write_log(tmp_path / folder / "x.mcap", frame_count=1)
    assert [log.name for log in named_logs([tmp_path / "a", tmp_path / "*" / "*.mcap"])] == ["a/x", "b/x"]
