"""Rows of estimates, of poses and of a surface's points: their columns, and the files that evo and viewers read."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from svmdist.files import atomic_file
from svmdist.metrics import COUNT, LENGTH, PIXELS, RADIANS, RATIO, SECONDS, SPEED, TEXT, Column, Unit, row_of
from svmdist.report.tables import Row, keys_of, text_width
from svmdist.report.writers import Results
from svmdist.results import FrameResult, ToolPose
from svmdist.transforms import Array, quaternion_xyzw_from_rotation

if TYPE_CHECKING:
    from svmdist.workflows.check import TissueSurface


@dataclass(frozen=True)
class _Estimate:
    """What columns are read from: a result of a recording."""

    recording: str
    result: FrameResult
    method: str
    equations: str = ""

    @property
    def pose(self) -> ToolPose | None:
        return self.result.tool.pose if self.result.tool and self.result.measured else None

    @cached_property
    def quaternion_xyzw(self) -> Array | None:
        return quaternion_xyzw_from_rotation(self.pose.T_camera_tool[:3, :3]) if self.pose else None


def _several(keys: str, paths: str, names: str, unit: Unit, heading: str = "") -> Iterator[Column]:
    """Columns that differ by a name: `{}` is the name in keys and headings, its number in paths."""
    for at, name in enumerate(names.split()):
        yield Column(keys.format(name), unit, heading.format(name), paths.format(at))


# fmt: off
ESTIMATE_COLUMNS: tuple[Column, ...] = (
    Column("recording", TEXT, "recording"),
    Column("stamp_ns", Unit("ns"), "", "result.stamp_ns"),
    Column("time_s", Unit("s", digits=3), "t [s]", "result.seconds", stored=False),
    Column("status", TEXT, "status", lambda e: str(e.result.status), field="status"),
    Column("distance_m", LENGTH, "distance [mm]", "result.distances.main.value_m"),
    *_several("tool_{}_px", "result.image.tool_px.{}", "x y", PIXELS, "tool {} [px]"),
    *_several("tissue_{}_px", "result.image.tissue_px.{}", "x y", PIXELS, "tissue {} [px]"),
    Column("tool_area_px", COUNT, "tool [px²]", "result.image.tool_area_px"),
    Column("tissue_area_px", COUNT, "tissue [px²]", "result.image.tissue_area_px"),
    Column("keypoint_count", COUNT, "keypoints", "result.image.keypoint_count"),
    Column("match_count", COUNT, "matches", "result.image.match_count"),
    Column("inlier_count", COUNT, "inliers", "result.image.inlier_count"),
    Column("method", TEXT, field="method"),
    Column("equations", TEXT),
    Column("spatial_m", LENGTH, "spatial [mm]", "result.distances.spatial.value_m", field="spatial_m"),
    Column("clearance_m", LENGTH, "clearance [mm]", "result.distances.clearance.value_m", field="clearance_m"),
    Column("distance_std_m", LENGTH, "", "result.distances.main.std_m"),
    Column("spatial_std_m", LENGTH, "", "result.distances.spatial.std_m", field="spatial_std_m"),
    Column("clearance_std_m", LENGTH, "", "result.distances.clearance.std_m", field="clearance_std_m"),
    *_several("tool_{}_m", "pose.position_m.{}", "x y z", LENGTH),
    *_several("axis_{}", "pose.axis.{}", "x y z", RATIO),
    *_several("direction_{}", "result.distances.clearance.direction.{}", "x y z", RATIO),
    Column("alarm", COUNT, "alarm", lambda e: None if (raised := e.result.alarm.is_raised) is None else int(raised),
           field="alarm"),
    Column("closing_speed_m_s", SPEED, "closing [mm/s]", "result.alarm.closing_speed_m_s", field="closing_speed_m_s"),
    Column("time_to_contact_s", SECONDS, "contact [s]", "result.alarm.time_to_contact_s", field="time_to_contact_s"),
    Column("instrument", TEXT, "instrument", "result.instrument", field="instrument", width=10),
    Column("instrument_clearance_m", LENGTH, "to other [mm]", "result.distances.to_instrument.value_m",
           field="to_instrument_m"),
    Column("instrument_clearance_std_m", LENGTH, "", "result.distances.to_instrument.std_m",
           field="to_instrument_std_m"),
    *_several("instrument_direction_{}", "result.distances.to_instrument.direction.{}", "x y z", RATIO),
    Column("detail", TEXT, "", lambda e: e.result.detail or None, field="detail"),
    Column("tool_std_m", LENGTH, "", "pose.position_std_m"),
    Column("axis_std_rad", RADIANS, "", "pose.shaft_std_rad"),
    Column("consistency", RATIO, "", "result.consistency", field="consistency"),
    *_several("tool_q{}", "quaternion_xyzw.{}", "x y z w", RATIO),
    *(Column(key, LENGTH, "", f"result.distances.clearance.interval_m.{at}", field=key, stored=False)
      for at, key in enumerate(("clearance_low_m", "clearance_high_m"))),
    Column("planar_m", LENGTH, "planar [mm]", "result.distances.planar.value_m", field="planar_m"),
    Column("planar_std_m", LENGTH, "", "result.distances.planar.std_m", field="planar_std_m"),
    Column("distance_half_m", LENGTH, "± [mm]", "result.distances.main.half_m", stored=False),
    Column("instrument_half_m", LENGTH, "± [mm]", "result.distances.to_instrument.half_m", stored=False),
)
"""The contract: columns may be added at the end, none is renamed or removed."""
# fmt: on
ESTIMATE_KEYS = keys_of(ESTIMATE_COLUMNS)

SHOWN = (
    "recording time_s status distance_m distance_half_m spatial_m planar_m tool_x_px tool_y_px tissue_x_px"
    " tissue_y_px tool_area_px tissue_area_px keypoint_count match_count inlier_count"
)
"""The columns of the readable table, in their order."""
OF_SEVERAL = " instrument instrument_clearance_m instrument_half_m"  # shown too where a log has several instruments
OF_ALARMS = " alarm closing_speed_m_s time_to_contact_s"  # shown too where alarms are asked for
DISPENSABLE = (
    "keypoint_count match_count inlier_count tool_area_px tissue_area_px tissue_x_px tissue_y_px tool_x_px"
    " tool_y_px recording instrument_half_m "
)
"""Columns that a narrow terminal leaves out, in this order; then come those of the other kind of method."""
DISPENSABLE_IN_3D = "planar_m spatial_m closing_speed_m_s instrument_clearance_m distance_half_m"
DISPENSABLE_IN_THE_PLANE = "instrument_clearance_m distance_half_m spatial_m planar_m"


def shown_columns(
    width: int | None, *, planar: bool = False, several: bool = False, alarms: bool = False
) -> Sequence[Column]:
    """The columns of the readable table that fit a terminal of `width` characters; all for None."""
    by_key = {column.key: column for column in ESTIMATE_COLUMNS}
    keys = SHOWN + (OF_SEVERAL if several else "") + (OF_ALARMS if alarms else "")
    columns = [by_key[key] for key in keys.split()]
    for key in (DISPENSABLE + (DISPENSABLE_IN_THE_PLANE if planar else DISPENSABLE_IN_3D)).split():
        if width is None or text_width(columns) <= width:
            break
        columns = [column for column in columns if column.key != key]
    return columns


def estimate_row(recording: str, result: FrameResult, method: str, equations: str) -> Row:
    """The row of a result."""
    return row_of(ESTIMATE_COLUMNS, _Estimate(recording, result, method, equations))


def estimate_fields(result: FrameResult, method: str) -> Row:
    """A result as the fields of `svmdist.DistanceEstimate`, None for what does not exist."""
    estimate = _Estimate("", result, method)
    return {column.field: column.value(estimate) for column in ESTIMATE_COLUMNS if column.field}


POSE_COLUMNS: tuple[Column, ...] = (
    Column("stamp_ns", Unit("ns")),
    *(Column(f"{axis}_m", LENGTH) for axis in "xyz"),
    *(Column(f"q{axis}", RATIO) for axis in "xyzw"),
)
POSE_KEYS = keys_of(POSE_COLUMNS)


def pose_rows(stamps_ns: NDArray[np.int64], poses: Array) -> Iterator[Row]:
    """The rows of some poses, shape (n, 4, 4), at their stamps, shape (n,)."""
    numbers = np.hstack([poses[:, :3, 3], quaternion_xyzw_from_rotation(poses[:, :3, :3])])
    for stamp_ns, values in zip(stamps_ns.tolist(), numbers.tolist(), strict=True):
        yield dict(zip(POSE_KEYS, (stamp_ns, *values), strict=True))


def tum_lines(results: Results, *_: object) -> Iterator[str]:
    """Lines as evo reads them, `timestamp x y z qx qy qz qw`; of estimates the tool's, in the camera's frame."""
    of_tool = "tool_x_m" in keys_of(results.columns)
    if of_tool:
        yield "# timestamp tx ty tz qx qy qz qw\n"
    for row in results.rows:
        numbers = [row.get(f"tool_{key}" if of_tool else key) for key in POSE_KEYS[1:]]
        if all(isinstance(number, float) for number in numbers):
            seconds, nanoseconds = divmod(int(row["stamp_ns"] or 0), 1_000_000_000)
            yield f"{seconds}.{nanoseconds:09d} {' '.join(f'{number:.17g}' for number in numbers)}\n"


AXES, COLOURS = "xyz", ("red", "green", "blue")
CLOUD_COLUMNS = (
    *(Column(f"{axis}_m", LENGTH) for axis in AXES),
    *(Column(f"normal_{axis}", RATIO) for axis in AXES),
    Column("std_m", LENGTH),
    *(Column(colour, COUNT) for colour in COLOURS),
)
PLY_NAMES = {f"{axis}_m": axis for axis in AXES} | {f"normal_{axis}": f"n{axis}" for axis in AXES}
"""The names that viewers know; others stay."""


def cloud_results(surface: TissueSurface) -> Results:
    """A row for each point."""
    numbers = np.column_stack([surface.points_m, surface.normals, surface.std_m]).tolist()
    each = zip(numbers, surface.rgb.tolist(), strict=True)
    return Results(CLOUD_COLUMNS, (dict(zip(keys_of(CLOUD_COLUMNS), [*a, *b], strict=True)) for a, b in each))


def write_ply(results: Results, path: Path) -> None:
    """Write points atomically as a binary PLY, lengths in m as 32-bit floats; raises OutputError."""
    keys = keys_of(results.columns)
    kinds = [(PLY_NAMES.get(key, key), "u1" if key in COLOURS else "<f4") for key in keys]
    vertices = np.array([tuple(row[key] for key in keys) for row in results.rows], kinds)
    properties = [f"property {'uchar' if kind == 'u1' else 'float'} {name}" for name, kind in kinds]
    head = ("ply", "format binary_little_endian 1.0", "comment svmdist: m, in the left camera's frame")
    lines = (*head, f"element vertex {len(vertices)}", *properties, "end_header", "")
    with atomic_file(path) as file:
        file.write("\n".join(lines).encode("ascii"))
        file.write(vertices.tobytes())


def write_npz(results: Results, path: Path) -> None:
    """Write an array for each column atomically, shape (n,); raises OutputError."""
    rows = list(results.rows)
    columns: dict[str, Any] = {key: np.array([row[key] for row in rows]) for key in keys_of(results.columns)}
    with atomic_file(path) as file:
        np.savez_compressed(file, **columns)
