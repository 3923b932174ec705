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

    max_contradictions: Count = 25
    """After so many frames in a row whose measurements contradict each other, the filter starts anew: what profile
    and log state wrongly will contradict again, a filter that went astray will not."""

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

    window_max_deviation: Positive = 2.0
    """Normalised square over the gate's bound beyond which a measurement of the first frames is left out for good: its
    weight in the solution is less than a half there."""

    consistency_window_s: Positive = 1.5
    """Normalised innovations are averaged over so long: some ten degrees of freedom at 1 Hz, a hundred at 10 Hz."""

    consistency_min_degrees: Count = 8
    """Fewer degrees of freedom in that window tell nothing of consistency."""

    max_consistency: Positive = 4.0
    """Mean normalised innovation per degree of freedom beyond which no distance is told. Where models hold it is 1 or
    less; deviations that are wrong by a factor of two give 4."""

    max_refused_frames: Count = 4
    """So many frames in a row, of which all that was measured is refused, tell no distance: what hides an instrument
    misleads two or three."""

    max_refused_share: float = Field(default=0.5, gt=0.0, le=1.0)
    """Share of measured degrees of freedom, refused by the gate, beyond which no distance is told: more than half
    contradicts the prediction."""

    max_young_refused_share: float = Field(default=0.2, gt=0.0, le=1.0)
    """The same in the first frames, as long as a young filter solves for all of them anew: what it refuses then, later
    frames are judged by."""

    usual_constant_deviations: Positive = 2.5
    """A constant (focal length, tag size, a length, …) that is found so many stated deviations from its stated value
    is usual: one of twenty is, one time in four. Beyond, all deviations grow in proportion."""

    max_constant_deviations: Positive = 4.0
    """Beyond so many what is stated and what is seen contradict each other, and no distance is told. True deviations
    leave it to one log in a thousand."""

    given_lag_std_s: Annotated[float, Field(ge=0.0)] = 5e-3
    """Standard deviation of what is left of the offset between joints and images where `--lag` says what it is. It
    stands in for `time_offset_std_s` of the profile then."""

    max_time_offset_deviations: Positive = 5.0
    """Where the offset between joints and images is found so many stated deviations from what is stated, no distance
    is told: with those of the profile that is beyond the joints that travel with an image."""

    probation_s: Positive = 3.0
    """After such a new start no distance is told for so long: what was stated wrongly contradicts again by then."""
