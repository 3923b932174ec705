"""Perturbations of what the cameras see: lens, light, colours, and the looks of instrument and tissue."""

from __future__ import annotations

from svmdist.perturbations.perturbation import Perturbation

IMAGES: tuple[Perturbation, ...] = ()
