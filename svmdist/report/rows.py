"""Rows of estimates and of poses: the one table of their columns, and trajectories as evo reads them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from svmdist.drawing import EstimateValues
from svmdist.estimation.alarms import AlarmState
from svmdist.metrics import COUNT, LENGTH, PIXELS, RADIANS, RATIO, SECONDS, SPEED, TEXT, Unit
from svmdist.report.tables import Cell, Column, Row, keys_of, row_of, text_width
from svmdist.results import FrameResult, ToolPose
from svmdist.transforms import Array, quaternion_xyzw_from_rotation


@dataclass(frozen=True)
class Estimate:
    """What columns are read from: a result of a recording."""

    recording: str
    result: FrameResult
    method: str
    equations: str
    alarm: AlarmState

    @cached_property
    def pose(self) -> ToolPose | None:
        """The tool's pose in a frame that was measured."""
        return self.result.tool.pose if self.result.tool and self.result.measured else None

    @cached_property
    def quaternion_xyzw(self) -> Array | None:
        """The tool's orientation in the camera frame."""
        return quaternion_xyzw_from_rotation(self.pose.T_camera_tool[:3, :3]) if self.pose else None


def _at(path: str) -> Callable[[Any], Cell]:
    """The getter of a path of attributes and indices: None where one of them leads nowhere."""
    steps = [int(step) if step.isdecimal() else step for step in path.split(".")]

    def read(value: Any) -> Cell:
        for step in steps:
            if value is None:
                return None
            value = value[step] if isinstance(step, int) else getattr(value, step)
        return float(value) if isinstance(value, float) else value

    return read


def _several(
    keys: str, paths: str, names: str, unit: Unit, meaning: str, given_by: str, heading: str = ""
) -> Iterator[Column]:
    """Columns that differ by a name: `{}` stands for it in keys and headings, and for its number in paths."""
    for at, name in enumerate(names.split()):
        of = _at(paths.format(at))
        yield Column(keys.format(name), unit, heading.format(name), of, meaning, given_by)


# fmt: off
ESTIMATE_COLUMNS: tuple[Column, ...] = (
    Column("recording", TEXT, "recording", None,
           "the file's name without its suffix; with as many folders as are needed to tell logs apart", "all"),
    Column("stamp_ns", Unit("ns"), "", _at("result.stamp_ns"), "stamp of the image", "all"),
    Column("time_s", Unit("s", "s", digits=3), "t [s]", lambda e: e.result.seconds, stored=False),
    Column("status", TEXT, "status", lambda e: str(e.result.status), "`ok`, or why there is no distance", "all"),
    Column("distance_m", LENGTH, "distance [mm]", _at("result.distances.planar.value_m"),
           "planar distance: tool origin to tissue origin in the camera's xy plane", "all", "planar_m"),
    *_several("tool_{}_px", "result.image.tool_px.{}", "x y", PIXELS, "the tool in the image", "all", "tool {} [px]"),
    *_several("tissue_{}_px", "result.image.tissue_px.{}", "x y", PIXELS,
              "centroid of the tissue's completed outline", "all", "tissue {} [px]"),
    Column("tool_area_px", COUNT, "tool [px²]", _at("result.image.tool_area_px"),
           "area of the segmented instrument, in pixels", "planar methods, `fused`"),
    Column("tissue_area_px", COUNT, "tissue [px²]", _at("result.image.tissue_area_px"),
           "area of the segmented tissue, in pixels", "all"),
    Column("keypoint_count", COUNT, "keypoints", _at("result.image.keypoint_count"),
           "ORB keypoints in the window around the pasted marker", "`overlay`"),
    Column("match_count", COUNT, "matches", _at("result.image.match_count"),
           "matches of these; with `fused`, measurements of the tool", "`overlay`, `fused`"),
    Column("inlier_count", COUNT, "inliers", _at("result.image.inlier_count"),
           "inliers of the homography; with `fused`, measurements that passed the gate", "`overlay`, `fused`"),
    Column("method", TEXT, "", None, "method of the estimate", "all"),
    Column("equations", TEXT, "", None, "reading of the paper's equations", "all"),
    Column("spatial_m", LENGTH, "spatial [mm]", _at("result.distances.spatial.value_m"),
           "tool origin to tissue origin in 3D", "3D", "spatial_m"),
    Column("clearance_m", LENGTH, "clearance [mm]", _at("result.distances.clearance.value_m"),
           "smallest distance between the surfaces of instrument and tissue; negative: penetration depth",
           "3D, with `[instrument]`", "clearance_m"),
    Column("distance_std_m", LENGTH, "", _at("result.distances.planar.std_m"),
           "standard deviation of `distance_m`", "3D", "planar_std_m"),
    Column("spatial_std_m", LENGTH, "", _at("result.distances.spatial.std_m"),
           "standard deviation of `spatial_m`", "3D", "spatial_std_m"),
    Column("clearance_std_m", LENGTH, "± [mm]", _at("result.distances.clearance.std_m"),
           "standard deviation of `clearance_m`; ±1.96 of it is the 95 % interval", "3D", "clearance_std_m"),
    *_several("tool_{}_m", "pose.position_m.{}", "x y z", LENGTH, "the tool's origin in the camera frame", "3D"),
    *_several("axis_{}", "pose.axis.{}", "x y z", RATIO,
              "unit vector along the shaft towards the tip, in the camera frame", "3D"),
    *_several("direction_{}", "result.distances.clearance.direction.{}", "x y z", RATIO,
              "unit vector of the shortest separation from instrument to tissue, in the camera frame",
              "with `clearance_m`"),
    Column("alarm", COUNT, "alarm", lambda e: None if e.alarm.alarm is None else int(e.alarm.alarm),
           "1 or 0; empty without a clearance, which does not mean that the frame is safe", "`--alarm-below`"),
    Column("closing_speed_m_s", SPEED, "closing [mm/s]", _at("alarm.closing_speed_m_s"),
           "speed at which the clearance shrinks, over the last 0.5 s; negative where it grows", "`--alarm-below`",
           "closing_speed_m_s"),
    Column("time_to_contact_s", SECONDS, "contact [s]", _at("alarm.time_to_contact_s"),
           "clearance over closing speed; empty below 1 mm/s", "`--alarm-below`", "time_to_contact_s"),
    Column("instrument", TEXT, "instrument", _at("result.instrument"), "the instrument", "all", width=10),
    Column("instrument_clearance_m", LENGTH, "to other [mm]", _at("result.distances.to_instrument.value_m"),
           "smallest distance from the surface of another instrument", "3D, two instruments", "to_instrument_m"),
    Column("instrument_clearance_std_m", LENGTH, "± [mm]", _at("result.distances.to_instrument.std_m"),
           "its standard deviation", "3D, two instruments", "to_instrument_std_m"),
    *_several("instrument_direction_{}", "result.distances.to_instrument.direction.{}", "x y z", RATIO,
              "its direction towards the other instrument, in the camera frame", "3D, two instruments"),
    Column("detail", TEXT, "", lambda e: e.result.detail or None,
           "more about the frame: why it was rejected, which measurements were outliers", "all"),
    Column("tool_std_m", LENGTH, "", _at("pose.position_std_m"),
           "standard deviation of the tool's position along its most uncertain direction", "3D"),
    Column("axis_std_rad", RADIANS, "", _at("pose.shaft_std_rad"),
           "standard deviation of the shaft's direction about the worse of two axes across it", "3D"),
    Column("consistency", RATIO, "", _at("result.consistency"),
           "normalised innovations squared, averaged over 1.5 s; 1 or less is as expected", "`fused`", "consistency"),
    *(Column(f"tool_q{axis}", RATIO, "", _at(f"quaternion_xyzw.{at}"), stored=False) for at, axis in enumerate("xyzw")),
)
"""The contract: columns may be added at the end, none is renamed or removed."""
# fmt: on
ESTIMATE_KEYS = keys_of(ESTIMATE_COLUMNS)

SHOWN = (
    *("recording", "time_s", "status", "distance_m", "spatial_m", "clearance_m", "clearance_std_m"),
    *("tool_x_px", "tool_y_px", "tissue_x_px", "tissue_y_px", "tool_area_px", "tissue_area_px"),
    *("keypoint_count", "match_count", "inlier_count"),
)
"""The columns for a person, in their order."""
OF_SEVERAL = ("instrument", "instrument_clearance_m", "instrument_clearance_std_m")
"""Shown too where a log has several instruments."""
OF_ALARMS = ("alarm", "closing_speed_m_s", "time_to_contact_s")
"""Shown too where alarms are asked for."""
DISPENSABLE = (
    *("keypoint_count", "match_count", "inlier_count", "tool_area_px", "tissue_area_px"),
    *("tissue_x_px", "tissue_y_px", "tool_x_px", "tool_y_px", "recording", "instrument_clearance_std_m"),
)
"""Columns that a narrow terminal leaves out, in this order; then come those of the other kind of method."""
DISPENSABLE_IN_3D = (
    *("distance_m", "spatial_m", "closing_speed_m_s", "instrument_clearance_m", "clearance_std_m"),
)
DISPENSABLE_IN_THE_PLANE = ("instrument_clearance_m", "clearance_std_m", "clearance_m", "spatial_m")


def shown_columns(
    width: int | None, *, planar: bool = False, several: bool = False, alarms: bool = False
) -> Sequence[Column]:
    """The columns for a person that fit a terminal of `width` characters; all for None."""
    by_key = {column.key: column for column in ESTIMATE_COLUMNS}
    keys = (*SHOWN, *(OF_SEVERAL if several else ()), *(OF_ALARMS if alarms else ()))
    columns = [by_key[key] for key in keys]
    for key in (*DISPENSABLE, *(DISPENSABLE_IN_THE_PLANE if planar else DISPENSABLE_IN_3D)):
        if width is None or text_width(columns) <= width:
            break
        columns = [column for column in columns if column.key != key]
    return columns


def estimate_row(
    recording: str, result: FrameResult, method: str, equations: str, alarm: AlarmState | None = None
) -> Row:
    """The row of a result."""
    estimate = Estimate(recording, result, method, equations, alarm or AlarmState())
    return row_of(ESTIMATE_COLUMNS, estimate)


def estimate_values(
    result: FrameResult, method: str, bounds_m: tuple[float, float] | None, alarm: AlarmState | None = None
) -> EstimateValues:
    """A result as the numbers of `svmdist.DistanceEstimate`, with the bounds of the clearance's 95 % interval."""
    estimate = Estimate("", result, method, "", alarm or AlarmState())
    numbers = {column.field: column.value(estimate) for column in ESTIMATE_COLUMNS if column.field}
    numbers["clearance_low_m"], numbers["clearance_high_m"] = bounds_m or (None, None)
    status, raised = str(result.status), estimate.alarm.alarm
    return EstimateValues(result.instrument, method, status, result.detail, numbers, raised)  # type: ignore[arg-type]


POSE_COLUMNS: tuple[Column, ...] = (
    Column("stamp_ns", Unit("ns")),
    *(Column(f"{axis}_m", LENGTH) for axis in "xyz"),
    *(Column(f"q{axis}", RATIO) for axis in "xyzw"),
)
POSE_KEYS = keys_of(POSE_COLUMNS)


def pose_rows(stamps_ns: NDArray[np.int64], poses: Array) -> Iterator[dict[str, Cell]]:
    """The rows of some poses, shape (n, 4, 4), at their stamps, shape (n,)."""
    numbers = np.hstack([poses[:, :3, 3], quaternion_xyzw_from_rotation(poses[:, :3, :3])])
    for stamp_ns, values in zip(stamps_ns.tolist(), numbers.tolist(), strict=True):
        yield dict(zip(POSE_KEYS, (stamp_ns, *values), strict=True))


def tum_lines(keys: Sequence[str], rows: Iterable[Row]) -> Iterator[str]:
    """A trajectory as evo reads it, a line per row with a pose: `timestamp x y z qx qy qz qw`.

    Time is in s with all nine decimals. Of estimates, these are the tool's poses in the camera frame.
    """
    of_tool = "tool_x_m" in keys
    if of_tool:
        yield "# timestamp tx ty tz qx qy qz qw\n"
    for row in rows:
        numbers = [row.get(f"tool_{key}" if of_tool else key) for key in POSE_KEYS[1:]]
        if all(isinstance(number, float) for number in numbers):
            seconds, nanoseconds = divmod(int(row["stamp_ns"] or 0), 1_000_000_000)
            yield f"{seconds}.{nanoseconds:09d} {' '.join(f'{number:.17g}' for number in numbers)}\n"
