"""A shaft by its silhouette: its two edges in the image's gradients, where they end, and the wrist beyond them.

An instrument that was found roughly says where to look. Nothing here asks for a colour or a brightness.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from svmdist.profile.settings import ShaftSettings, SilhouetteSettings
from svmdist.samples import Image
from svmdist.transforms import Array
from svmdist.vision.edge_lines import EdgeLine, edge_line
from svmdist.vision.instruments.seen import SeenInstrument
from svmdist.vision.wrist_outline import WristPoint, WristShape, wrist_point

DEFAULT, DEFAULT_SHAFT = SilhouetteSettings(), ShaftSettings()
ENDS_APART = 0.3
"""Deviation of an end over the distance of both ends: those of a uniform distribution between them."""


@dataclass(frozen=True, slots=True)
class Silhouette:
    """Both edges of a shaft as the camera sees them, border first, and where they end.

    `end_px` (2,) is the middle between both ends, None where the shaft goes on to the border of the picture; `std_px`
    is its deviation along the shaft. `wrist` is None where no wrist is seen beyond.
    """

    edges: tuple[EdgeLine, EdgeLine]
    end_px: Array | None
    std_px: float
    wrist: WristPoint | None

    @property
    def towards_tip(self) -> Array:
        """Unit vector along the middle line, shape (2,)."""
        along = self.edges[0].direction + self.edges[1].direction
        return np.asarray(along / np.linalg.norm(along))

    @property
    def middle_px(self) -> Array:
        """A point between both edges, shape (2,)."""
        points = [point for edge in self.edges for point in (edge.start_px, edge.end_px)]
        return np.asarray(np.mean(points, axis=0))

    @property
    def width_px(self) -> float:
        """Between both edges, at the end."""
        return _width_px(*self.edges)

    @property
    def is_stub(self) -> bool:
        """Whether less of the shaft's length is seen than it is wide, by a quarter more."""
        lengths_px = [float(np.linalg.norm(edge.end_px - edge.start_px)) for edge in self.edges]
        return min(lengths_px) < 1.25 * self.width_px


def find_silhouette(
    bgr: Image,
    seen: SeenInstrument,
    picture: Image | None,
    wrist: WristShape,
    settings: SilhouetteSettings = DEFAULT,
    shaft: ShaftSettings = DEFAULT_SHAFT,
) -> Silhouette | None:
    """Measure an instrument that was roughly found in an image, shape (h, w, 3); None without two straight edges.

    `picture`, shape (h, w), marks what is not border. `wrist` is what may be seen beyond the cylinder's end.
    """
    found = [edge_line(bgr, side, seen.width_px, picture, settings, shaft) for side in seen.sides]
    first, second = found
    if first is None or second is None or not _are_a_pair(first, second, settings):
        return None
    width_px = _width_px(first, second)
    along = first.direction + second.direction
    along /= np.linalg.norm(along)
    if not (first.ends or second.ends):
        return Silhouette((first, second), None, np.inf, None)
    ends = [edge.end_px for edge in (first, second) if edge.ends]
    places = [float(end @ along) for end in ends]
    # One edge may fade before the other, on dark tissue; beyond the cylinder neither stays on its line.
    apart_px = max(places) - min(places)
    agree = apart_px <= settings.ends_agree_widths * width_px
    place = float(np.mean(places)) if agree else max(places)
    middle_px = 0.5 * (first.end_px + second.end_px)
    end_px = middle_px + (place - float(middle_px @ along)) * along
    std_px = settings.min_end_std_widths * width_px + (
        ENDS_APART * apart_px if len(places) == 2 else ENDS_APART * width_px
    )
    point = wrist_point(bgr, seen.mask, end_px, along, width_px, wrist, settings)
    return Silhouette((first, second), end_px, std_px, point)


def _are_a_pair(first: EdgeLine, second: EdgeLine, settings: SilhouetteSettings) -> bool:
    """Whether two edges run alike, side by side, and are long enough to tell where."""
    if first.direction @ second.direction < np.cos(settings.max_taper_rad):
        return False
    width_px = _width_px(first, second)
    lengths_px = [float(np.linalg.norm(edge.end_px - edge.start_px)) for edge in (first, second)]
    return min(lengths_px) > settings.min_side_per_width * width_px > 0.0


def _width_px(first: EdgeLine, second: EdgeLine) -> float:
    along = first.direction + second.direction
    along /= np.linalg.norm(along)
    return abs(
        float(along[0] * (second.end_px - first.end_px)[1] - along[1] * (second.end_px - first.end_px)[0])
    )
