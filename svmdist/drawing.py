"""What is drawn of a frame, as data: shapes in the image and in space, for pictures, videos and recordings alike."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import StrEnum

from svmdist.geometry import Capsules, Mesh
from svmdist.transforms import Array

Rgb = tuple[int, int, int]


class Part(StrEnum):
    """What a shape shows."""

    TISSUE = "tissue"
    INSTRUMENT = "instrument"
    TIP = "tip"
    MARKER = "marker"
    MATCH = "match"
    INLIER = "inlier"
    SHAFT = "shaft"
    POSE = "pose"
    TAG = "tag"
    DISTANCE = "distance"
    BETWEEN = "between"


COLOURS: dict[Part, Rgb] = {
    Part.TISSUE: (0, 158, 115),
    Part.INSTRUMENT: (86, 180, 233),
    Part.TIP: (204, 121, 167),
    Part.MARKER: (240, 228, 66),
    Part.MATCH: (160, 160, 160),
    Part.INLIER: (240, 228, 66),
    Part.SHAFT: (213, 94, 0),
    Part.POSE: (0, 114, 178),
    Part.TAG: (204, 121, 167),
    Part.DISTANCE: (255, 255, 255),
    Part.BETWEEN: (230, 159, 0),
}
"""Colours that differ with any colour vision (Okabe & Ito 2008); what is measured is white."""
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
    """One line about one instrument: what was measured, or why nothing was."""

    text: str
    measured: bool
    alarm: bool = False


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
    """All that is drawn of one image; in the camera frame: `bodies` by instrument, `tissue` and `segments`."""

    stamp_ns: int
    shapes: tuple[Shape, ...] = ()
    labels: tuple[Label, ...] = ()
    lines: tuple[StatusLine, ...] = ()
    bodies: Mapping[str, Capsules] = field(default_factory=dict)
    tissue: Mesh | None = None
    segments: tuple[Segment, ...] = ()
