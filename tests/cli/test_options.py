"""Options that many commands have, remarks and progress, and how logs are named."""

import pytest
import typer

import svmdist
from svmdist.cli import output
from svmdist.cli.logs import named_logs
from svmdist.cli.main import app
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


def test_help_fits_a_screen_or_two_and_has_every_option(cli):
    text = cli("estimate", "--help").out
    assert len(text.splitlines()) <= 60
    assert max(map(len, text.splitlines())) <= 80
    assert text.index("Examples:") < text.index("Input:") < text.index("Method:") < text.index("Output:")
    parameters = typer.main.get_command(app).commands["estimate"].params
    assert not [one for one in parameters if not one.hidden and (one.opts[0] not in text and one.metavar not in text)]


@pytest.mark.parametrize("command", [*typer.main.get_command(app).commands, "profile new"])
def test_no_line_of_help_is_wider_than_a_terminal(cli, command):
    assert max(map(len, cli(*command.split(), "--help").out.splitlines())) <= 80


def test_json_is_a_format_and_colours_may_be_forced(cli, synthetic_log, monkeypatch):
    assert cli("info", synthetic_log, "--json").out == cli("info", synthetic_log, "-f", "json").out
    command = ("compare", synthetic_log, "--method", "kinematic", "--every", "10", "--jobs", "1")
    assert "\x1b[" not in cli(*command).out
    monkeypatch.setenv("TERM", "xterm-256color")
    monkeypatch.setenv("FORCE_COLOR", "1")
    assert "\x1b[" in cli(*command).out
    monkeypatch.setenv("NO_COLOR", "1")
    assert "\x1b[" not in cli(*command).out


def test_progress_says_how_far_it_is():
    assert output._how_far(10, 40, "rows", 10.0) == "10 of 40 rows, 1.0 rows/s, 30 s left"
    assert output._how_far(20, None, "rows", 20.0) == "20 rows, 1.0 rows/s"


def test_logs_are_named_by_files_folders_and_globs(tmp_path):
    """Each once, under a name of its own."""
    for folder in ("a", "b"):
        (tmp_path / folder).mkdir()
        write_log(tmp_path / folder / "x.mcap", frame_count=1)
    assert [log.name for log in named_logs([tmp_path / "a", tmp_path / "*" / "*.mcap"])] == ["a/x", "b/x"]


def test_a_window_without_images_says_so(golden, cli):
    """One line, in Python the same."""
    log = golden / "sweep.mcap"
    said = "sweep: no image to measure from --start 100 to its end: the log has 7.9 s"
    for command in ("estimate", "validate", "compare"):
        assert cli(command, log, "--start", "100", code=1).err.splitlines()[-1] == f"svmdist: {said}"
    with pytest.raises(svmdist.errors.RecordingError, match=f"^{said}$"):
        svmdist.estimate(svmdist.open_recording(log), "overlay", start_s=100)
