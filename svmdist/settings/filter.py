"""Settings of the filter over kinematic errors."""

from __future__ import annotations

from typing import Annotated

from pydantic import Field

from svmdist.settings.base import MethodSettings

Positive = Annotated[float, Field(gt=0.0)]
Count = Annotated[int, Field(ge=1)]


class FilterSettings(MethodSettings):
    """What is assumed in the filter over kinematic errors: its gate, bias states, iterations and first frames."""

    gate_z: Positive = 3.09
    """Normal quantile of the gate: a measurement that is less likely than this is rejected. 3.09: 1 in 1,000."""

    point_correlation_time_s: Positive = 30.0
    """Correlation time of the bias of points and sizes. What hides a part of the distal marker is fixed to it: its
    visible middle stays where it is on the tool. Longer than the logs of 8 s that it was found on."""

    edge_correlation_time_s: Positive = 30.0
    """Correlation time of the bias of shaft edges. Shading beside an edge changes as the shaft turns in the light:
    hardly in logs of 8 s."""

    pose_correlation_time_s: Positive = 0.5
    """Correlation time of the bias of a tag's pose. How a tag's edges fall on the pixels changes with every pixel of
    motion."""

    max_iterations: Count = 8
    """Gauss–Newton steps of one update. Two or three are usual; more where the first frames are centimetres off."""

    depth_candidates_m: tuple[Positive, ...] = (0.05, 0.1, 0.2)
    """Depths at which an update also starts while the tool's depth is unknown: where an endoscope's tool may be, a
    factor of two apart."""

    depth_unknown_std_m: Positive = 0.01
    """Standard deviation of the tool's depth above which it counts as unknown."""

    max_rejections: Count = 8
    """After so many frames in a row with measurements but none accepted, the filter has lost the arm and starts
    anew."""

    window_solves: tuple[Count, ...] = Field(default=(1, 2, 3, 5, 8, 12, 20), min_length=1)
    """Numbers of frames after which a young filter solves for all of them anew. Linearisation is off by tens
    of millimetres in the first frames; after 20 it no longer is."""

    window_depth_offsets_m: tuple[float, ...] = (0.0, 0.03, -0.03)
    """Offsets in depth at which that solution starts too: depth is the least observable at first. Half of a working
    range."""

    window_depth_offset_frames: Annotated[int, Field(ge=0)] = 3
    """Up to so many frames it starts there; later the last solution is a start that needs no others."""

    window_max_steps: Count = 20
    """Levenberg–Marquardt steps from each start."""
