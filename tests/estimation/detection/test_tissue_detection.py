"""Tissue in an image: what counts as a part of it, and what is blood on an instrument."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pytest

from svmdist.camera import Camera
from svmdist.estimation.tissue import detect_tissue
from svmdist.samples import Image
from tests.shipped import PROFILE

CAMERA = Camera.from_horizontal_fov(640, 480, np.pi / 3)


@dataclass
class Drawn:
    """Masks of a scene that is drawn as masks."""

    tissue: Image
    shaft: Image | None
    instrument: Image
    black: Image | None = None


def scene(*, blood: bool = False, cut: bool = False) -> Drawn:
    """An ellipse; a dark shaft beside it, with patches of blood, or across it, which cuts a piece off."""
    tissue, shaft = np.zeros((480, 640), np.uint8), np.zeros((480, 640), np.uint8)
    cv2.ellipse(tissue, (260, 240), (110, 80), 10, 0, 360, 255, -1)
    if cut:
        cv2.line(shaft, (330, 0), (355, 480), 255, 26)
    else:
        cv2.line(shaft, (420, 200), (640, 100), 255, 56)
    tissue[shaft > 0] = 0
    if blood:
        for centre in ((470, 178), (560, 135)):
            cv2.circle(tissue, centre, 15, 255, -1)
            cv2.circle(shaft, centre, 15, 0, -1)
    return Drawn(tissue, shaft, np.zeros_like(tissue))


def centroid(masks: Drawn) -> np.ndarray:
    found = detect_tissue(masks, PROFILE, CAMERA)
    assert found is not None
    return found.outline.centroid_px


def test_blood_on_the_shaft_does_not_pull_the_outline() -> None:
    """It is as if it were not there; without a mask of the shaft nothing tells it apart."""
    clean, bloody = scene(), scene(blood=True)
    np.testing.assert_allclose(centroid(bloody), centroid(clean), atol=0.05)
    bloody.shaft = None
    assert np.linalg.norm(centroid(bloody) - centroid(clean)) > 10.0


def test_what_a_shaft_cuts_off_stays_tissue() -> None:
    """The smaller piece beyond the shaft still tells where the outline ends."""
    assert centroid(scene(cut=True)) == pytest.approx(centroid(scene()), abs=1.0)
