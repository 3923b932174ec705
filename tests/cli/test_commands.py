"""What the commands print, where and in which form, and what they load for it."""

import hashlib
import json
import os
import shlex
import shutil
import subprocess
import sys
import tomllib

import pytest

from svmdist.profile import load_profile
from svmdist.recording.log import open_recording
from svmdist.report.rows import ESTIMATE_KEYS
from svmdist.report.scores import score_columns
from svmdist.report.tables import keys_of
from tests.conftest import ended
from tests.shipped import write_profile
from tests.synthetic import write_log

Arguments = tuple[object, ...]


def test_all_forms_of_rows_agree(cli, tmp_path, calibrated):
    """A row for each frame; the ending chooses the form as -f does; stdout holds data only, or nothing; - is stdout."""
    made = cli("estimate", *calibrated, "-f", "csv")
    rows = cli("estimate", *calibrated, "-f", "json").json
    assert tuple(made.rows[0]) == ESTIMATE_KEYS
    assert [tuple(row) for row in rows] == [ESTIMATE_KEYS] * 40
    assert {row["recording"] for row in rows} == {"synthetic"}
    assert all(row["distance_m"] > 0 if row["status"] == "ok" else row["distance_m"] is None for row in rows)
    assert made.rows == [{key: "" if v is None else str(v) for key, v in row.items()} for row in rows]
    lines = cli("estimate", *calibrated, "-f", "jsonl").out.splitlines()
    assert [json.loads(line) for line in lines] == rows
    for form in ("csv", "json", "jsonl"):
        path = tmp_path / f"out.{form}"
        assert cli("estimate", *calibrated, "-o", path).out == ""
        assert path.read_text() == cli("estimate", *calibrated, "-f", form, "-o", "-").out


def test_estimate_ends_with_a_command_that_shows_the_smallest_clearance(cli, golden, tmp_path, monkeypatch):
    """Which runs as it is printed; where nothing is measured, one that shows what was segmented."""
    monkeypatch.chdir(tmp_path)
    last = cli("estimate", golden / "3d" / "duo.mcap", "--every", "40").err.splitlines()[-1]
    said, _, command = last.partition(": svmdist ")
    assert "smallest clearance" in said
    assert cli(*shlex.split(command)).out.strip().endswith(".png")
    log, blind = golden / "3d" / "contact.mcap", (r"(?m)^value = .*$", "value = [254, 255]")
    profile = write_profile(tmp_path / "blind.toml", blind)
    none = cli("estimate", log, "--method", "shaft", "--profile", profile, "--every", 8, code=1)
    assert f"svmdist show {log} --masks --profile" in none.err


def test_help_of_a_command_by_its_name(cli):
    assert cli("help", "profile", "new").out == cli("profile", "new", "--help").out
    assert cli("help").out == cli("--help").out


def test_an_annotated_recording_is_replaced_only_by_force(cli, tmp_path, synthetic_log):
    output = tmp_path / "out.mcap"
    cli("estimate", synthetic_log, "-o", output)
    topics = {info.topic: info.message_count for info in open_recording(output, load_profile()).topics()}
    assert topics["/ECM/left/image/annotations"] == topics["/ECM/left/image"]
    assert "--force" in cli("estimate", synthetic_log, "-o", output, code=2).err
    cli("estimate", synthetic_log, "-o", output, "--force")


def test_printed_equations_warn(cli, synthetic_log):
    """The printed reading runs, says where it degenerates, and is stored with the rows."""
    outcome = cli("estimate", synthetic_log, "--equations", "printed", "-f", "json")
    assert {row["equations"] for row in outcome.json} == {"printed"}
    assert "eqs. (3), (4) as printed" in outcome.err


def test_calibrate_writes_its_sources(cli, tmp_path, synthetic_log):
    """The file names method, camera and the hash of its source; it is not replaced without --force."""
    output = tmp_path / "mine.toml"
    assert "residual RMSE" in cli("calibrate", synthetic_log, "-o", output).err
    stored = tomllib.loads(output.read_text())
    assert (stored["method"], stored["camera"]["width_px"]) == ("overlay", 640)
    assert stored["sources"][0]["sha256"] == hashlib.sha256(synthetic_log.read_bytes()).hexdigest()
    assert "--force" in cli("calibrate", synthetic_log, "-o", output, code=2).err
    cli("calibrate", synthetic_log, "-o", output, "--force")


def test_validate_document(cli, calibrated):
    """The JSON document has its schema, a score per reference, and leaves what it was fitted on out of overall."""
    document = cli("validate", *calibrated, "-f", "json").json
    assert document["schema"] == "svmdist.validation/1"
    assert [score["reference"] for score in document["recordings"]] == ["ground_truth", "kinematics"]
    for score in document["recordings"]:
        assert set(score) == {*keys_of(score_columns())}
        assert score["fitted_on"]
        assert score["sample_count"] + score["unpaired_count"] + score["rejected_count"] == 40
        assert score["r_squared"] > 0.999
        assert score["rmse_m"] < 2e-4
        assert score["rmse_low_m"] <= score["rmse_m"] <= score["rmse_high_m"] * 1.05
    assert document["overall"] is None
    assert document["paper"]["r_squared"] == 0.78


def test_a_baseline_catches_a_regression(cli, tmp_path, calibrated):
    """It passes on the same figures, and exits with 4 where one got worse; with nothing to compare it is an error."""
    baseline = tmp_path / "baseline.json"
    cli("validate", *calibrated, "--write-baseline", baseline)
    cli("validate", *calibrated, "--baseline", baseline)
    cli("validate", *calibrated, "--method", "centroid", "--baseline", baseline, code=1)
    stored = json.loads(baseline.read_text())
    stored["scores"][0]["rmse_m"] *= 0.5
    baseline.write_text(json.dumps(stored))
    worse = cli("validate", *calibrated, "--baseline", baseline, code=4)
    assert "rmse_m was" in worse.err
    assert "synthetic against ground_truth" in worse.err


def test_blur_bench_rows(cli, tmp_path, synthetic_calibration):
    """Every blur of Table I has a row, with a clean one, and the kernels are those asked for."""
    log = write_log(tmp_path / "short.mcap", frame_count=10)
    options = ("--calibration", synthetic_calibration, "-f", "json", "--kernel", "gaussian=7")
    rows = {row["blur"]: row for row in cli("blur-bench", log, *options).json}
    assert list(rows) == ["none", "erosion", "dilation", "gaussian", "median", "bilateral"]
    assert rows["gaussian"]["kernel_px"] == 7
    assert rows["none"]["paper_keypoint_count"] is None
    assert rows["erosion"]["paper_contour_area_px"] == 221
    # The disc is darker than the ground: eroding the image takes the darker neighbour and makes it grow.
    dilated, clean, eroded = (rows[name]["contour_area_px"] for name in ("dilation", "none", "erosion"))
    assert dilated < clean < eroded
    for row in rows.values():
        assert row["marker_keypoint_count"] > 20 * row["keypoint_count"]
        assert row["inlier_count"] <= row["match_count"]
        assert row["rmse_m"] < 5e-4


def test_version(cli):
    assert cli("--version").out.startswith("svmdist 0.")


HEAVY = ("cv2", "numpy", "mcap", "pydantic", "rich", "matplotlib", "pybullet", "sqlite3", "yaml")
SAY_LOADED = """
import sys
sys.argv = ["svmdist", *sys.argv[1:]]
from svmdist.__main__ import run
try:
    run()
except SystemExit:
    pass
sys.stderr.write("loaded: " + " ".join(sys.modules))
"""


@pytest.mark.parametrize(
    ("arguments", "needed"),
    [("--help", 0), *((f"estimate LOG -f {form}", 4) for form in ("table", "csv", "json"))],
)
def test_a_command_loads_what_it_uses_and_no_more(tmp_path, arguments, needed):
    """Importing is most of what a short log costs; rows are written as they come, and the log is MCAP with zstd."""
    log = write_log(tmp_path / "a.mcap", frame_count=1)
    command = [sys.executable, "-c", SAY_LOADED, *arguments.replace("LOG", str(log)).split()]
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert not set(HEAVY[needed:]) & set(done.stderr.splitlines()[-1].split())
    assert done.stdout


def test_a_closed_pipe_is_quiet(synthetic_log):
    """`svmdist estimate … | head -1` ends without a complaint."""
    estimate = f"{sys.executable} -m svmdist estimate {synthetic_log} -f csv"
    command = f"{estimate} | head -1; echo ${{PIPESTATUS[0]}}"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, check=False)
    assert done.stdout.splitlines() == [",".join(ESTIMATE_KEYS), "0"]
    assert done.stderr == ""


@pytest.mark.skipif(shutil.which("bash") is None, reason="there is no bash")
def test_a_shell_completes_with_the_script_that_is_shown(tmp_path):
    """bash reads the script, and its function asks a command of that name."""
    command = tmp_path / "svmdist"
    command.write_text(f'#!/bin/sh\nexec "{sys.executable}" -m svmdist "$@"\n')
    command.chmod(0o755)
    # Take the shell that is named: among the parents of a test there may be none to detect.
    named = {"_TYPER_COMPLETE_TEST_DISABLE_SHELL_DETECTION": "1"}
    script = str(ended("--show-completion", "bash", environment=named).stdout)
    assert "_svmdist_completion" in script
    ask = "\nCOMP_WORDS=(svmdist hand); COMP_CWORD=1; _svmdist_completion svmdist; echo ${COMPREPLY[@]}\n"
    there = {**os.environ, "PATH": f"{tmp_path}{os.pathsep}{os.environ['PATH']}"}
    bash = ["bash", "-c", script + ask]
    done = subprocess.run(bash, env=there, capture_output=True, text=True, check=False)
    assert done.stdout.split() == ["hand-eye"], done.stderr
