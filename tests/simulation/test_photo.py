"""Path-traced images: the same places as in the drawn ones, from the same numbers, with their own light."""

from __future__ import annotations

import sys

import cv2
import numpy as np
import pytest

from svmdist.errors import SimulationError
from svmdist.perturbations.chosen import parse_perturbations
from svmdist.profile import Profile
from svmdist.samples import Image
from svmdist.simulation.extras import Extras
from svmdist.simulation.scene import Scene, make_scene

pytest.importorskip("pybullet", reason="the simulation needs PyBullet")
from svmdist.simulation import photo
from svmdist.simulation.renderer import Renderer, make_renderer


def small_scene(profile: Profile, perturbations: str) -> Scene:
    assert profile.simulation is not None
    settings = profile.simulation.model_copy(update={"width_px": 240, "height_px": 180})
    extras = Extras(perturbations=parse_perturbations(perturbations))
    return make_scene(profile.model_copy(update={"simulation": settings}), 1, extras)


def red_middle_px(image: Image) -> tuple[float, np.ndarray]:
    """Area and middle of the hull of what is redder than it is anything else: the tissue, a highlight within."""
    blue, green, red = np.moveaxis(image.astype(int), -1, 0)
    rows, columns = np.nonzero(red > 1.5 * np.maximum(blue, green) + 10)
    moments = cv2.moments(cv2.convexHull(np.column_stack([columns, rows]).astype(np.float32)))
    return moments["m00"], np.array([moments["m10"], moments["m01"]]) / moments["m00"]


def test_tissue_is_where_the_other_renderer_draws_it(
    profile: Profile, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Through the lens, risen by 3 mm, in both cameras, and each picture is the same again."""
    pytest.importorskip("mitsuba", reason="path tracing needs Mitsuba")
    monkeypatch.setattr(photo, "SAMPLE_COUNT", 8)
    scene = small_scene(profile, "lens=1,breathing=3,light=1")
    away = scene.posture.copy()
    away[scene.chain.joint_names.index("insertion")] = 0.05
    with make_renderer(scene, "mitsuba", (), 1) as traced, Renderer(scene) as drawn:
        pairs = [
            (traced.frame_of(away, turn=0, rise_m=0.003), drawn.frame_of(away, turn=0, rise_m=0.003)),
            (traced.right_frame(turn=1), drawn.right_frame(turn=1)),
        ]
        np.testing.assert_array_equal(traced.frame_of(away, turn=0, rise_m=0.003), pairs[0][0])
    for photograph, picture in pairs:
        (area, middle), (drawn_area, drawn_middle) = red_middle_px(photograph), red_middle_px(picture)
        np.testing.assert_allclose(middle, drawn_middle, atol=0.7)
        assert area == pytest.approx(drawn_area, rel=0.06)
        assert 40 < np.median(photograph) < 200
    assert pairs[0][0].max() == 255  # the highlight, which the drawn one lacks


def test_missing_mitsuba_says_what_to_do(profile: Profile, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "mitsuba", None)
    with pytest.raises(SimulationError, match=r"svmdist\[photo\]"):
        make_renderer(small_scene(profile, "light=1"), "mitsuba", (), 1)
