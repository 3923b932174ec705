"""Rows of estimates and poses: the contract of their columns, and the page that explains them."""

import re
from dataclasses import replace

import numpy as np
import pytest

import svmdist
from benchmarks.generated_pages import DOCS, metrics_page
from svmdist.report.rows import (
    ESTIMATE_KEYS,
    POSE_COLUMNS,
    POSE_KEYS,
    estimate_row,
    pose_rows,
    shown_columns,
    tum_lines,
)
from svmdist.report.scores import compare_columns, score_columns
from svmdist.report.tables import keys_of, text_lines, text_width
from svmdist.report.writers import Results
from svmdist.results import AlarmState, Distance, Distances, FrameResult, ImageFindings
from svmdist.samples import Status
from svmdist.transforms import rotation_from_quaternion_xyzw, rotation_z

CONTRACT = """
recording stamp_ns status distance_m tool_x_px tool_y_px tissue_x_px tissue_y_px tool_area_px tissue_area_px
keypoint_count match_count inlier_count method equations spatial_m clearance_m distance_std_m spatial_std_m
clearance_std_m tool_x_m tool_y_m tool_z_m axis_x axis_y axis_z direction_x direction_y direction_z alarm
closing_speed_m_s time_to_contact_s instrument instrument_clearance_m instrument_clearance_std_m
instrument_direction_x instrument_direction_y instrument_direction_z detail tool_std_m axis_std_rad consistency
tool_qx tool_qy tool_qz tool_qw planar_m planar_std_m
"""
LABELS = "recording method equations reference instrument group scenario degradation against"
MEASURED = FrameResult(
    stamp_ns=1_700_000_000_500_000_000,
    status=Status.OK,
    image=ImageFindings((1.5, 2.5), (3.5, 4.5), 200, 5000, 900, 120, 100),
    distances=Distances(Distance(0.0123), clearance=Distance(0.004, 1e-3, (0.0, 0.6, 0.8), (0.0, 0.0, 0.1))),
    seconds=0.5,
)


def test_the_columns_are_those_of_the_contract():
    """In their order; a measured frame fills them in SI, and stamps keep their nanoseconds."""
    assert list(ESTIMATE_KEYS) == CONTRACT.split()
    alarmed = replace(MEASURED, alarm=AlarmState(True, 0.01, 0.4))
    row = estimate_row("a", alarmed, "overlay", "corrected")
    assert (row["stamp_ns"], row["time_s"], row["distance_m"]) == (1_700_000_000_500_000_000, 0.5, 0.004)
    assert (row["planar_m"], row["clearance_m"], row["distance_std_m"]) == (0.0123, 0.004, 1e-3)
    assert [row[key] for key in ESTIMATE_KEYS[4:13]] == [1.5, 2.5, 3.5, 4.5, 200, 5000, 900, 120, 100]
    assert [row[f"direction_{axis}"] for axis in "xyz"] == [0.0, 0.6, 0.8]
    assert (row["clearance_std_m"], row["alarm"], row["time_to_contact_s"]) == (1e-3, 1, 0.4)


def test_a_rejected_frame_has_empty_cells():
    """A frame without tissue has a status and its stamp, and nothing that was not measured."""
    row = estimate_row("a", FrameResult(5, Status.NO_TISSUE, instrument="PSM1"), "overlay", "corrected")
    filled = {"recording", "stamp_ns", "status", "method", "equations", "instrument"}
    assert {key for key in ESTIMATE_KEYS if row[key] is not None} == filled


def test_a_person_sees_what_fits():
    """Distances in mm; a narrow terminal goes without pixels first, by rank, and keeps what the method is for."""
    results = (MEASURED, replace(MEASURED, status=Status.NO_INSTRUMENT, distances=Distances()))
    rows = [estimate_row("a", result, "overlay", "corrected") for result in results]
    lines = list(text_lines(shown_columns(None), rows))
    assert lines[2].split()[:7] == ["a", "0.500", "ok", "4.00", "1.96", "–", "12.30"]
    assert lines[3].split()[:4] == ["a", "0.500", "no_instrument", "–"]
    kept = [column.key for column in shown_columns(80)]
    assert kept == ["time_s", "status", "distance_m", "distance_half_m", "spatial_m", "planar_m"]
    for planar, alarms, essential in (
        (False, True, {"status", "distance_m", "instrument", "alarm", "time_to_contact_s"}),
        (False, False, {"distance_m", "distance_half_m", "instrument"}),
        (True, False, {"status", "distance_m", "instrument"}),
    ):
        narrow = shown_columns(80, planar=planar, several=True, alarms=alarms)
        assert text_width(narrow) <= 80
        assert essential <= {column.key for column in narrow}


def test_poses_keep_every_nanosecond_and_bit():
    """Seconds with nine decimals, where a float would be rounded to 100 ns; then the numbers of the rows."""
    stamps_ns = np.array([1_700_000_000_000_000_001, 1_700_000_000_999_999_999], np.int64)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = rotation_z(np.pi / 2), (1.0, 2.0, 3.0)
    rows = list(pose_rows(stamps_ns, np.stack([T, T])))
    half = np.sqrt(0.5)
    assert list(rows[0].values()) == pytest.approx([stamps_ns[0], 1, 2, 3, 0, 0, half, half], abs=1e-15)
    for line, row in zip(tum_lines(Results(POSE_COLUMNS, rows)), rows, strict=True):
        seconds, *numbers = line.split()
        assert int(seconds.replace(".", "")) == row["stamp_ns"]
        assert [float(number) for number in numbers] == [row[key] for key in POSE_KEYS[1:]]


def test_trajectories_are_the_tools_poses(golden, cli):
    """`estimate -f tum` of a method in 3D, for one instrument; a planar method has no pose."""
    log = golden / "3d" / "contact.mcap"
    found = svmdist.estimate(svmdist.open_recording(log), "fiducial", every=4)
    rows = [row for row in found if row.measured]
    text = cli("estimate", log, "--method", "fiducial", "--every", 4, "-f", "tum").out
    poses = np.array([line.split() for line in text.splitlines()[1:]], float)
    for pose, row in zip(poses, rows, strict=True):
        np.testing.assert_allclose(pose[1:4], row.tool.pose.position_m, atol=1e-9)
        R = rotation_from_quaternion_xyzw(pose[4:])
        np.testing.assert_allclose(R, row.tool.pose.T_camera_tool[:3, :3], atol=1e-7)
    assert "in 3D" in cli("estimate", log, "--method", "overlay", "-f", "tum", "-q", code=2).line
    duo = golden / "3d" / "duo.mcap"
    assert "--instrument" in cli("estimate", duo, "--method", "fiducial", "-f", "tum", "-q", code=2).line


def test_the_page_explains_every_column_once():
    """docs/metrics.md has the columns of the tables, each with a meaning."""
    page = metrics_page((DOCS / "metrics.md").read_text("utf-8"))
    of_rows, of_scores = (
        re.findall(r"`(\w+)`", " ".join(re.findall(r"^\|(`.+?)\|", part, re.MULTILINE)))
        for part in page.split("\n## Metrics")
    )
    assert sorted(of_rows) == sorted(ESTIMATE_KEYS)
    labels = LABELS.split()
    assert sorted(of_scores) == sorted({*keys_of(score_columns()), *keys_of(compare_columns())} - {*labels})
    assert not re.findall(r"^\|`.*\|\|$", page, re.MULTILINE)
