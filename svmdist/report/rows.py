"""Estimates and poses as rows: their columns, for machines in SI and for a person in mm."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from numpy.typing import NDArray

from svmdist.estimation.alarms import AlarmState
from svmdist.report.tables import Cell, Column, Row, number, text_width
from svmdist.results import FrameResult, as_vector
from svmdist.samples import Vector
from svmdist.transforms import Array, quaternion_xyzw_from_rotation
from svmdist.workflows.fk import ForwardKinematics

ESTIMATE_KEYS = (
    "recording",
    "stamp_ns",
    "status",
    "distance_m",
    "tool_x_px",
    "tool_y_px",
    "tissue_x_px",
    "tissue_y_px",
    "tool_area_px",
    "tissue_area_px",
    "keypoint_count",
    "match_count",
    "inlier_count",
    "method",
    "equations",
    "spatial_m",
    "clearance_m",
    "distance_std_m",
    "spatial_std_m",
    "clearance_std_m",
    "tool_x_m",
    "tool_y_m",
    "tool_z_m",
    "axis_x",
    "axis_y",
    "axis_z",
    "direction_x",
    "direction_y",
    "direction_z",
    "alarm",
    "closing_speed_m_s",
    "time_to_contact_s",
    "instrument",
    "instrument_clearance_m",
    "instrument_clearance_std_m",
    "instrument_direction_x",
    "instrument_direction_y",
    "instrument_direction_z",
    "detail",
    "tool_std_m",
    "axis_std_rad",
    "consistency",
)
"""The contract: columns may be added at the end, none is renamed or removed."""

_TEXT = frozenset({"recording", "status", "method", "equations", "instrument", "detail"})
_WHOLE = frozenset(
    ("stamp_ns", "alarm", "tool_area_px", "tissue_area_px", "keypoint_count", "match_count", "inlier_count")
)
ESTIMATE_TYPES = {
    key: "string" if key in _TEXT else "int64" if key in _WHOLE else "float64" for key in ESTIMATE_KEYS
}
"""The types of the columns in Parquet."""

QUATERNION_KEYS = ("tool_qx", "tool_qy", "tool_qz", "tool_qw")

ALARM_COLUMNS = (
    Column("alarm", "alarm", number(0)),
    Column("closing_speed_m_s", "closing [mm/s]", number(1, 1e3)),
    Column("time_to_contact_s", "contact [s]", number(2)),
)
"""Shown where alarms are asked for."""

INSTRUMENT_COLUMNS = (
    Column("instrument", "instrument", is_text=True, min_width=10),
    Column("instrument_clearance_m", "to other [mm]", number(2, 1e3)),
    Column("instrument_clearance_std_m", "± [mm]", number(2, 1e3)),
)
"""Shown to a person where a log has several instruments."""

ESTIMATE_COLUMNS = (
    Column("recording", "recording", is_text=True),
    Column("time_s", "t [s]", number(3)),
    Column("status", "status", is_text=True),
    Column("distance_m", "distance [mm]", number(2, 1e3)),
    Column("spatial_m", "spatial [mm]", number(2, 1e3)),
    Column("clearance_m", "clearance [mm]", number(2, 1e3)),
    Column("clearance_std_m", "± [mm]", number(2, 1e3)),
    Column("tool_x_px", "tool x [px]", number(1)),
    Column("tool_y_px", "tool y [px]", number(1)),
    Column("tissue_x_px", "tissue x [px]", number(1)),
    Column("tissue_y_px", "tissue y [px]", number(1)),
    Column("tool_area_px", "tool [px²]", number(0)),
    Column("tissue_area_px", "tissue [px²]", number(0)),
    Column("keypoint_count", "keypoints", number(0)),
    Column("match_count", "matches", number(0)),
    Column("inlier_count", "inliers", number(0)),
)

DISPENSABLE = (
    *("keypoint_count", "match_count", "inlier_count", "tool_area_px", "tissue_area_px"),
    *("tissue_x_px", "tissue_y_px", "tool_x_px", "tool_y_px", "recording"),
)
"""Columns that a narrow terminal leaves out, in this order. CSV and JSON have all columns."""

DISPENSABLE_IN_3D = (
    *("instrument_clearance_std_m", "distance_m", "spatial_m"),
    *("closing_speed_m_s", "instrument_clearance_m", "clearance_std_m"),
)
DISPENSABLE_IN_THE_PLANE = (
    *("instrument_clearance_std_m", "instrument_clearance_m"),
    *("clearance_std_m", "clearance_m", "spatial_m"),
)
"""Columns that are left out next, by method: a planar method has no values in the columns of the 3D methods."""


def columns_within(columns: Sequence[Column], width: int | None, planar: bool = False) -> Sequence[Column]:
    """The columns that fit a terminal of `width` characters, without those that are dispensable; all for None."""
    for key in (*DISPENSABLE, *(DISPENSABLE_IN_THE_PLANE if planar else DISPENSABLE_IN_3D)):
        if width is None or text_width(columns) <= width:
            break
        columns = [column for column in columns if column.key != key]
    return columns


def estimate_row(
    recording: str,
    estimate: FrameResult,
    method: str,
    equations: str,
    alarm: AlarmState | None = None,
) -> Row:
    """One row; `time_s` counts from the recording's first image and is for tables only."""
    alarm = alarm or AlarmState()
    return {
        **_fields(estimate),
        **_quaternion(estimate),
        "recording": recording,
        "method": method,
        "equations": equations,
        "time_s": estimate.seconds,
        "alarm": None if alarm.alarm is None else int(alarm.alarm),
        "closing_speed_m_s": alarm.closing_speed_m_s,
        "time_to_contact_s": alarm.time_to_contact_s,
    }


def tool_pose_lines(rows: Iterable[Row]) -> Iterator[str]:
    """The tool's poses in the camera frame as TUM trajectories have them, for evo: a line per measured frame."""
    yield "# timestamp tx ty tz qx qy qz qw\n"
    keys = ("tool_x_m", "tool_y_m", "tool_z_m", *QUATERNION_KEYS)
    for row in rows:
        numbers = [row.get(key) for key in keys]
        if all(isinstance(number, float) for number in numbers):
            seconds, nanoseconds = divmod(int(row["stamp_ns"] or 0), 1_000_000_000)
            yield f"{seconds}.{nanoseconds:09d} " + " ".join(f"{number:.9f}" for number in numbers) + "\n"


def _quaternion(result: FrameResult) -> dict[str, Cell]:
    """The tool's orientation, for trajectories; no columns of the tables."""
    if result.tool is None or not result.measured:
        return {}
    xyzw = quaternion_xyzw_from_rotation(result.tool.pose.T_camera_tool[:3, :3]).tolist()
    return dict(zip(QUATERNION_KEYS, xyzw, strict=True))


def _fields(result: FrameResult) -> dict[str, Cell]:
    """What a result holds, by columns: the one place that flattens it."""
    image, distances = result.image, result.distances
    pose = result.tool.pose if result.tool and result.measured else None
    row: dict[str, Cell] = {
        "stamp_ns": result.stamp_ns,
        "status": str(result.status),
        "detail": result.detail or None,
        "instrument": result.instrument,
        "tool_std_m": pose.position_std_m if pose else None,
        "axis_std_rad": pose.shaft_std_rad if pose else None,
        "consistency": result.consistency,
        "tool_area_px": image.tool_area_px,
        "tissue_area_px": image.tissue_area_px,
        "keypoint_count": image.keypoint_count,
        "match_count": image.match_count,
        "inlier_count": image.inlier_count,
        **_xyz("tool_{}_m", as_vector(pose.position_m) if pose else None),
        **_xyz("axis_{}", as_vector(pose.axis) if pose else None),
        **_xyz("direction_{}", distances.clearance.direction if distances.clearance else None),
    }
    row["tool_x_px"], row["tool_y_px"] = image.tool_px or (None, None)
    row["tissue_x_px"], row["tissue_y_px"] = image.tissue_px or (None, None)
    to_other = distances.to_instrument
    row |= _xyz("instrument_direction_{}", to_other.direction if to_other else None)
    for name, distance in (
        ("distance", distances.planar),
        ("spatial", distances.spatial),
        ("clearance", distances.clearance),
        ("instrument_clearance", to_other),
    ):
        row[f"{name}_m"] = distance.value_m if distance else None
        row[f"{name}_std_m"] = distance.std_m if distance else None
    return row


def _xyz(key: str, vector: Vector | None) -> dict[str, Cell]:
    """Three columns of a vector; None where there is none."""
    x, y, z = vector or (None, None, None)
    return {key.format("x"): x, key.format("y"): y, key.format("z"): z}


BLOCK = 1 << 14
POSE_KEYS = ("stamp_ns", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")


def pose_rows(result: ForwardKinematics) -> Iterator[dict[str, Cell]]:
    """One row a joint state, with the keys of `POSE_KEYS`."""
    for at in range(0, len(result.stamps_ns), BLOCK):
        yield from block_rows(result.stamps_ns[at : at + BLOCK], result.poses[at : at + BLOCK])


def block_rows(stamps_ns: NDArray[np.int64], poses: Array) -> Iterator[dict[str, Cell]]:
    """The rows of some poses, shape (n, 4, 4), at their stamps, shape (n,)."""
    quaternions_xyzw = quaternion_xyzw_from_rotation(poses[:, :3, :3])
    for stamp_ns, T, q in zip(stamps_ns, poses, quaternions_xyzw, strict=True):
        values = (int(stamp_ns), *(float(v) for v in T[:3, 3]), *(float(v) for v in q))
        yield dict(zip(POSE_KEYS, values, strict=True))


def tum_lines(rows: Iterable[Row]) -> Iterator[str]:
    """One line a joint state: `timestamp x y z qx qy qz qw`, time in s with all nine decimals."""
    for row in rows:
        seconds, nanoseconds = divmod(int(row["stamp_ns"] or 0), 1_000_000_000)
        numbers = " ".join(f"{row[key]:.17g}" for key in POSE_KEYS[1:])
        yield f"{seconds}.{nanoseconds:09d} {numbers}\n"
