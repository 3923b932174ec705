"""How far a room is from the ideal world, in what its images and its tissue show."""

from __future__ import annotations

from dataclasses import dataclass, fields

from svmdist.perturbations.chosen import Perturbations


@dataclass(frozen=True)
class Room:
    """Strengths of the perturbations of images, one a field of that name, in its unit (`image_table.py`).

    The defaults are the ideal world, to the last bit.
    """

    lens: float = 0.0
    lens_untold: float = 0.0
    breathing: float = 0.0
    pulse: float = 0.0
    tissue_shape: float = 0.0
    tissue_ellipsoid: float = 0.0
    dent: float = 0.0
    tip: float = 0.0
    ring: float = 0.0
    shaft_grey: float = 0.0
    shaft_blue: float = 0.0
    jaw: float = 0.0
    blood: float = 0.0
    border: float = 0.0
    vignette: float = 0.0
    chroma: float = 0.0
    interlace: float = 0.0
    rolling: float = 0.0
    light: float = 0.0
    shadow: float = 0.0
    wet: float = 0.0

    @staticmethod
    def of(perturbations: Perturbations) -> Room:
        """What of a recording's perturbations images and tissue show."""
        return Room(**{each.name: perturbations[each.name] for each in fields(Room)})

    @property
    def moves_tissue(self) -> bool:
        """Whether the tissue moves."""
        return bool(self.breathing or self.pulse)

    @property
    def needs_surfaces(self) -> bool:
        """Whether an image is changed by what stands at each of its pixels."""
        return bool(self.light or self.shadow or self.wet or self.blood)


IDEAL = Room()
"""Nothing is set."""
