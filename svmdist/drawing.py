"""What is drawn, as data, and its colours: shapes in the image and in space, for all pictures, pages and recordings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from svmdist.geometry import Capsules, Surface
from svmdist.transforms import Array

Rgb = tuple[int, int, int]


class Part(StrEnum):
    """What a shape shows."""

    TISSUE = "tissue"
    SHAFT = "shaft"
    WRIST = "wrist"
    TIP = "tip"
    OTHER = "other instrument"
    DISTAL_MARKER = "distal marker"
    POSE = "pose"
    TAG = "tag"
    MARKER = "marker"
    INLIER = "inlier"
    MATCH = "match"
    DISTANCE = "distance"
    BETWEEN = "between"


YELLOW, WHITE = (240, 228, 66), (255, 255, 255)
COLOURS: dict[Part, Rgb] = {
    Part.TISSUE: (0, 158, 115),
    **dict.fromkeys((Part.SHAFT, Part.POSE), (86, 180, 233)),
    **dict.fromkeys((Part.WRIST, Part.DISTAL_MARKER), (230, 159, 0)),
    Part.TIP: (204, 121, 167),
    Part.OTHER: (0, 114, 178),
    **dict.fromkeys((Part.TAG, Part.MARKER, Part.INLIER), YELLOW),
    Part.MATCH: (160, 160, 160),
    **dict.fromkeys((Part.DISTANCE, Part.BETWEEN), WHITE),
}
"""One for each thing; they differ with any colour vision (Okabe & Ito 2008), and what is measured is white."""
ALARM_COLOUR: Rgb = (213, 94, 0)


class Form(StrEnum):
    """How the points of a shape are joined."""

    POINTS = "points"
    LINE = "line"
    LOOP = "loop"


@dataclass(frozen=True, slots=True)
class Shape:
    """Points of the recorded image, shape (n, 2) in px, joined by `form`; `instrument` is their instrument's name."""

    part: Part
    form: Form
    points_px: Array
    instrument: str = ""


@dataclass(frozen=True, slots=True)
class Label:
    """A text beside a place of the recorded image, shape (2,) in px."""

    part: Part
    place_px: Array
    text: str


@dataclass(frozen=True, slots=True)
class StatusLine:
    """One line about one instrument: what was measured, or why nothing was; `warns` is of that and of alarms."""

    text: str
    warns: bool = False

    @property
    def colour(self) -> Rgb:
        """White, or that of alarms."""
        return ALARM_COLOUR if self.warns else WHITE


@dataclass(frozen=True, slots=True)
class Segment:
    """A measured distance in the camera frame, between two points, shape (3,), with its text."""

    name: str
    part: Part
    start_m: Array
    end_m: Array
    text: str


@dataclass(frozen=True, slots=True)
class FrameDrawing:
    """All that is drawn of one image; in the camera frame: `bodies` by instrument, `tissue`, `segments`, and `cloud_m`.

    `cloud_m`, shape (n, 3), has the points of the tissue that both views show.
    """

    stamp_ns: int
    shapes: tuple[Shape, ...] = ()
    labels: tuple[Label, ...] = ()
    lines: tuple[StatusLine, ...] = ()
    bodies: Mapping[str, Capsules] = field(default_factory=dict)
    tissue: Surface | None = None
    segments: tuple[Segment, ...] = ()
    cloud_m: Array | None = None
