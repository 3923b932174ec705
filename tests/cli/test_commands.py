"""What the commands print, where, and in which form."""

from __future__ import annotations

import csv
import io
import json
import subprocess
import sys
from pathlib import Path

import pytest

from svmdist.report.rows import ESTIMATE_KEYS
from tests.cli.conftest import Cli
from tests.synthetic import write_log

CONTRACT = (
    "recording,stamp_ns,status,distance_m,tool_x_px,tool_y_px,tissue_x_px,tissue_y_px,"
    "tool_area_px,tissue_area_px,keypoint_count,match_count,inlier_count"
)


def test_estimate_csv_keeps_the_contract(cli: Cli, synthetic_log: Path, synthetic_calibration: Path) -> None:
    """The columns begin with the documented ones in their order; every frame has a row; stdout holds data only."""
    outcome = cli("estimate", synthetic_log, "--calibration", synthetic_calibration, "-f", "csv")
    rows = list(csv.DictReader(io.StringIO(outcome.out)))
    assert outcome.code == 0
    assert outcome.out.startswith(CONTRACT)
    assert len(rows) == 40
    assert {row["recording"] for row in rows} == {"synthetic"}
    assert all(float(row["distance_m"]) > 0 for row in rows if row["status"] == "ok")
    assert all(row["distance_m"] == "" for row in rows if row["status"] != "ok")


def test_estimate_forms_agree(
    cli: Cli, tmp_path: Path, synthetic_log: Path, synthetic_calibration: Path
) -> None:
    """CSV, JSON, JSON lines and a file written by -o hold the same values."""
    common = ("estimate", synthetic_log, "--calibration", synthetic_calibration)
    from_csv = list(csv.DictReader(io.StringIO(cli(*common, "-f", "csv").out)))
    from_json = json.loads(cli(*common, "-f", "json").out)
    from_lines = [json.loads(line) for line in cli(*common, "-f", "jsonl").out.splitlines()]
    written = cli(*common, "-f", "jsonl", "-o", tmp_path / "rows.jsonl")
    assert written.out == ""
    assert (
        from_json
        == from_lines
        == [json.loads(line) for line in (tmp_path / "rows.jsonl").read_text().splitlines()]
    )
    assert [tuple(row) for row in from_json] == [ESTIMATE_KEYS] * 40
    for text, value in zip(from_csv, from_json, strict=True):
        assert {key: "" if item is None else str(item) for key, item in value.items()} == text


def test_printed_equations_warn(cli: Cli, synthetic_log: Path) -> None:
    """The printed reading runs, says where it degenerates, and is stored with the rows."""
    outcome = cli("estimate", synthetic_log, "--equations", "printed", "-f", "json")
    assert outcome.code == 0
    assert {row["equations"] for row in json.loads(outcome.out)} == {"printed"}
    assert "eqs. (3), (4) as printed" in outcome.err


def test_calibrate_writes_its_sources(cli: Cli, tmp_path: Path, synthetic_log: Path) -> None:
    """The file names method, camera and the hash of its source; it is not replaced without --force."""
    import hashlib
    import tomllib

    output = tmp_path / "mine.toml"
    first = cli("calibrate", synthetic_log, "-o", output)
    stored = tomllib.loads(output.read_text())
    assert first.code == 0
    assert "residual RMSE" in first.err
    assert stored["method"] == "overlay"
    assert stored["camera"]["width_px"] == 640
    assert stored["sources"][0]["sha256"] == hashlib.sha256(synthetic_log.read_bytes()).hexdigest()
    again = cli("calibrate", synthetic_log, "-o", output)
    assert again.code == 2
    assert "--force" in again.err
    assert cli("calibrate", synthetic_log, "-o", output, "--force").code == 0


def test_validate_document(cli: Cli, synthetic_log: Path, synthetic_calibration: Path) -> None:
    """The JSON document has its schema, a score per reference, and leaves what it was fitted on out of overall."""
    outcome = cli("validate", synthetic_log, "--calibration", synthetic_calibration, "-f", "json")
    document = json.loads(outcome.out)
    assert document["schema"] == "svmdist.validation/1"
    assert [score["reference"] for score in document["recordings"]] == ["ground_truth", "kinematics"]
    for score in document["recordings"]:
        assert score["fitted_on"]
        assert score["sample_count"] + score["unpaired_count"] + score["rejected_count"] == 40
        assert score["r_squared"] > 0.999
        assert score["rmse_m"] < 2e-4
        assert score["rmse_low_m"] <= score["rmse_m"] <= score["rmse_high_m"] * 1.05
    assert document["overall"] is None
    assert document["paper"]["r_squared"] == 0.78


def test_baseline_catches_a_regression(
    cli: Cli, tmp_path: Path, synthetic_log: Path, synthetic_calibration: Path
) -> None:
    """A stored baseline passes on the same figures, and exits with 4 when one got worse."""
    baseline = tmp_path / "baseline.json"
    common = ("validate", synthetic_log, "--calibration", synthetic_calibration)
    assert cli(*common, "--write-baseline", baseline).code == 0
    assert cli(*common, "--baseline", baseline).code == 0
    stored = json.loads(baseline.read_text())
    stored["scores"][0]["rmse_m"] *= 0.5
    baseline.write_text(json.dumps(stored))
    worse = cli(*common, "--baseline", baseline)
    assert worse.code == 4
    assert "rmse_m was" in worse.err
    assert "synthetic against ground_truth" in worse.err


def test_baseline_of_other_logs_does_not_pass(
    cli: Cli, tmp_path: Path, synthetic_log: Path, synthetic_calibration: Path
) -> None:
    """A baseline that holds nothing to compare is an error, for a check that checks nothing must not pass."""
    baseline = tmp_path / "baseline.json"
    common = ("validate", synthetic_log, "--calibration", synthetic_calibration)
    cli(*common, "--write-baseline", baseline)
    assert cli(*common, "--method", "centroid", "--baseline", baseline).code == 1


@pytest.mark.parametrize("suffix", ["png", "svg", "pdf"])
def test_save_plot(
    cli: Cli, tmp_path: Path, synthetic_log: Path, synthetic_calibration: Path, suffix: str
) -> None:
    """The figure is written in the form of its suffix."""
    figure = tmp_path / f"figure.{suffix}"
    outcome = cli("validate", synthetic_log, "--calibration", synthetic_calibration, "--save-plot", figure)
    assert outcome.code == 0
    assert figure.stat().st_size > 5000


def test_blur_bench_rows(cli: Cli, tmp_path: Path, synthetic_calibration: Path) -> None:
    """Every blur of Table I has a row, with a clean one, and the kernels are those asked for."""
    outcome = cli(
        "blur-bench",
        write_log(tmp_path / "short.mcap", frame_count=10),
        "--calibration",
        synthetic_calibration,
        "-f",
        "json",
        "--kernel",
        "gaussian=7",
    )
    rows = {row["blur"]: row for row in json.loads(outcome.out)}
    assert list(rows) == ["none", "erosion", "dilation", "gaussian", "median", "bilateral"]
    assert rows["gaussian"]["kernel_px"] == 7
    assert rows["none"]["paper_keypoint_count"] is None
    assert rows["erosion"]["paper_contour_area_px"] == 221
    # The disc is darker than the ground: eroding the image takes the darker neighbour and makes it grow.
    assert (
        rows["dilation"]["contour_area_px"]
        < rows["none"]["contour_area_px"]
        < rows["erosion"]["contour_area_px"]
    )
    for row in rows.values():
        assert row["marker_keypoint_count"] > 20 * row["keypoint_count"]
        assert row["inlier_count"] <= row["match_count"]
        assert row["rmse_m"] < 5e-4


def test_help_loads_nothing_heavy() -> None:
    """`svmdist --help` imports neither OpenCV, PyBullet, NumPy, mcap nor matplotlib."""
    code = (
        "import sys; sys.argv = ['svmdist', '--help']\n"
        "from svmdist.cli.main import run\n"
        "try: run()\n"
        "except SystemExit: pass\n"
        "heavy = {'cv2', 'pybullet', 'numpy', 'mcap', 'matplotlib', 'pydantic'} & set(sys.modules)\n"
        "print(sorted(heavy), file=sys.stderr)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stderr.strip() == "[]"
    assert "blur-bench" in done.stdout


def test_version(cli: Cli) -> None:
    """`--version` prints name and version."""
    assert cli("--version").out.startswith("svmdist 0.")
