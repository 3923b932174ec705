"""Results of methods by flat names, as tests write them down."""

from __future__ import annotations

from svmdist.results import Distance, Distances, FrameResult, ImageFindings
from svmdist.samples import Status


def result_of(
    stamp_ns: int, status: Status, tool_px: tuple[float, float] | None = None, **distances_m: float | None
) -> FrameResult:
    """A result with distances named as columns are: `planar_m`, `spatial_m`, `spatial_std_m`, `clearance_m`, …."""
    told = {}
    for name in ("planar", "spatial", "clearance"):
        value_m = distances_m.pop(f"{name}_m", None)
        std_m = distances_m.pop(f"{name}_std_m", None)
        told[name] = None if value_m is None else Distance(value_m, std_m)
    assert not distances_m, f"no such distances: {', '.join(distances_m)}"
    return FrameResult(stamp_ns, status, ImageFindings(tool_px=tool_px), distances=Distances(**told))
