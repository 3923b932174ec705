"""Which logs and images a command reads, and how much it says."""

from __future__ import annotations

import csv
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from svmdist.cli.recordings import logs_in, window_of

from svmdist.errors import UsageError
from svmdist.input_file import unique_names
from svmdist.recording.observations import Window
from tests.cli.conftest import Cli


def rows_of(text: str) -> list[dict[str, str]]:
    return list(csv.DictReader(text.splitlines()))


@pytest.fixture
def folders(golden: Path, tmp_path: Path) -> Path:
    """Two folders with a log called contact.mcap each, and a file in one that is no log."""
    for folder, log in (("a", "sweep"), ("b", "contact")):
        (tmp_path / folder).mkdir()
        shutil.copy(golden / f"{log}.mcap", tmp_path / folder / "contact.mcap")
    (tmp_path / "b" / "junk.mcap").write_text("junk")
    return tmp_path


def test_a_window_has_the_images_between_its_ends_and_every_nth(golden: Path, cli: Cli) -> None:
    log = golden / "sweep.mcap"
    every = rows_of(cli("estimate", log, "--method", "centroid", "-f", "csv").out)
    some = cli(
        "estimate", log, "--method", "centroid", "-f", "csv", "--start", 1, "--end", 2, "--every", 3
    ).out
    assert rows_of(some) == every[10:21:3]
    assert cli("estimate", log, "--start", 2, "--end", 1).code == 2


def test_a_calibration_of_a_window_is_fitted_on_its_frames(golden: Path, cli: Cli, tmp_path: Path) -> None:
    """3 to 6 s at 10 Hz are 31 images; a log of too few of them cannot be calibrated on."""
    log, output = golden / "calibration.mcap", tmp_path / "c.toml"
    said = cli("calibrate", log, "-o", output, "--start", 3, "--end", 6).err
    assert f"{output}: 31 frames" in said
    assert "sample_count = 31\n" in output.read_text("utf-8")
    assert (
        "16 frames"
        in cli("calibrate", log, "-o", output, "--start", 3, "--end", 6, "--every", 2, "--force").err
    )
    outcome = cli("calibrate", log, "-o", output, "--end", 0.5, "--force")
    assert (outcome.code, outcome.err) == (
        1,
        "svmdist: expected at least 12 measured frames to calibrate, found 6\n",
    )


def test_poses_of_a_window_are_those_of_its_joint_states(golden: Path, cli: Cli) -> None:
    """1 to 1.1 s of 100 Hz: every third joint state, and the errors against the pose topic are theirs."""
    log = golden / "3d" / "contact.mcap"
    every = rows_of(cli("fk", log).out)
    some = cli("fk", log, "--start", 1, "--end", 1.1, "--every", 3)
    first_ns = int(every[0]["stamp_ns"])
    wanted = [row for row in every if 10**9 <= int(row["stamp_ns"]) - first_ns <= 1_100_000_000][::3]
    assert len(wanted) == 4
    for row, expected in zip(rows_of(some.out), wanted, strict=True):
        assert row["stamp_ns"] == expected["stamp_ns"]
        # A few poses are computed in another order than many.
        assert float(row["x_m"]) == pytest.approx(float(expected["x_m"]), abs=1e-12)
    assert "against 4 poses" in some.err
    late = cli("fk", log, "--start", 99)
    assert (late.code, late.out) == (1, "")
    assert late.err == "svmdist: contact.mcap: no joint state is between --start and --end\n"


def test_hand_eye_sees_the_images_of_a_window(golden: Path, cli: Cli) -> None:
    log = golden / "real" / "random.mcap"
    outcome = cli("hand-eye", log, "--method", "fiducial", "-f", "json", "--start", 1, "--every", 2)
    (row,) = json.loads(outcome.out)
    whole = json.loads(cli("hand-eye", log, "--method", "fiducial", "-f", "json").out)[0]
    assert 8 <= row["frame_count"] < 0.6 * whole["frame_count"]


def test_a_window_without_an_image_is_told(golden: Path, cli: Cli) -> None:
    for command in ("estimate", "validate", "compare", "blur-bench"):
        outcome = cli(command, golden / "sweep.mcap", "--start", 99, "-f", "csv")
        assert outcome.code == 1
        assert "image" in outcome.err


def test_the_number_of_images_in_a_window() -> None:
    """Known where only every N-th is taken; else it depends on the stamps."""
    assert [Window(every=3).count_of(n) for n in (0, 1, 3, 4)] == [0, 1, 1, 2]
    assert Window(1.0).count_of(10) is None
    assert Window(end_s=1.0).count_of(10) is None
    stamps_ns = np.arange(10) * 100_000_000 + 5
    assert Window(0.2, 0.7, 2).places(stamps_ns).tolist() == [2, 4, 6]
    assert Window(0.2).places(stamps_ns[:0]).tolist() == []


def test_window_options() -> None:
    assert window_of(0.0, None, 1) is None
    assert window_of(1.0, 2.0, 3) == Window(1.0, 2.0, 3)
    with pytest.raises(UsageError, match="before"):
        window_of(2.0, 1.0, 1)


def test_logs_of_one_name_in_two_folders_are_two(folders: Path, cli: Cli) -> None:
    outcome = cli("estimate", folders / "a", folders / "b", "--every", 40, "-f", "csv")
    assert outcome.code == 3
    assert [row["recording"] for row in rows_of(outcome.out)] == ["a/contact"] * 2 + ["b/contact"] * 2
    assert "left out" in outcome.err
    assert "junk.mcap" in outcome.err


def test_validate_scores_what_it_can(folders: Path, cli: Cli) -> None:
    outcome = cli("validate", folders / "b", folders / "a", "--every", 8, "-f", "csv", "--method", "centroid")
    assert outcome.code == 3
    named = {row["recording"] for row in rows_of(outcome.out)}
    assert named == {"a/contact", "b/contact", "overall"}


def test_one_log_that_cannot_be_read_is_an_error(folders: Path, cli: Cli) -> None:
    outcome = cli("estimate", folders / "b" / "junk.mcap")
    assert (outcome.code, outcome.err.count("\n")) == (1, 1)


def test_names_take_as_many_folders_as_they_need() -> None:
    assert unique_names([Path("/x/a/c.mcap"), Path("/y/a/c.mcap"), Path("/y/d.mcap")]) == [
        "x/a/c",
        "y/a/c",
        "d",
    ]
    assert unique_names([Path("/x/c.mcap"), Path("/x/c.mcap")]) == ["c", "c"]


def test_a_folder_without_logs_stands_for_itself(tmp_path: Path) -> None:
    assert logs_in(tmp_path) == [tmp_path]
    assert logs_in(tmp_path / "a.mcap") == [tmp_path / "a.mcap"]


def test_quiet_says_errors_only_and_verbose_says_topics_and_time(golden: Path, cli: Cli) -> None:
    log, few = golden / "sweep.mcap", ("--method", "centroid", "--every", 40, "-f", "csv")
    quiet, plain, verbose = (cli("estimate", log, *few, *flag) for flag in (["-q"], [], ["-v"]))
    assert quiet.out == plain.out == verbose.out
    assert quiet.err == ""
    assert plain.err == "svmdist: 2 of 2 frames measured (100.0%)\n"
    assert "image /ECM/left/image" in verbose.err
    assert " took " in verbose.err
    assert cli("-q", "estimate", log, *few).err == ""
    assert "no such file" in cli("estimate", "none.mcap", "-q").err
    assert cli("-V").out == cli("--version").out


@pytest.mark.parametrize("command", ["estimate", "validate", "compare", "blur-bench", "info"])
def test_an_ending_that_no_format_has_is_refused_before_any_work(
    cli: Cli, tmp_path: Path, command: str
) -> None:
    """A table in a file called .avi is not what was meant. The recording is not looked at."""
    outcome = cli(command, tmp_path / "none.mcap", "-o", tmp_path / "rows.avi")
    assert (outcome.code, outcome.err.count("\n")) == (2, 1)
    assert "no format has the ending .avi: the choices are .csv, " in outcome.err
    assert list(tmp_path.iterdir()) == []


def test_poses_have_the_format_of_the_ending(cli: Cli, golden: Path, tmp_path: Path) -> None:
    log = golden / "sweep.mcap"
    lines = {}
    for name in ("a.tum", "a.json", "a.csv", "a"):
        assert cli("fk", log, "-o", tmp_path / name, "--every", 100).code == 0
        lines[name] = (tmp_path / name).read_text("utf-8").splitlines()
    assert len(lines["a.tum"][-1].split(" ")) == 8
    assert lines["a.json"][0] == "["
    assert lines["a.csv"] == lines["a"]
    assert lines["a"][0].startswith("stamp_ns,")
    refused = cli("fk", log, "-o", tmp_path / "a.xlsx")
    assert refused.code == 2
    assert ".csv, .json, .parquet, .tum" in refused.err


def test_a_report_of_scores_has_its_option(cli: Cli, tmp_path: Path) -> None:
    outcome = cli("validate", tmp_path / "none.mcap", "-o", tmp_path / "report.html")
    assert outcome.code == 2
    assert "--report FILE.html" in outcome.err
